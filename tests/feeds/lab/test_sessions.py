"""Whole sessions over impaired links: what their record reports is what their scenes asked."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from support.command import plotfeed_here
from support.ledgers import as_received, changed, record_session, told, written
from support.scene_files import DRONE, radar, scene_file, scene_text
from support.significance import assert_chance

from plotfeed.feeds.lab.evidence import AskedByTime
from plotfeed.feeds.lab.gathering import FeedReport, SensorFigures
from plotfeed.feeds.lab.links import LinkFigures
from plotfeed.feeds.lab.report import lines
from plotfeed.feeds.recording.recorded_settings import RecordedSettings
from plotfeed.feeds.scene.scene import load
from plotfeed.models.residuals import Check
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Recorded, Stage
from plotfeed.testing import START_NS

SECONDS = 100.0
LOSSY = """
link = { latency_ms = 80.0, jitter_ms = 15.0, delay_correlation = 0.3, duplicate = 0.05, \
corrupt = 0.05, loss = { kind = "gilbert-elliott", mean_loss = 0.1, mean_burst = 3.0 } }
"""
EVENTS = """
[[sensor.event]]
from_s = 40.0
to_s = 70.0
set = { pfa_factor = 5 }
[[sensor.event]]
from_s = 80.0
to_s = 90.0
set = { link = { down = true } }
"""
BOTH = 'report = ["asterix-048", "plots"]'
OTHERS = """
[[birds]]
id = "gulls"
count = 5
rcs_m2 = 0.01
path = [
    { east_m = 800.0, north_m = 1500.0, above_site_m = 80.0 },
    { east_m = -900.0, north_m = 1500.0, above_site_m = 80.0 },
]

[[clutter]]
id = "woods"
plots_per_km2 = 20.0
area = [
    { east_m = -1500.0, north_m = -500.0, above_site_m = 0.0 },
    { east_m = 1500.0, north_m = -500.0, above_site_m = 0.0 },
    { east_m = 1500.0, north_m = -2000.0, above_site_m = 0.0 },
]
"""
SCENE = scene_text(
    sensors=radar("lossy", more=f"{BOTH}\n{LOSSY}")
    + EVENTS
    + radar("weak", period_s=1.0, more=BOTH).replace("500.0", "0.05"),
    drones=DRONE + DRONE.replace("visitor", "other").replace("800.0", "9000.0") + OTHERS,
    port=1883,
)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("session")
    return record_session(load(scene_file(folder, SCENE)), folder / "session.mcap", SECONDS)


@pytest.fixture(scope="module")
def reported(session: Path) -> FeedReport:
    return told(session)


def link_of(report: FeedReport, sensor: str, number: int = 1) -> LinkFigures:
    return next(x for x in report.links if (x.sensor, x.number) == (sensor, number))


def sensor_of(report: FeedReport, name: str) -> SensorFigures:
    return next(x for x in report.sensors if x.sensor == name)


def checks_of(report: FeedReport, sensor: str) -> dict[str, Check]:
    return {c.name: c for c in report.verdicts.checks if c.sensor == sensor and not c.link}


def test_a_scripted_outage_is_a_setting_of_its_own(reported: FeedReport) -> None:
    down = link_of(reported, "lossy", 2)
    assert down.messages == down.other_fates["outage"] > 200
    assert down.last_utc_ns - down.first_utc_ns == pytest.approx(10e9, abs=0.2e9)
    assert len(reported.links) == 3


def test_birds_are_looked_at_and_clutter_is_not_and_neither_is_a_false_alarm(
    session: Path, reported: FeedReport
) -> None:
    told = sensor_of(reported, "lossy")
    assert set(told.plots_of_others) == {"bird", "clutter"}
    assert min(told.plots_of_others.values()) > 100
    assert told.plots > told.plots_of_others["bird"]
    alarms = checks_of(reported, "lossy")["false alarms"]
    assert_chance(alarms.p, f"{alarms.found} of {alarms.expected}")
    assert reported.verdicts.wrong == []
    assert any("plots of no drone and no false alarms" in line for line in lines(reported))
    listed = plotfeed_here("show", session, "--list", "--topic", "plotfeed/truth").stdout
    assert "of clutter/woods" in listed
    assert "of bird/gulls-" in listed


def test_sectors_that_the_link_lost_or_spoilt_are_no_fault_of_the_feed(session: Path) -> None:
    """A tenth of the messages is lost, a twentieth has a bit flipped, and ten seconds are down."""
    claimed = FeedReport(session, "claimed")
    lossy, checks = sensor_of(claimed, "lossy"), checks_of(claimed, "lossy")
    assert 0.15 < lossy.lost / (lossy.lost + lossy.entries) < 0.35
    for name in ("Pd", "false alarms", "range", "azimuth spread"):
        assert_chance(checks[name].p, f"{checks[name]}")


def assert_errors(found: dict[str, Check], quantities: list[str]) -> None:
    assert {name.removesuffix(" spread") for name in found if "spread" in name} == {*quantities}
    for name in quantities:
        assert_chance(found[name].p, name)
        assert_chance(found[f"{name} spread"].p, f"{name} spread")


def test_what_a_broker_has_heard_is_told_as_far_as_it_goes(
    session: Path, reported: FeedReport, tmp_path: Path
) -> None:
    with McapReader(session) as log:  # without its scene
        heard = told(written(tmp_path / "heard.mcap", as_received(log.messages())))
    assert heard.scene == ""
    assert heard.as_values()["links"] == reported.as_values()["links"]
    whole, lossy = sensor_of(reported, "lossy"), sensor_of(heard, "lossy")
    assert lossy.plots_from == "plots, as received"
    assert 0.6 * whole.joined < lossy.joined < 0.9 * whole.joined
    assert not lossy.is_known
    assert list(checks_of(heard, "lossy")) == ["plots"]
    for heard_of, at in zip(lossy.looks_by_range, whole.looks_by_range, strict=True):
        assert (heard_of.from_m, heard_of.looks, heard_of.found) == (at.from_m, at.looks, at.found)
        assert heard_of.expected == pytest.approx(at.expected, rel=1e-9)  # the ledger's own
    assert {name: sum(n) for name, n in lossy.histograms.items()} == dict.fromkeys(
        ("range", "azimuth", "elevation"), lossy.joined
    )


STEPS = {"range": 1852 / 256, "azimuth": 360 / 65536, "height": 25 * 0.3048}


def test_plots_are_read_from_asterix_where_there_are_no_batches(
    session: Path, reported: FeedReport, tmp_path: Path
) -> None:
    def without_batches(messages: Iterable[Recorded]) -> Iterable[Recorded]:
        return (each for each in messages if not each.topic.endswith("/plots"))

    of_blocks = told(changed(session, tmp_path / "a.mcap", without_batches))
    found = sensor_of(of_blocks, "lossy")
    whole = sensor_of(reported, "lossy")
    assert found.plots_from == "asterix/048, before the link"
    assert found.joined == whole.joined
    checks = checks_of(of_blocks, "lossy")
    assert_errors(checks, ["range", "azimuth", "height"])
    for name, step in STEPS.items():
        exact = checks_of(reported, "lossy")[name]
        assert checks[name].of > 0.8 * found.joined
        # What rounding adds is in the standard error: at most as much as a uniform error.
        rounded, fine = (each.of * each.sigma**2 for each in (checks[name], exact))
        assert fine < rounded < 1.2 * (fine + step**2 / 12)


def test_plots_that_are_not_there_or_contradict_the_ledger_are_not_joined(
    session: Path, tmp_path: Path
) -> None:
    """One sensor has none, and the times of the other's are a nanosecond off."""

    def shifted(messages: Iterable[Recorded]) -> Iterable[Recorded]:
        for each in messages:
            if each.topic.endswith("weak/plots") and each.stage is Stage.BEFORE:
                batch = pb.PlotBatch.FromString(each.payload)
                for plot in batch.plots[1:]:
                    plot.time_utc_ns += 1
                yield each._replace(payload=batch.SerializeToString())
            elif each.topic.endswith("/truth"):
                yield each

    with McapReader(session) as log:
        found = told(written(tmp_path / "a.mcap", shifted(log.messages())))
    lossy, weak = (sensor_of(found, name) for name in ("lossy", "weak"))
    assert (lossy.joined, lossy.plots_from, [*lossy.histograms]) == (0, "", [])
    assert lossy.plots > 80
    assert 0 < weak.contradicted == weak.plots - weak.joined
    wrong = [(verdict.sensor, verdict.name) for verdict in found.verdicts.wrong]
    assert wrong == [("weak", "plots")]


def test_what_control_changed_counts_from_then_on(tmp_path: Path) -> None:
    scene = load(scene_file(tmp_path, SCENE))
    sensor, settings = scene.sensor[1], RecordedSettings(scene)
    asked = AskedByTime(scene, sensor, settings, START_NS)
    first = START_NS // NS + 1

    def alarms(scan: int) -> float:
        then = asked.in_sector(scan, 0)
        return np.nan if then is None else then.false_alarms[0]

    before = alarms(first)
    said = {"controlled": {"pfa_factor": 3}, "in_force": {}}
    settings.take(sensor.id, json.dumps(said).encode(), START_NS + 10 * NS)
    settings.take(sensor.id, b"{", START_NS + 11 * NS)
    assert alarms(first) == before
    assert alarms(first + 20) == pytest.approx(3 * before)
    settings.take(
        sensor.id, json.dumps({"controlled": {"pfa": "much"}}).encode(), START_NS + 30 * NS
    )
    assert np.isnan(alarms(first + 40))
