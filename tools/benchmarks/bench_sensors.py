"""Nanoseconds per target and scan of every sensor's observe(), beside Stone Soup's radars.

    python tools/benchmarks/bench_sensors.py

Looks, hits, errors and plots, of targets that nearly all are detected: the dearest case. Stone Soup
runs in `.venv-stonesoup`, which is made where it is missing, on the very targets of the active
radar, in turns with it. Its figures are per target too, and nearly every one is a detection.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
from pathlib import Path
from typing import Any

from aims import Other, aim, python_with, ratios, spread, table, us_per_call

STONESOUP = "stonesoup==1.9.1"

SIZES = (1, 100, 1000, 10_000)
SIZES_OF_STONESOUP = (1, 100, 1000)
THEIRS = {
    "elevation-bearing-range": "Stone Soup RadarElevationBearingRange",
    "aesa": "Stone Soup AESARadar, with its probability",
}
NOT_THE_SAME = """
The two do not do the same. Stone Soup's first radar adds Gaussian noise to every target; its second
draws a detection by North's approximation first. Both give objects, each tied to its truth, which a
tracker of Stone Soup takes as they are; plotfeed gives columns, with looks beside them."""
AIM = 500  # Times as fast per detection, at 1,000 targets
AIMS_NS = {"mimo": 500, "passive": 500, "rf": 500}  # A target and scan, at 10,000 targets
REPEATS = 5
SECONDS_A_REPEAT = 0.1

RF = {
    "id": "rf", "type": "rf", "scan": {"kind": "staring", "period_s": 1.0},
    "frequency_min_hz": 2.4e9, "frequency_max_hz": 2.5e9, "channel_bandwidth_hz": 1e6,
    "integration_s": 1e-3, "range_max_m": 10_000.0, "baseline_m": 0.2,
}  # fmt: skip
GATE = {
    "id": "gate", "type": "range_gate", "scan": {"kind": "staring", "period_s": 1.0},
    "range_max_m": 10_000.0, "sigma_m": 5.0,
}  # fmt: skip
CAMERA = {
    "id": "camera", "type": "camera", "scan": {"kind": "staring", "period_s": 1.0},
    "horizontal_fov_deg": 100.0, "pan_deg": 45.0, "tilt_deg": 10.0, "pixels_across": 8000,
    "pixels_down": 4000, "range_max_m": 10_000.0,
}  # fmt: skip
# What they are called, and between which distances their targets are: where they see them.
CASES = {
    "active": ("active radar", (1000, 5000)),
    "mimo": ("MIMO radar, 3 transmitters", (1000, 2000)),
    "passive": ("passive radar, 1 transmitter", (500, 1000)),
    "microphone": ("microphones", (60, 90)),
    "rf": ("RF sensor, 1 emitter a drone", (1000, 3000)),
    "gate": ("range gate", (1000, 5000)),
    "camera": ("camera", (50, 150)),
}


def serve_stonesoup() -> None:
    """In the other environment: one question a line, {"targets"} or {"us", "radar"}."""
    import datetime

    import numpy as np
    from stonesoup.models.measurement.nonlinear import CartesianToElevationBearingRange
    from stonesoup.sensor.radar.beam_pattern import StationaryBeam
    from stonesoup.sensor.radar.beam_shape import Beam2DGaussian
    from stonesoup.sensor.radar.radar import AESARadar, RadarElevationBearingRange
    from stonesoup.types.groundtruth import GroundTruthState

    place, noise = np.zeros((3, 1)), np.diag([0.002**2, 0.001**2, 1.0])
    radars = {
        "elevation-bearing-range": RadarElevationBearingRange(
            position=place, ndim_state=3, position_mapping=(0, 1, 2), noise_covar=noise
        ),
        "aesa": AESARadar(
            position=place,
            position_mapping=(0, 1, 2),
            measurement_model=CartesianToElevationBearingRange(
                ndim_state=3, mapping=(0, 1, 2), noise_covar=noise
            ),
            # A beam so wide and strong that all targets are in it, and detected.
            beam_shape=Beam2DGaussian(peak_power=1e9),
            beam_transition_model=StationaryBeam(centre=[0.0, 0.0]),
            number_pulses=10,
            duty_cycle=0.1,
            band_width=15e6,
            receiver_noise=5,
            frequency=10e9,
            antenna_gain=35,
            beam_width=10.0,
            loss=4,
            swerling_on=True,
            rcs=0.01,
            probability_false_alarm=1e-6,
        ),
    }
    truths: list[Any] = []
    when = datetime.datetime(2026, 1, 1)  # noqa: DTZ001 - as Stone Soup wants it

    for line in sys.stdin:
        question = json.loads(line)
        if "targets" in question:
            truths = [GroundTruthState([[x] for x in t], timestamp=when)
                      for t in question["targets"]]  # fmt: skip
            found = {name: len(radar.measure(set(truths))) for name, radar in radars.items()}
            print(json.dumps({name: n / len(truths) for name, n in found.items()}), flush=True)
        else:
            some, radar = set(truths[: question["us"]]), radars[question["radar"]]
            print(us_per_call(lambda: radar.measure(some), SECONDS_A_REPEAT), flush=True)  # noqa: B023


def models() -> dict[str, Any]:
    """Of the sensors of section-4, an RF sensor, a range gate and a camera; by their ids."""
    import tomllib
    from importlib.resources import files

    from plotfeed.feeds.scene.scene import from_tree

    tree = tomllib.loads((files("plotfeed.feeds.scene.examples") / "section-4.toml").read_text())
    tree["sensor"] += [RF, GATE, CAMERA]
    scene = from_tree(tree, Path("bench.toml"))
    return {sensor.id: sensor.model(scene.scene.site) for sensor in scene.sensor}


def targets(n: int, nearest_m: float, furthest_m: float) -> Any:
    """Drones of 0.01 m2, 80 dB and 20 dBm, 20 to 70 degrees from north, 2 to 20 above horizon."""
    import numpy as np

    from plotfeed.models.frames import aer_to_enu
    from plotfeed.models.sensors.sensor_model import Targets
    from plotfeed.models.state import Emitter, Signatures
    from plotfeed.models.truth import EmitterTable

    rng = np.random.default_rng(1)
    enu_m = aer_to_enu(rng.uniform(20, 70, n), rng.uniform(2, 20, n),
                       rng.uniform(nearest_m, furthest_m, n))  # fmt: skip
    emitters = (Emitter(frequency_hz=2.44e9, bandwidth_hz=1e6, eirp_dbm=20.0, kind="control"),)
    return Targets(
        drone=np.arange(n),
        t_utc_ns=np.zeros(n, np.int64),
        position_enu_m=enu_m,
        true_position_enu_m=enu_m,
        signatures=Signatures(
            rcs_m2=np.full(n, 0.01),
            sound_power_db=np.full(n, 80.0),
            emitters=EmitterTable([emitters] * n),
            size_m=np.full(n, 0.35),
        ),
    )


def main() -> None:
    """Measures in turns and prints a table."""
    import numpy as np

    from plotfeed.feeds.console.process import keep_freed

    keep_freed()
    sensors = models()
    seen = {name: {n: targets(n, *CASES[name][1]) for n in SIZES} for name in CASES}
    shares = {
        name: len(sensors[name].observe(seen[name][1000], np.random.default_rng(1))[1]) / 1000
        for name in CASES
    }
    other = Other(python_with(".venv-stonesoup", STONESOUP), __file__)
    theirs = other.ask(targets=seen["active"][max(SIZES_OF_STONESOUP)].position_enu_m.tolist())
    rng = np.random.default_rng(2)
    times: dict[tuple[str, int], list[float]] = {}
    for _ in range(REPEATS):
        for n in SIZES:
            for name in CASES:
                look = sensors[name].observe
                us = us_per_call(lambda: look(seen[name][n], rng), SECONDS_A_REPEAT)  # noqa: B023
                times.setdefault((name, n), []).append(us * 1e3 / n)
            for name in THEIRS if n in SIZES_OF_STONESOUP else ():
                times.setdefault((name, n), []).append(other.ask(us=n, radar=name) * 1e3 / n)
    other.close()

    print(f"ns per target and scan: median (least to most) of {REPEATS} repeats, in turns.")
    print(f"{STONESOUP}; {os.cpu_count()} cores.\n")
    table(
        ["sensor", "plots a target", *(f"{n:,} at once" for n in SIZES)],
        [
            *(_row(title, shares[name], name, times) for name, (title, _) in CASES.items()),
            *(_row(title, theirs[name], name, times) for name, title in THEIRS.items()),
        ],
    )
    print()
    print(*(_verdict(name, theirs[name], shares["active"], times) for name in THEIRS), sep="\n")
    print(_losses(times))
    print(_reached(times))
    print(NOT_THE_SAME)


def _row(
    title: str, share: float, name: str, times: dict[tuple[str, int], list[float]]
) -> list[str]:
    cells = [spread(times[name, n], ",.0f") if (name, n) in times else "" for n in SIZES]
    return [title, f"{share:.2f}", *cells]


def _verdict(
    name: str, their_share: float, our_share: float, times: dict[tuple[str, int], list[float]]
) -> str:
    """How many times as fast per detection the active radar is, by the number of targets."""
    each = {
        n: [r * our_share / their_share for r in ratios(times[name, n], times["active", n])]
        for n in SIZES_OF_STONESOUP
    }
    told = ", ".join(f"{spread(found, ',.1f')} at {n:,}" for n, found in each.items())
    what = f"the active radar beside {THEIRS[name]}"
    limit = f"{AIM} times as fast per detection at 1,000"
    found = f"{spread(each[1000], ',.0f')} times"
    return (
        f"- The active radar beside {THEIRS[name]}, times as fast per detection: {told}.\n"
        + aim(what, limit, found, is_met=statistics.median(each[1000]) >= AIM)
    )


def _losses(times: dict[tuple[str, int], list[float]]) -> str:
    """Which of ours are slower than the faster of theirs, and at how many targets."""
    slower = [
        f"{title} at {n:,}"
        for n in SIZES_OF_STONESOUP
        for name, (title, _) in CASES.items()
        if statistics.median(times[name, n])
        > min(statistics.median(times[other, n]) for other in THEIRS)
    ]
    return "- Slower than either of Stone Soup's radars: " + ("; ".join(slower) or "none") + "."


def _reached(times: dict[tuple[str, int], list[float]]) -> str:
    """Whether sensors that took long at many targets take as little as they should."""
    n, told = SIZES[-1], []
    for name, aim_ns in AIMS_NS.items():
        ns = statistics.median(times[name, n])
        limit = f"{aim_ns} ns at {n:,} targets"
        told.append(aim(CASES[name][0], limit, f"{ns:,.0f} ns", is_met=ns <= aim_ns))
    return "\n".join(told)


if __name__ == "__main__":
    serve_stonesoup() if sys.argv[1:] == ["serve"] else main()
