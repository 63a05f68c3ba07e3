"""A radar and its targets for tests of charts, at places and ratios of one's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.feeds.lab.charted import Case, Effort, Places
from plotfeed.feeds.scene.scene import Scene, from_tree
from plotfeed.models.frames import LocalFrame, ecef_to_geodetic
from plotfeed.models.state import Signatures

SITE = (40.45, -3.73, 650.0)
RADAR = {
    "id": "radar",
    "type": "active_radar",
    "power_w": 500.0,
    "frequency_hz": 10e9,
    "gain_tx_dbi": 20.0,
    "integration_s": 0.06,
    "range_resolution_m": 10.0,
    "range_max_m": 40_000.0,
    "azimuth_beamwidth_deg": 2.0,
    "elevation_beamwidth_deg": 6.0,
    "elevation_min_deg": -90.0,
    "elevation_max_deg": 90.0,
    "scan": {"kind": "rotating", "period_s": 1.0},
}
MIMO = {key: value for key, value in RADAR.items() if key != "power_w"} | {
    "type": "mimo_radar",
    "scan": {"kind": "staring", "period_s": 1.0},
    # All at one place, so that their echoes are alike.
    "transmitters": [
        {"power_w": 500.0, "east_m": 5.0, "north_m": 0.0, "above_site_m": 0.0} for _ in range(3)
    ],
}


def scene_of(
    *sensors: dict[str, Any],
    site: tuple[float, float, float] = SITE,
    drones: Sequence[dict[str, Any]] = (),
) -> Scene:
    place = dict(zip(("latitude_deg", "longitude_deg", "height_m"), site, strict=True))
    general = {"name": "test", "seed": 1, "site": place}
    tree = {"scene": general, "sensor": list(sensors), "drone": list(drones)}
    return from_tree(tree, Path("test.toml"))


def case_with(
    sensor: dict[str, Any],
    places: Places,
    *,
    rcs_m2: ArrayLike = 1.0,
    site: tuple[float, float, float] = SITE,
) -> Case:
    """A sensor that sees drones at those places, each with its own radar cross-section."""
    scene = scene_of(sensor, site=site)
    n = len(places)
    rcs = np.broadcast_to(np.asarray(rcs_m2, dtype=np.float64), n).copy()
    signatures = Signatures(rcs_m2=rcs, sound_power_db=np.full(n, 80.0), emitters=[()] * n)
    model = scene.sensor[0].model(scene.scene.site)
    return Case(
        scene=scene,
        sensor=scene.sensor[0],
        model=model,
        frame=LocalFrame(*site),
        effort=replace(Effort.quick(n), references=n),
        signatures=signatures,
        seen=places,
        anywhere=places,
        pd_anywhere=np.full(n, 0.5),
        transmitter_enu_m=None,
        own={"range_m": 1.0, "azimuth_deg": 1.0, "elevation_deg": 1.0, "pd": 1.0},
    )


def places_at(latitude_deg: ArrayLike, longitude_deg: ArrayLike, height_m: ArrayLike) -> Places:
    """Those, standing still."""
    latitude, longitude, height = (
        np.asarray(x, dtype=np.float64) for x in (latitude_deg, longitude_deg, height_m)
    )
    n = len(latitude)
    return Places(
        drone=np.arange(n),
        latitude_deg=latitude,
        longitude_deg=longitude,
        height_m=height,
        velocity_ecef_m_s=np.zeros((n, 3)),
    )


def case_of_ratios(sensor: dict[str, Any], snr: ArrayLike) -> Case:
    """Drones 5 km north of the radar whose echoes have those mean ratios."""
    ratios = np.asarray(snr, dtype=np.float64)
    n = len(ratios)
    north = LocalFrame(*SITE).to_ecef(np.tile([0.0, 5000.0, 300.0], (n, 1)))
    places = places_at(*ecef_to_geodetic(north))
    plain = case_with(sensor, places)
    unit: Any = plain.model
    targets = plain.seen_targets()
    echoes = unit.signal_snrs(targets.position_enu_m, targets.rcs_m2())[:, 0]
    return case_with(sensor, places, rcs_m2=ratios / echoes)


def method(sensor: dict[str, Any], stage: str, name: str) -> dict[str, Any]:
    """What a chart says of a method of a sensor's stage."""
    (found,) = (s for s in sensor["stages"] if s["stage"] == stage)
    (only,) = (m for m in found["methods"] if m["method"] == name)
    return dict(only)
