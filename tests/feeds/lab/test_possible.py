"""Whose fault a loss is: a tracker is not blamed for what sensors or links did not bring."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.ledgers import record_session
from support.scene_files import radar, scene_file, scene_text
from support.scored_flights import read_of

from plotfeed.feeds.lab.flights import scene_of
from plotfeed.feeds.lab.possible import Possible, RecordedRun, possible, read_run
from plotfeed.feeds.lab.scoring import Score, ScoreSettings
from plotfeed.feeds.lab.track_reports import TracksRead, read_tracks

MORE = 'report = ["asterix-062", "plots"]\ntracks = { kind = "plain" }\n'


def run_of(folder: Path, more: str = "") -> tuple[RecordedRun, TracksRead]:
    """A session of 40 s with the plain tracker of its radar."""
    text = scene_text(start_utc="2026-01-01T12:00:00Z", sensors=radar(more=MORE + more))
    path = record_session(scene_file(folder, text), folder / "x.mcap", 40.0)
    return read_run(path), read_tracks(path, scene_of(path))


def split(run: RecordedRun, tracks: TracksRead) -> Possible:
    found = possible(run, Score(run.truths, tracks, ScoreSettings()))
    assert found is not None
    return found


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> tuple[RecordedRun, TracksRead]:
    return run_of(tmp_path_factory.mktemp("clean"))


@pytest.mark.parametrize(
    ("more", "whose"),
    [("degradation = { pd_factor = 0.25 }", "feed"), ("link = { latency_ms = 4000 }", "link")],
)
def test_a_loss_is_of_whoever_caused_it(
    tmp_path: Path, more: str, whose: str, clean: tuple[RecordedRun, TracksRead]
) -> None:
    found = [split(*clean), split(*run_of(tmp_path, more))]
    before, after = ({"feed": of.of_feed_m, "link": of.of_link_m} for of in found)
    assert after[whose] > 1.5 * before[whose] + 3.0
    other = "link" if whose == "feed" else "feed"
    assert after[other] < 1.5 * before[other] + 3.0


def test_a_tracker_that_says_nothing_is_to_blame(clean: tuple[RecordedRun, TracksRead]) -> None:
    run, _ = clean
    found = split(run, read_of([]))
    assert found.of_tracker_m > 3 * np.hypot(found.of_feed_m, found.of_link_m)
    assert "most is the tracker's" in str(found)
    assert found.completeness > 0.9
    assert 0.5 < found.position_rms_m / found.bound_m < 2.0
    assert f"no tracker does better than {found.bound_m:.1f} m" in str(found)
    assert found.placeless == 0
    score = Score(run.truths, read_of([]), ScoreSettings())
    assert possible(RecordedRun(run.truths), score) is None  # without plots nothing is said
