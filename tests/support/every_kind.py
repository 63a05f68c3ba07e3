"""Sensors of each kind, by the names that tests have for them, and drones that they detect."""

from __future__ import annotations

from typing import Any

import numpy as np

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.formats import Batch
from plotfeed.feeds.scene.scene import Scene
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, held, radar, rotating, scene, staring, waypoint

RANGES_M = (1000.0, 4000.0)
EMITTER = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0}
RADAR = radar(elevation_max_deg=60.0, report=["asterix-048", "plots"])
MIMO = {
    "id": "radar", "type": "mimo_radar", "scan": staring(),
    "transmitters": [
        {"power_w": 2000.0, "east_m": 100.0 * k, "north_m": 0.0, "above_site_m": 0.0}
        for k in range(2)
    ],
    "frequency_hz": 15e9, "gain_tx_dbi": 30.0, "gain_rx_dbi": 30.0, "integration_s": 0.06,
    "range_resolution_m": 20.0, "range_max_m": 10_000.0, "azimuth_beamwidth_deg": 3.0,
    "elevation_beamwidth_deg": 10.0, "elevation_min_deg": -2.0, "elevation_max_deg": 60.0,
}  # fmt: skip
PASSIVE = {
    "id": "radar", "type": "passive_radar", "scan": staring(), "gain_rx_dbi": 10.0,
    "transmitters": [
        {"id": "tv", "erp_w": 1e5, "frequency_hz": 600e6, "bandwidth_hz": 7.61e6,
         "place": waypoint(300.0, 0.2, 20_000.0)},
    ],
    "azimuth_beamwidth_deg": 2.0, "integration_s": 0.3, "external_noise_db": -4.45,
    "range_max_m": 10_000.0,
}  # fmt: skip
GATE = {
    "id": "radar",
    "type": "range_gate",
    "scan": staring(),
    "range_max_m": 9000.0,
    "sigma_m": 3.0,
}
RF = {
    "id": "radar", "type": "rf", "scan": staring(), "frequency_min_hz": 2.4e9,
    "frequency_max_hz": 2.5e9, "channel_bandwidth_hz": 1e6, "integration_s": 1e-3,
    "range_max_m": 9000.0, "baseline_m": 0.2, "azimuth_floor_deg": 0.5,
}  # fmt: skip
MICROPHONES = {
    "id": "radar", "type": "acoustic", "scan": staring(), "noise_db": 0.0, "sensitivity_db": 10.0,
    "range_max_m": 500.0, "azimuth_beamwidth_deg": 20.0, "elevation_beamwidth_deg": 20.0,
}  # fmt: skip
# They detect the drones of `drones`.
SENSORS = {
    "active": RADAR,
    "rotating": RADAR | {"scan": rotating(1.0, 8)},
    "mimo": MIMO,
    "passive": PASSIVE,
    "gate": GATE,
    "rf": RF,
    "microphones": MICROPHONES,
}
# They stare, and detect a loud drone at a few kilometres.
FAR_SENSORS = {
    "radar": radar(power_w=5e4),
    "mimo": MIMO | {
        "transmitters": [{"power_w": 2e4, "east_m": 9.0, "north_m": 0.0, "above_site_m": 0.0}],
        "elevation_min_deg": -10.0,
    },
    "passive": PASSIVE | {
        "gain_rx_dbi": 15.0, "cancellation_db": -150.0,
        "transmitters": [{"id": "tv", "erp_w": 1e5, "frequency_hz": 600e6, "bandwidth_hz": 7.61e6,
                          "place": waypoint(90.0, 1.0, 9_000.0)}],
    },
    "rf": RF,
    "array": MICROPHONES | {
        "range_max_m": 9000.0, "sensitivity_db": 5.0, "absorption_db_per_km": 1.0,
        "height_above_ground_m": 1.5,
    },
    "camera": {
        "id": "radar", "type": "camera", "scan": staring(0.1), "range_max_m": 9000.0,
        "horizontal_fov_deg": 360.0, "vertical_fov_deg": 40.0, "pixels_across": 400_000,
        "pixels_down": 40_000,
    },
    "gate": GATE,
}  # fmt: skip


def drones(kind: str) -> list[dict[str, Any]]:
    scale = 0.05 if kind == "microphones" else 1.0
    return [
        held(
            f"{ring}-{i}",
            18 * i + 7 * ring + 5,
            12.0,
            range_m * scale,
            rcs_m2=1.0,
            emitters=[EMITTER],
        )
        for ring, range_m in enumerate(RANGES_M)
        for i in range(20)
    ]


KINDS: dict[str, dict[str, Any]] = {
    "rotating": radar(scan=rotating(1.0, 32)),
    "staring": radar(pfa=1e-10),
    "passive": PASSIVE,
    "gate": GATE,
    "rf": RF | {"azimuth_floor_deg": 2.0},
}


def scene_of(
    kind: str, count: int, report: list[str], *, drones: int = 40, seed: int = 1, **more: Any
) -> Scene:
    """A scene of so many sensors of a kind, each with a SAC, SIC and place of its own.

    They see so many drones all around; `more` are other tables.
    """
    sensors = [
        KINDS[kind]
        | {"id": f"{kind}-{i}", "report": report, "sac": i % 256, "sic": i * 7 % 256}
        | {"position_enu_m": [10.0 * i, -5.0 * i, 0.1 * i]}
        for i in range(count)
    ]
    rng = np.random.default_rng(seed)
    loud = {"rcs_m2": 1.0, "emitters": [EMITTER]}
    places = rng.uniform((0, 5, 800), (360, 30, 3000), (drones, 3)).tolist()
    flying = [held(f"d{i}", *place, **loud) for i, place in enumerate(places)]
    return scene(sensors, flying, seed=seed, **more)


def seen(made: Scene, scans: int = 2) -> Batch:
    """All sectors of so many seconds, those of each sensor after each other."""
    engine = Engine(made, START_NS)
    return Batch.joined(list(engine.until(START_NS + scans * NS, messages=False)))
