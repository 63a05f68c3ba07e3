"""Scoring a tracker: seconds for an hour of 100 drones, and GOSPA beside Stone Soup's.

    python tools/benchmarks/bench_score.py [SECONDS]

A tracker with an error of 5 m follows 100 drones; one report in twenty is lost, ten tracks are of
no drone. The figures are scaled to an hour. Stone Soup 1.9.1 is asked in `.venv-stonesoup`, where
that is, for GOSPA and OSPA of a few such sets: by turns, in one run.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from aims import aim, ratios, spread, table
from scipy.spatial.distance import cdist

from plotfeed.feeds.lab.flights import Truths
from plotfeed.feeds.lab.scoring import Score, ScoreSettings
from plotfeed.feeds.recording.recorded_tracks import ReportedTracks, TracksRead
from plotfeed.models.frames import LocalFrame
from plotfeed.models.track_metrics import FlightPath, set_score

DRONES, GHOSTS, SECONDS, REPEATS = 100, 10, 600, 3
START_NS, NS, HOUR_S = 1_767_268_800_000_000_000, 1_000_000_000, 3600
SITE = LocalFrame(40.45, -3.73, 650.0)
SIGMA_M, CUTOFF_M = 5.0, 50.0
AIM_S, AIM_TIMES = 60.0, 100.0
STEPS_OF_THEIRS = 5
ROOT = Path(__file__).parents[2]
THEIRS = Path(os.environ.get("PLOTFEED_STONESOUP", ROOT / ".venv-stonesoup" / "bin" / "python"))
PROGRAM = ROOT / "tests" / "support" / "stonesoup_scores.py"


def run_of(seconds: int) -> tuple[Truths, TracksRead]:
    """Flights and what a tracker makes of them."""
    rng = np.random.default_rng(1)
    begin_m = rng.uniform(-4000, 4000, (DRONES, 3)) * [1, 1, 0] + [0, 0, 120]
    velocity_m_s = rng.uniform(-12, 12, (DRONES, 3)) * [1, 1, 0]
    t_s = np.arange(seconds + 1)
    t_ns = START_NS + t_s * NS
    places_m = begin_m[:, None] + t_s[:, None] * velocity_m_s[:, None]
    paths = [FlightPath.of(t_ns, SITE.to_ecef(each), 6 * NS) for each in places_m]
    looks = {(drone, 0): t_ns for drone in range(DRONES)}
    truths = Truths(
        drones=[f"drone-{n}" for n in range(DRONES)],
        paths=paths,
        sensors=["radar"],
        looks_utc_ns=looks,
        site=SITE,
    )
    ghosts_m = rng.uniform(-4000, 4000, (GHOSTS, 1, 3)) * [1, 1, 0] + [0, 0, 300]
    every_m = np.concatenate([places_m, ghosts_m + np.zeros((1, len(t_s), 1))])
    every_m = every_m + SIGMA_M * rng.standard_normal(every_m.shape)
    speeds = np.concatenate([velocity_m_s, np.zeros((GHOSTS, 3))])
    track = np.repeat(np.arange(DRONES + GHOSTS), len(t_s))
    latitude_deg, longitude_deg, height_m = SITE.to_geodetic(every_m.reshape(-1, 3))
    n = len(track)
    when_ns = np.tile(t_ns, DRONES + GHOSTS)
    reports = ReportedTracks(
        t_utc_ns=when_ns,
        received_utc_ns=when_ns + 100_000_000,
        track=track,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=height_m,
        velocity_enu_m_s=speeds[track],
        covariance_m2=np.broadcast_to(SIGMA_M**2 * np.eye(3), (n, 3, 3)).copy(),
        tentative=np.zeros(n, np.bool_),
        ended=np.zeros(n, np.bool_),
    ).rows(rng.random(n) > 0.05)
    names = [str(number) for number in range(DRONES + GHOSTS)]
    return truths, TracksRead(reports=reports, names=names)


def seconds_an_hour(truths: Truths, tracks: TracksRead, how: ScoreSettings, seconds: int) -> float:
    """Processor time of the score, for an hour of it."""
    start = time.process_time()
    Score(truths, tracks, how)
    return (time.process_time() - start) * HOUR_S / seconds


def sets(steps: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Places of drones and tracks at steps, on a plane."""
    rng = np.random.default_rng(2)
    drones = rng.uniform(-4000, 4000, (steps, DRONES, 2))
    tracks = drones + SIGMA_M * rng.standard_normal(drones.shape)
    ghosts = rng.uniform(-4000, 4000, (steps, GHOSTS, 2))
    return [(d, np.concatenate([t, g])) for d, t, g in zip(drones, tracks, ghosts, strict=True)]


def ours_s(given: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Seconds a step for GOSPA and OSPA together."""
    start = time.process_time()
    for drones, tracks in given:
        set_score(cdist(drones, tracks), CUTOFF_M)
    return (time.process_time() - start) / len(given)


def theirs_s(given: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Seconds a step of Stone Soup for the same."""
    steps = [[d.tolist(), t.tolist()] for d, t in given]
    asked = json.dumps({"cutoff_m": CUTOFF_M, "order": 2.0, "steps": steps})
    words = [str(THEIRS), str(PROGRAM)]
    done = subprocess.run(words, input=asked, capture_output=True, text=True, check=True)
    return float(json.loads(done.stdout)["seconds"]) / len(given)


def main(seconds: int) -> None:
    """Measures and prints."""
    truths, tracks = run_of(seconds)
    how = {
        "all figures": ScoreSettings(cutoff_m=CUTOFF_M),
        "without OSPA(2) and T-GOSPA": ScoreSettings(cutoff_m=CUTOFF_M, window_steps=0),
    }
    print(f"Seconds of processor time for an hour of {DRONES} drones, median (least to most) of")
    print(f"{REPEATS}, from {seconds} s.\n")
    found = {
        name: [seconds_an_hour(truths, tracks, settings, seconds) for _ in range(REPEATS)]
        for name, settings in how.items()
    }
    table(("score", "s"), ((name, spread(each)) for name, each in found.items()))
    print()
    whole = found["all figures"]
    is_met = sorted(whole)[len(whole) // 2] <= AIM_S
    print(aim("an hour of 100 drones", f"within {AIM_S:g} s", f"{spread(whole)} s", is_met=is_met))
    if THEIRS.exists():
        given = sets(STEPS_OF_THEIRS)
        pairs = [(ours_s(given * 20), theirs_s(given)) for _ in range(REPEATS)]
        times = ratios([theirs for _, theirs in pairs], [ours for ours, _ in pairs])
        told = f"{spread(times, '.0f')} times as fast"
        is_met = sorted(times)[len(times) // 2] >= AIM_TIMES
        print(aim("GOSPA and OSPA", f"{AIM_TIMES:g} times Stone Soup's", told, is_met=is_met))


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else SECONDS)
