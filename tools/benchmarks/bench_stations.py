"""What layouts, classifiers, several stations and steered beams cost, by ratio to a plain sensor.

    python tools/benchmarks/bench_stations.py

Each row is a sensor beside the plain one that it says, both with the same drones, a whole scan:
truth, geometry, physics, plots, and their batches in protobuf. Joining what several stations see
grows with more than the number of drones: ghosts do.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from aims import by_size, in_turns, ratios
from section_4_crowd import at_work, ns_per_drone, place
from support.every_kind import EMITTER, RF

from plotfeed import Engine
from plotfeed.feeds.console.process import keep_freed
from plotfeed.testing import held, radar, scene, staring

SIZES = (1, 4, 10)
REPEATS = 3
SECONDS_A_REPEAT = 0.05
Keys = dict[str, Any]


MICROPHONES: Keys = {
    "id": "radar", "type": "acoustic", "scan": staring(), "noise_db": 0.0, "sensitivity_db": -40.0,
    "range_max_m": 3000.0, "azimuth_beamwidth_deg": 20.0, "microphones": 8, "frequency_hz": 200.0,
}  # fmt: skip
PASSIVE: Keys = {
    "id": "radar", "type": "passive_radar", "scan": staring(), "gain_rx_dbi": 10.0,
    "transmitters": [
        {"id": f"m{i}", "preset": "dvb-t", "erp_w": 1e5, "place": place(*where)}
        for i, where in enumerate(((-8e3, 15e3, 200.0), (17e3, 3e3, 150.0), (2e3, -17.5e3, 120.0)))
    ],
    "azimuth_beamwidth_deg": 10.0, "integration_s": 0.3, "external_noise_db": -4.45,
    "range_max_m": 9000.0,
}  # fmt: skip
RADAR = radar(integration_s=0.001, power_w=1e4, elevation_min_deg=-5.0, elevation_max_deg=45.0)
STEERED = {"kind": "electronic", "period_s": 0.1, "dwell_s": 0.001, "revisit_s": 0.1}
MATRIX = {"claims": ["drone", "bird"], "confusion": {"drone": [0.9, 0.1]}}
SEVERAL: Keys = {"type": "multistatic_passive"}
SECOND: Keys = {"receivers": [{"id": "b"} | place(2500.0, 800.0)]}
CAMERA: Keys = {
    "id": "radar", "type": "camera", "scan": staring(), "range_max_m": 9000.0,
    "horizontal_fov_deg": 60.0, "vertical_fov_deg": 40.0, "pixels_across": 40_000,
    "pixels_down": 30_000,
}  # fmt: skip
# The plain sensor, and the one that is measured beside it.
PAIRS: dict[str, tuple[Keys, Keys]] = {
    "microphones in a circle, by a beam": (
        MICROPHONES,
        MICROPHONES | {"layout": {"shape": "circle", "spacing_m": 0.4}},
    ),
    "a classifier, by none": (MICROPHONES, MICROPHONES | {"classifier": MATRIX}),
    "an RF sensor in a city, by one in the open": (
        RF,
        RF | {"path_loss": {"kind": "city", "environment": "urban"}},
    ),
    "a camera on a mount, by a fixed one": (CAMERA, CAMERA | {"mount": {}}),
    "two arrays, by one": (
        MICROPHONES,
        MICROPHONES | {"type": "acoustic_pair", "second_array": place(200.0, 0.0)},
    ),
    "a place by three masts, by a plot of each": (PASSIVE, PASSIVE | SEVERAL),
    "three masts and two receivers, by one": (PASSIVE, PASSIVE | SEVERAL | SECOND),
    "a steered beam, by one that stares": (
        RADAR | {"scan": staring(0.1), "report": ["plots"]},
        RADAR | {"scan": STEERED, "report": ["plots"]},
    ),
}


def engine_of(keys: Keys, n: int) -> Engine:
    """At work for as long as sounds travel."""
    drones = [
        held(
            f"d{i}",
            17.0 * i,
            5.0,
            700.0 + 40.0 * i,
            rcs_m2=1.0,
            sound_power_db=120.0,
            emitters=[EMITTER],
        )
        for i in range(n)
    ]
    made = scene([keys | {"report": ["plots"]}], drones, seed=1)
    return at_work(made, after_s=10)


def main() -> None:
    """Measures in turns and prints a table."""
    keep_freed()

    def ways_at(n: int) -> dict[str, Callable[[], float]]:
        return {
            f"{name}{side}": partial(ns_per_drone, engine_of(keys, n), n, SECONDS_A_REPEAT)
            for name, pair in PAIRS.items()
            for side, keys in enumerate(pair)
        }

    found = in_turns(SIZES, REPEATS, ways_at)
    print(f"Times that of the plain sensor, median (least to most) of {REPEATS} runs in turns.\n")
    each, plain = (
        [[found[f"{name}{side}", n] for n in SIZES] for name in PAIRS] for side in (1, 0)
    )
    times = (map(ratios, *rows) for rows in zip(each, plain, strict=True))
    by_size("sensor", [f"{n} drones" for n in SIZES], dict(zip(PAIRS, times, strict=True)))
    print(f"\nMicroseconds a drone, of {SIZES[-1]}:\n")
    last = {name: [[ns / 1e3 for ns in found[f"{name}1", SIZES[-1]]]] for name in PAIRS}
    by_size("sensor", ["µs"], last, ",.0f")


if __name__ == "__main__":
    main()
