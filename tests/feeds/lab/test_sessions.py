"""Whole sessions over impaired links: what their record reports is what their scenes asked."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from support.ledgers import as_received, changed, record_session, told, written
from support.road import NS, START_NS
from support.scene_files import DRONE, radar, scene_file, scene_text
from support.significance import assert_chance

from plotfeed.feeds.lab.asked import AskedByTime, RecordedSettings
from plotfeed.feeds.lab.figures import LedgerReport, SensorFigures, as_values
from plotfeed.feeds.lab.links import LinkFigures
from plotfeed.feeds.scene.scene import load
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import Recorded, Stage

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
SCENE = scene_text(
    sensors=radar("lossy", more=f"{BOTH}\n{LOSSY}")
    + EVENTS
    + radar("weak", period_s=1.0, more=BOTH).replace("500.0", "0.05"),
    drones=DRONE + DRONE.replace("visitor", "other").replace("800.0", "9000.0"),
    port=1883,
)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("session")
    return record_session(scene_file(folder, SCENE), folder / "session.mcap", SECONDS)


@pytest.fixture(scope="module")
def reported(session: Path) -> LedgerReport:
    return told(session)


def link_of(report: LedgerReport, sensor: str, number: int = 1) -> LinkFigures:
    return next(x for x in report.links if (x.sensor, x.number) == (sensor, number))


def sensor_of(report: LedgerReport, name: str) -> SensorFigures:
    return next(x for x in report.sensors if x.sensor == name)


def assert_z(z: float, of: str) -> None:
    assert_chance(2 * stats.norm.sf(abs(z)), f"{of}, z = {z:+.2f}")


def test_the_link_delivers_what_the_scene_asks(reported: LedgerReport) -> None:
    lossy = link_of(reported, "lossy")
    assert lossy.sent > 2000
    assert_chance(lossy.fit.p_value, "delay")
    assert lossy.lateness.max_ms == 0.0
    assert_z(lossy.loss.z, "loss")
    assert_z(lossy.bursts.z, "bursts")
    assert_z(lossy.duplicates.z, "doubled")
    assert_z(lossy.corrupted.z, "corrupted")
    assert 0 < lossy.overtook.delivered < 0.5


def test_a_scripted_outage_is_a_setting_of_its_own(reported: LedgerReport) -> None:
    down = link_of(reported, "lossy", 2)
    assert down.messages == down.other_fates["outage"] > 200
    assert down.last_utc_ns - down.first_utc_ns == pytest.approx(10e9, abs=0.2e9)
    assert len(reported.links) == 3


def test_detection_is_by_the_odds_of_the_looks(reported: LedgerReport) -> None:
    for sensor in reported.sensors:
        assert sensor.looks is not None
        assert sensor.looks.looks > 150
        for at in (sensor.looks, *sensor.looks_by_range):
            if not np.isnan(at.z):
                assert_z(at.z, f"{sensor.sensor} from {at.from_m} m")
    weak = sensor_of(reported, "weak").looks
    assert weak is not None
    assert 0.2 < weak.asked < 0.9
    assert not np.isnan(weak.z)


def test_errors_of_plots_are_as_stated(reported: LedgerReport) -> None:
    for sensor in reported.sensors:
        assert sensor.joined == sensor.plots > 80
        assert sensor.plots_from == "plots, before the link"
        quantities = ["range", "azimuth", "elevation", "height"]
        assert [error.quantity for error in sensor.errors] == quantities
        for error in sensor.errors:
            assert_z(error.z_mean, f"{sensor.sensor} {error.quantity} mean")
            assert_z(error.z_rms, f"{sensor.sensor} {error.quantity} rms")


def test_false_alarms_are_those_of_the_scene_and_its_events(reported: LedgerReport) -> None:
    lossy, weak = (sensor_of(reported, name).false_alarms for name in ("lossy", "weak"))
    for alarms, scans in ((lossy, 200), (weak, 100)):
        assert alarms.scans == pytest.approx(scans, abs=1.5)
        assert_z(alarms.z, "false alarms")
    # Of 100 s, 30 s have five times as many.
    assert lossy.asked_per_scan / weak.asked_per_scan == pytest.approx(220 / 100, rel=0.01)


def rewritten(
    session: Path, path: Path, change: Callable[[Iterable[Recorded]], Iterable[Recorded]]
) -> Path:
    with McapReader(session) as log:
        return written(path, change(log.messages()))


def test_what_a_broker_has_heard_is_told_as_far_as_it_goes(
    session: Path, reported: LedgerReport, tmp_path: Path
) -> None:
    heard = told(rewritten(session, tmp_path / "heard.mcap", as_received))
    assert heard.scene == ""
    assert as_values(heard)["links"] == as_values(reported)["links"]
    whole, lossy = sensor_of(reported, "lossy"), sensor_of(heard, "lossy")
    assert lossy.plots_from == "plots, as received"
    assert 0.6 * whole.joined < lossy.joined < 0.9 * whole.joined
    for error in lossy.errors:
        assert_z(error.z_mean, "mean")
        assert_z(error.z_rms, "rms")
    assert lossy.looks == whole.looks
    assert np.isnan([lossy.false_alarms.asked, lossy.false_alarms.z]).all()
    assert lossy.false_alarms.count == whole.false_alarms.count


def test_plots_are_read_from_asterix_where_there_are_no_batches(
    session: Path, reported: LedgerReport, tmp_path: Path
) -> None:
    def without_batches(messages: Iterable[Recorded]) -> Iterable[Recorded]:
        return (each for each in messages if not each.topic.endswith("/plots"))

    found = sensor_of(told(changed(session, tmp_path / "a.mcap", without_batches)), "lossy")
    whole = sensor_of(reported, "lossy")
    assert found.plots_from == "asterix/048, before the link"
    assert found.joined == whole.joined
    assert [error.quantity for error in found.errors] == ["range", "azimuth", "height"]
    exact_errors = {exact.quantity: exact for exact in whole.errors}
    for error in found.errors:
        steps = {"range": 1852 / 256, "azimuth": 360 / 65536, "height": 25 * 0.3048}
        step, exact = steps[error.quantity], exact_errors[error.quantity]
        assert error.stated == 0
        assert error.compared > 0.8 * found.joined
        assert_chance(error.p_mean, f"{error.quantity} mean")
        assert_chance(error.p_rms, f"{error.quantity} rms")
        assert error.rms**2 == pytest.approx(exact.rms**2 + step**2 / 12, rel=0.2)


def test_without_what_was_measured_no_errors_are_told(session: Path, tmp_path: Path) -> None:
    def ledger_alone(messages: Iterable[Recorded]) -> Iterable[Recorded]:
        return (each for each in messages if each.topic.endswith("/truth"))

    found = told(rewritten(session, tmp_path / "a.mcap", ledger_alone))
    for sensor in found.sensors:
        assert (sensor.joined, sensor.plots_from, list(sensor.errors)) == (0, "", [])
        assert sensor.plots > 80


def test_plots_that_contradict_the_ledger_are_not_joined(session: Path, tmp_path: Path) -> None:
    def shifted(messages: Iterable[Recorded]) -> Iterable[Recorded]:
        for each in messages:
            if each.topic.endswith("/plots") and each.stage is Stage.BEFORE:
                batch = pb.PlotBatch.FromString(each.payload)
                for plot in batch.plots[1:]:
                    plot.time_utc_ns += 1
                yield each._replace(payload=batch.SerializeToString())
            elif each.topic.endswith("/truth"):
                yield each

    found = told(rewritten(session, tmp_path / "a.mcap", shifted))
    for sensor in found.sensors:
        assert 0 < sensor.contradicted == sensor.plots - sensor.joined
    wrong = [(verdict.sensor, verdict.quantity) for verdict in found.verdicts.wrong]
    assert wrong == [("lossy", "plots"), ("weak", "plots")]


def test_what_control_changed_counts_from_then_on(tmp_path: Path) -> None:
    scene = load(scene_file(tmp_path, SCENE))
    sensor, settings = scene.sensor[1], RecordedSettings(scene)
    asked = AskedByTime(scene, sensor, settings, START_NS)
    first = START_NS // NS + 1

    def alarms(scan: int) -> float:
        then = asked.in_sector(scan, 0)
        return np.nan if then is None else then.false_alarms_per_scan

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
