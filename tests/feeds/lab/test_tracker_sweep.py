"""A tracker run at each level: its score, whatever it does, and a sweep that is gone on with."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from support.command import plotfeed_here, refusal
from support.scene_files import STILL, radar, scene_file, scene_text

from plotfeed.feeds.lab.score import ScoreLimit
from plotfeed.feeds.lab.trackers import SHOWN, CurvePoint, TrackerCommand, survivals
from plotfeed.feeds.scene.levels import SweepLevel
from plotfeed.models.frames import LocalFrame
from plotfeed.proto.errors import PlotfeedError

ECHO = Path(__file__).parents[2] / "support" / "echo_tracker.py"
SHORT = ("--duration", 6, "--speed", 2, "--patience", 60, "--json")
LATITUDE, LONGITUDE, _ = map(
    float, LocalFrame(40.45, -3.73, 650.0).to_geodetic([800.0, 600.0, 150.0])
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    more = 'report = ["plots"]'
    return scene_file(tmp_path, scene_text(sensors=radar(more=more), drones=STILL, port=1))


def tracker(how: str) -> str:
    return (
        f"{how}={sys.executable} {ECHO} {{host}} {{port}} {{prefix}} {{topic}} {how} "
        f"{LATITUDE} {LONGITUDE}"
    )


def test_whatever_trackers_do_is_told_beside_their_scores(file: Path, tmp_path: Path) -> None:
    hows = ("good", "silent", "dies", "garbage", "future")
    words = [word for how in hows for word in ("--tracker", tracker(how))]
    done = plotfeed_here("score", file, *words, "--runs", 1, *SHORT, "--folder", tmp_path / "all")
    assert done.returncode == 1, done.stderr
    told = json.loads(done.stdout)
    found = {point["tracker"]: point for point in told["points"]}
    assert list(found) == list(hows)
    assert found["good"]["failures"] == []
    assert found["good"]["figures"]["known_position_accuracy_m"]["value"] < 1.0
    assert found["good"]["figures"]["known_completeness"]["value"] > 0.0
    failed = {how: found[how]["failures"][0] for how in hows[1:]}
    assert failed["dies"] == "the tracker ended by itself, exit code 3: out of luck"
    assert failed["silent"] == "the tracker reported no tracks"
    assert failed["garbage"] == "the tracker reported no tracks"
    assert failed["future"] == "none of the tracker's reports can be used"
    for how in hows[1:]:
        assert found[how]["figures"]["known_completeness"]["value"] == 0.0
    rows = pq.read_table(tmp_path / "all" / "scores.parquet").to_pylist()
    assert [(row["tracker"], row["seed"]) for row in rows] == [(how, 1) for how in hows]
    assert rows[0]["failure"] is None
    assert (tmp_path / "all" / "curve.png").stat().st_size > 10_000


def test_a_level_without_a_drone_in_cover_is_told(file: Path, tmp_path: Path) -> None:
    vary = "sensor.*.range_max_m"
    words = ("score", file, "--tracker", tracker("good"), "--runs", 1, *SHORT[:-1])
    done = plotfeed_here(*words, "--vary", f"{vary}=500,5000", "--folder", tmp_path / "a", "--json")
    assert done.returncode == 0, done.stderr
    without, with_drone = json.loads(done.stdout)["points"]
    assert len(without["unscored"]) == 1
    assert without["figures"]["known_gospa_m"]["value"] is None
    assert with_drone["unscored"] == []
    assert with_drone["figures"]["known_gospa_m"]["value"] > 0.0
    told = plotfeed_here(*words, "--vary", f"{vary}=500,5000", "--folder", tmp_path / "a").stdout
    assert "nothing was scored in 1 of 1 runs: no flight to score against: no drone" in told
    none = plotfeed_here(*words, "--vary", f"{vary}=500,600", "--folder", tmp_path / "b")
    assert (none.returncode, none.stdout) == (2, "")
    assert "no flight to score against" in none.stderr


PROFILE = """
[profile]
title = "Ours"
[[limit]]
figure = "gospa_m"
at_most = 0.001
[[limit]]
figure = "latency_p95_s"
at_most = 5.0
"""


def test_a_profile_holds_at_each_level_and_a_curve_goes_on(file: Path, tmp_path: Path) -> None:
    profile, out, junit = (tmp_path / name for name in ("p.toml", "x.html", "x.xml"))
    profile.write_text(PROFILE)
    words = (
        *("score", file, "--tracker", tracker("good"), "--profile", profile, "--runs", 3),
        *("--vary", "link.latency_ms=0,3000", "--out", out, "--junit", junit, *SHORT),
        *("--folder", tmp_path / "score"),
    )
    done = plotfeed_here(*words)
    assert done.returncode == 1, done.stderr
    told = json.loads(done.stdout)
    values = [point["values"] for point in told["points"]]
    assert values == [{"link.latency_ms": 0}, {"link.latency_ms": 3000}]
    for point in told["points"]:
        gospa, latency = point["limits"]
        assert (gospa["status"], latency["status"]) == ("failed", "passed")
        assert gospa["note"] == "as known"
    assert [each["limit"] for each in told["survives"]] == [
        "gospa_m at most 0.001", "latency_p95_s at most 5",
    ]  # fmt: skip
    page = out.read_text()
    for part in ("2 of 4 limits kept, 2 failed", "<svg", "GOSPA", "plotfeed 0.", "Words"):
        assert part in page
    assert junit.read_text().count("<failure") == 2
    out.unlink()
    junit.unlink()
    rows = str(pq.read_table(tmp_path / "score" / "scores.parquet").to_pylist())
    assert json.loads(plotfeed_here(*words).stdout)["were_done"] == 6
    assert str(pq.read_table(tmp_path / "score" / "scores.parquet").to_pylist()) == rows
    out.unlink()
    junit.unlink()
    assert "begun with other --seed" in refusal(*words, "--seed", 7)


def points_of(limit: ScoreLimit, values: np.ndarray, late_s: float = 0.0) -> list[CurvePoint]:
    """A tracker at latencies of 0 to 2 s, by a limit's figures, (levels, runs)."""
    rest = {
        "failure": "",
        "late_s": late_s,
        "figures": dict.fromkeys(SHOWN, 1.0),
        "trials": [np.nan],
    }
    runs = {at: rest | {"limits": [value]} for at, value in np.ndenumerate(values)}
    levels = [
        SweepLevel(n, "scene", "", "", (("link.latency_ms", str(500 * n)),))
        for n in range(len(values))
    ]
    return [CurvePoint(level, "mine", runs, [limit], 1) for level in levels]


def test_what_a_tracker_survives_is_told_with_an_interval_or_why_not() -> None:
    """As known GOSPA rises with latency; the machine may be late by a tenth of what is varied."""
    limit = ScoreLimit(figure="gospa_m", at_most=60.0)
    rng = np.random.default_rng(1)
    values = np.array([52.8, 57.0, 62.5, 66.0, 70.2])[:, None] + rng.normal(0, 1.0, (5, 10))
    (found,) = survivals(points_of(limit, values, late_s=0.15), [limit])
    assert 600 < found.level.low < found.level.value < found.level.high < 1000
    assert str(found).startswith("mine, gospa_m at most 60: holds to ")
    assert "of link.latency_ms (" in str(found)
    (late,) = survivals(points_of(limit, values, late_s=0.25), [limit])
    assert str(late).endswith("not told: the machine itself was late by 0.25 s")
    (kept,) = survivals(points_of(limit, values - 20.0), [limit])
    assert str(kept).endswith("holds at all levels of link.latency_ms (all levels to all levels)")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--vary", "link.latency_ms=0"), "--vary needs --tracker"),
        (("--tracker", "no-such-program"), "no program 'no-such-program' can be started"),
        (("--tracker", "sh {port} {where}"), "{where}: expected one of broker"),
        (("--tracker", "sh 'open"), "No closing quotation"),
        (("--tracker", "sh", "--tracker", "sh"), "several need names of their own"),
        (("--tracker", "sh", "--feed"), "--feed contradicts --tracker"),
        (("--tracker", "sh", "--vary", "sensor.x.pfa=1"), "no sensor 'x'"),
    ],
)
def test_what_cannot_be_is_told_before_anything_runs(
    file: Path, tmp_path: Path, options: tuple[str, ...], said: str
) -> None:
    assert said in refusal("score", file, *options, "--folder", tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_what_stands_in_braces_is_filled_in() -> None:
    command = TrackerCommand.parse("mine=sh -c 'follow {broker} > /dev/null' {topic}")
    assert command.name == "mine"
    assert command.filled({"broker": "mqtt://h:1", "topic": "a b"}) == [
        "sh", "-c", "follow mqtt://h:1 > /dev/null", "a b",
    ]  # fmt: skip
    with pytest.raises(PlotfeedError):
        TrackerCommand.parse("")
