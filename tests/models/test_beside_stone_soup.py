"""Scores beside Stone Soup's, which has an environment of its own: sets, and whole trackers."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from support.recordings import START_NS
from support.scored_flights import NS, SITE, Flight, truths_of

from plotfeed.feeds.formats.told_tracks import ToldTrack
from plotfeed.feeds.lab.scoring import Score, ScoreSettings
from plotfeed.feeds.recording.recorded_tracks import TrackTable
from plotfeed.models.track_metrics import set_score

ROOT = Path(__file__).parents[2]
PYTHON = Path(os.environ.get("PLOTFEED_STONESOUP", ROOT / ".venv-stonesoup" / "bin" / "python"))
PROGRAM = ROOT / "tests" / "support" / "stonesoup_scores.py"


def by_stone_soup(asked: dict[str, Any]) -> Any:
    if not PYTHON.exists():
        pytest.skip("Stone Soup is not installed")
    done = subprocess.run(
        [PYTHON, PROGRAM], input=json.dumps(asked), capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_sets_of_any_size_score_alike(order: float) -> None:
    rng = np.random.default_rng(1)
    steps = [
        [rng.uniform(0, 300, (rng.integers(0, 8), 2)), rng.uniform(0, 300, (rng.integers(1, 8), 2))]
        for _ in range(200)
    ]
    asked = {
        "cutoff_m": 60.0,
        "order": order,
        "steps": [[drones.tolist(), tracks.tolist()] for drones, tracks in steps],
    }
    theirs = by_stone_soup(asked)
    for k, (drones, tracks) in enumerate(steps):
        score = set_score(cdist(drones, tracks), 60.0, order)
        told = theirs["gospa"][k]
        assert score.gospa_m(order) == pytest.approx(told["distance"], abs=1e-9)
        assert score.localisation == pytest.approx(told["localisation"], abs=1e-7)
        assert (score.missed, score.false) == pytest.approx((told["missed"], told["false"]))
        assert score.ospa_m <= theirs["ospa"][k] + 1e-9
        if order == 1.0:
            assert score.ospa_m == pytest.approx(theirs["ospa"][k], abs=1e-9)


FLIGHTS = {
    "a": Flight((0.0, 200.0, 100.0), (10.0, 0.0, 0.0)),
    "b": Flight((0.0, 230.0, 100.0), (10.0, 0.0, 0.0)),
    "c": Flight((500.0, -300.0, 100.0), (-2.0, 11.0, 0.0)),
}
PLACES = {
    name: [[float(t), *flight.at(t)[:2].tolist()] for t in range(61)]
    for name, flight in FLIGHTS.items()
}


def scored(tracks: dict[str, list[list[float]]]) -> Score:
    """Our score of tracks that are there at the steps of which they tell alone."""
    table = TrackTable()
    for name, rows in tracks.items():
        for second, east_m, north_m in rows:
            place = SITE.to_geodetic([east_m, north_m, 100.0])
            latitude_deg, longitude_deg, height_m = map(float, place)
            table.add(
                ToldTrack(
                    name=name, t_utc_ns=START_NS + round(second * NS), latitude_deg=latitude_deg,
                    longitude_deg=longitude_deg, height_m=height_m,
                )
            )  # fmt: skip
    return Score(truths_of(FLIGHTS), table.read("theirs"), ScoreSettings(stale_s=0.5))


TITLES = {
    "completeness": "Completeness",
    "ambiguity": "Ambiguity",
    "spuriousness": "Spuriousness",
    "position_accuracy_m": "Position Accuracy",
    "id_correctness": "ID Correctness",
    "id_ambiguity": "ID Ambiguity",
}


def are_alike(score: Score, siap: dict[str, float], tracks: dict[str, list[list[float]]]) -> None:
    """SIAP by other rules of beginning and end: two steps of 61. GOSPA is the same."""
    for name, title in TITLES.items():
        theirs = siap[f"SIAP {title}"]
        assert score.as_stamped[name] == pytest.approx(theirs, abs=0.035, rel=0.03), name
    steps = [
        [
            [row[1:] for rows in of.values() for row in rows if row[0] == t]
            for of in (PLACES, tracks)
        ]
        for t in range(61)
    ]
    theirs = by_stone_soup({"cutoff_m": 50.0, "order": 2.0, "steps": steps})["gospa"]
    mean_m = np.sqrt(np.mean([step["distance"] ** 2 for step in theirs]))
    assert score.as_stamped.gospa_m == pytest.approx(mean_m, rel=2e-3)


def test_trackers_of_stone_soup_score_as_it_says_itself() -> None:
    """Three of them, on plots with gaps and clutter, of drones of which two are 30 m apart."""
    rng = np.random.default_rng(1)
    scans = []
    for t in range(61):
        plots = [
            (np.array(rows[t][1:]) + rng.normal(0, 3.0, 2)).tolist()
            for rows in PLACES.values()
            if rng.random() < 0.9
        ]
        scans.append([t, plots + rng.uniform(-500, 1000, (rng.poisson(1.0), 2)).tolist()])
    asked = {"cutoff_m": 50.0, "truths": PLACES, "scans": scans, "sigma_m": 3.0}
    found = by_stone_soup(asked)
    assert list(found) == ["gnn", "nearest", "jpda"]
    for theirs in found.values():
        assert len(theirs["tracks"]) >= 3
        are_alike(scored(theirs["tracks"]), theirs["siap"], theirs["tracks"])


def test_a_swap_within_the_cut_off_is_counted_as_stone_soup_counts_it() -> None:
    tracks = {
        "1": PLACES["a"][:31] + PLACES["b"][31:],
        "2": PLACES["b"][:31] + PLACES["a"][31:],
        "3": PLACES["c"],
    }
    asked = {"cutoff_m": 50.0, "truths": PLACES, "tracks": tracks}
    score = scored(tracks)
    are_alike(score, by_stone_soup(asked)["given"]["siap"], tracks)
    assert score.as_stamped.swaps == 2.0
    assert score.as_stamped.id_correctness == pytest.approx((2 * 31 + 61) / 183)
