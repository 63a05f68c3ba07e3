"""What effects and sensors that are not plain cost, and what it costs that they could be named.

    python tools/benchmarks/bench_effects.py

The active radar of section-4 stares at drones between 2 and 7 km; one effect at a time is named.
Times are of a whole sector: truth, geometry, physics, plots, and messages of category 015.
Instructions are the interpreter's own, counted one by one in a sector of three drones that names
nothing.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "feeds" / "engine"))

from aims import by_size, in_turns, ratios, table
from section_4_crowd import at_work, ns_per_drone, place, scene_of
from support.every_kind import EMITTER, RF
from support.hills import write_ridge
from test_off_costs_nothing import QUESTIONS, SENSORS, executed, text_of

from plotfeed import Engine
from plotfeed.feeds.console.process import keep_freed
from plotfeed.testing import held, radar, scene, staring

SIZES, FEW = (1, 10, 100, 1000, 10_000), (1, 4, 10)
REPEATS = 5
SECONDS_A_REPEAT = 0.1
AREA = [place(2000.0, 0.0, 0.0), place(4000.0, 0.0, 0.0), place(3000.0, 2000.0, 0.0)]
# Keys of the radar, or tables of the scene. The last names nothing either: its drones are too far
# away.
EFFECTS: dict[str, dict[str, Any]] = {
    "nothing named": {},
    "bias": {"bias": {"range_offset_m": 5.0, "azimuth_offset_deg": 0.3, "tilt_deg": 0.1}},
    "drift": {"drift": {"sigma_range_m": 5.0, "sigma_azimuth_deg": 0.1, "time_constant_s": 600.0}},
    "degradation": {"degradation": {"pd_factor": 0.9, "error_factor": 2.0}},
    "two rays": {"multipath": {"antenna_height_m": 5.0}},
    "Doppler": {"doppler": {"notch_m_s": 1e-3, "prf_hz": 4000.0}},
    "merging": {"merging": {}},
    "antenna": {
        "antenna": {
            "transmit": {
                "elevation": {"kind": "cosecant-squared", "from_deg": 4.0, "to_deg": 30.0}
            },
            "receive": {"elevation": {"kind": "gaussian"}},
        }
    },
    "side lobes": {"antenna": {"receive": {"sidelobe_db": 60.0}, "sidelobe_plots": True}},
    "classes, held for 10 s": {
        "classifier": {
            "claims": ["drone", "bird"],
            "confusion": {"drone": [0.96, 0.04]},
            "otherwise": [0.5, 0.5],
            "held_s": 10.0,
        }
    },
    "pulses": {"pulses": {"prf_hz": [4000.0], "pulse_s": 1e-6, "canceller": "single"}},
    "2 of 3 intervals": {"pulses": {"prf_hz": [4e3, 4.5e3, 5.2e3], "needed": 2}},
    "Swerling 3": {"target": [{"swerling": 3}]},
    "lasting strengths": {"decorrelation_s": 1.0},
    "aspect": {"target": [{"aspect": {"kind": "lobes", "depth_db": 6.0}}]},
    "straddling": {"straddling": {"range": "sinc"}},
    "rain": {"weather": {"rain_mm_h": 25.0}},
    "a jammer": {
        "jamming": {
            "noisy": {"eirp_w": 1.0, "frequency_hz": 10e9, "bandwidth_hz": 1e8}
            | place(3000.0, 0.0, 50.0)
        }
    },
    "a bird for each ten drones": {"birds": "a tenth"},
    "a road": {
        "road": [
            {
                "id": "a6",
                "cars_per_h": 300.0,
                "speed_m_s": 25.0,
                "path": [place(2000.0, -500.0, 1.0), place(3000.0, 500.0, 1.0)],
            }
        ]
    },
    "a wind turbine": {"turbine": [{"id": "wt", "radius_m": 50.0} | place(3000.0, 0.0, 90.0)]},
    "clutter, ten plots a scan": {"clutter": [{"id": "woods", "plots_per_km2": 5.0, "area": AREA}]},
    "spiky clutter": {
        "clutter": [{"id": "sea", "threshold_db": 13.0, "texture_stays": False, "area": AREA}]
    },
    "a ridge": {"terrain": {"elevation": ["N40W004.hgt"], "diffraction": True}},
    "out of reach": {"range_max_m": 1000.0},
}
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
FLOCK = {"id": "gulls", "path": [place(2000.0, 0.0, 80.0), place(4000.0, 100.0, 80.0)]}
OF_SCENE = frozenset({"terrain", "target", "birds", "clutter", "road", "turbine"})


def engine_of(n: int, named: dict[str, Any]) -> Engine:
    """An engine of n drones, as `at_work` has it."""
    of_scene = {key: table for key, table in named.items() if key in OF_SCENE}
    if "birds" in of_scene:
        of_scene["birds"] = [FLOCK | {"count": max(n // 10, 1)}]
    of_radar = {key: value for key, value in named.items() if key not in OF_SCENE}
    with tempfile.TemporaryDirectory() as folder:
        write_ridge(Path(folder), height_m=700)
        scene = scene_of(n, Path(folder), of_scene, report=["asterix-015"], **of_radar)
        return at_work(scene)


def engine_with(keys: Keys, n: int) -> Engine:
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


def against_plain_sensors() -> None:
    """Prints what layouts, classifiers, several stations and steered beams cost.

    Each row is a sensor beside the plain one that it says, both with the same drones, with batches
    in protobuf. Joining what several stations see grows with more than the number of drones: ghosts
    do.
    """

    def ways_at(n: int) -> dict[str, Callable[[], float]]:
        return {
            f"{name}{side}": partial(ns_per_drone, engine_with(keys, n), n, SECONDS_A_REPEAT)
            for name, pair in PAIRS.items()
            for side, keys in enumerate(pair)
        }

    found = in_turns(FEW, REPEATS, ways_at)
    print(f"Times that of the plain sensor, median (least to most) of {REPEATS} runs in turns.\n")
    each, plain = ([[found[f"{name}{side}", n] for n in FEW] for name in PAIRS] for side in (1, 0))
    times = (map(ratios, *rows) for rows in zip(each, plain, strict=True))
    by_size("sensor", [f"{n} drones" for n in FEW], dict(zip(PAIRS, times, strict=True)))
    print(f"\nMicroseconds a drone, of {FEW[-1]}:\n")
    last = {name: [[ns / 1e3 for ns in found[f"{name}1", FEW[-1]]]] for name in PAIRS}
    by_size("sensor", ["µs"], last, ",.0f")


def main() -> None:
    """Measures in turns and prints two tables."""
    keep_freed()

    def ways_at(n: int) -> dict[str, Callable[[], float]]:
        engines = {name: engine_of(n, named) for name, named in EFFECTS.items()}
        return {
            name: partial(ns_per_drone, engine, n, SECONDS_A_REPEAT)
            for name, engine in engines.items()
        }

    found = in_turns(SIZES, REPEATS, ways_at)
    print(
        f"Median (least to most) of {REPEATS} repeats, in turns: nanoseconds for a drone and scan\n"
        "with nothing named, and times that.\n"
    )
    sizes = [f"{n:,} drones" for n in SIZES]
    each = {name: [found[name, n] for n in SIZES] for name in EFFECTS}
    plain = each.pop("nothing named")
    by_size("", sizes, {"nothing named, ns": plain}, ",.0f")
    print()
    by_size("named", sizes, {name: map(ratios, row, plain) for name, row in each.items()})
    print(
        "\nWith nothing named, of the instructions of a sector of three drones, those that ask:\n"
    )
    rows = []
    for kind in SENSORS:
        counts = executed(kind)
        asking = sum(n for place, n in counts.items() if QUESTIONS.search(text_of(place)))
        rows.append((kind, f"{counts.total():,}", asking, f"{asking / counts.total():.2%}"))
    table(("sensor", "instructions", "that ask", "share"), rows)

    print("\nSensors beside a plain one:\n")
    against_plain_sensors()


if __name__ == "__main__":
    main()
