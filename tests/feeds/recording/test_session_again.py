"""The record of a session is run again as it was; one from before sessions had ticks is told of."""

from __future__ import annotations

import asyncio
import json
import tempfile
from pathlib import Path

import pytest
from support.command import plotfeed_here, started
from support.scene_files import radar, scene_file, scene_text
from support.sessions import AtWork
from support.waiting import wait_until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.recorder import (
    RecordedTelemetry,
    Recorder,
    SessionRecord,
    SessionRecorder,
    attachments_of,
)
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock, WallClock
from plotfeed.proto.content_types import JSON
from plotfeed.proto.utc import NS, iso_utc
from plotfeed.replay.mcap.mcap_reader import McapReader

START_NS = 1_767_268_800 * NS
SIMULATED = ("--speed", "max", "--broker", "none", "--json")


@pytest.fixture
def record(tmp_path: Path) -> Path:
    text = scene_text(start_utc="2026-01-01T12:00:00Z", sensors=radar(), port=1883)
    path = tmp_path / "record.mcap"
    scene = scene_file(tmp_path, text)
    done = plotfeed_here("run", scene, "--duration", "3", "--record", path, *SIMULATED)
    assert done.returncode == 0, done.stderr
    return path


def without_ticks(record: Path, path: Path) -> Path:
    """The record as a session made it that knew no ticks."""
    with McapReader(record) as mcap:
        attached = [mcap.attachment(entry.name) for entry in mcap.attachments()]
        messages = list(mcap.messages())
    recorder = Recorder(path, attachments=[one for one in attached if one is not None], waits=True)
    for message in messages:
        if message.topic.endswith("/session"):
            told = json.loads(message.payload)
            assert told.pop("tick_ms") == 10
            message = message._replace(payload=json.dumps(told).encode())  # noqa: PLW2901
        recorder.write(message)
    recorder.close()
    return path


def test_a_record_is_run_again_without_a_word(record: Path) -> None:
    assert SessionRecord.open(record).has_ticks
    again = plotfeed_here("run", record, *SIMULATED)
    assert again.returncode == 0
    assert again.stderr == ""
    assert json.loads(again.stdout)["messages"] > 0


def test_a_record_from_before_there_were_ticks_is_run_and_told_of(
    record: Path, tmp_path: Path
) -> None:
    old = without_ticks(record, tmp_path / "old.mcap")
    assert not SessionRecord.open(old).has_ticks
    again = plotfeed_here("run", old, *SIMULATED)
    assert again.returncode == 0
    assert again.stderr.startswith(f"plotfeed: {old} was made before sessions went by ticks")
    assert json.loads(again.stdout)["messages"] > 0


@pytest.mark.asyncio
async def test_what_came_in_while_a_fast_clock_was_held_back_counts_again_as_it_did(
    tmp_path: Path,
) -> None:
    """Reports and changes from outside, at a speed that no machine holds: the same octets."""
    text = scene_text(start_utc="2026-01-01T12:00:00Z", sensors=radar(), port=1883)
    scene = load(scene_file(tmp_path, text))
    path, first, again = tmp_path / "x.mcap", list[Message](), list[Message]()
    clock, watch = WallClock(START_NS, speed=10_000.0), AtWork(InstantClock(START_NS))

    async def asking() -> None:
        await watch.begins.wait()
        for number in range(10**9):
            report = {
                "time_utc": iso_utc(clock.now_ns()),
                "latitude_deg": 40.455 + 0.0001 * (number % 5),
                "longitude_deg": -3.72,
                "altitude_m": 900.0,
                "altitude_reference": "ELLIPSOID",
            }
            watch.session._hear("plotfeed/telemetry/other", json.dumps(report).encode(), JSON)
            change = {"sensor": "radar", "set": {"pfa_factor": 1 + number % 7}}
            if number % 2:  # as the page asks
                watch.session.command(change)
            else:
                watch.session._hear("plotfeed/control", json.dumps(change).encode(), JSON)
            await asyncio.sleep(0.002)

    with Recorder(path, attachments=attachments_of(scene, START_NS), waits=True) as recorder:
        beside = asyncio.create_task(asking())
        totals = await run(
            scene,
            clock=clock,
            broker="none",
            duration_s=60.0,
            observers=[watch, SessionRecorder(recorder, ledger_is_sent=True)],
            tap=lambda message, _t: first.append(message),
        )
        beside.cancel()
    assert (totals.missed_scans, totals.speed) == (0, 10_000.0)
    assert 1 < (totals.speed_reached or 0) < 5_000
    assert min(totals.controls, totals.telemetry) > 5
    await run(
        scene,
        clock=InstantClock(START_NS),
        broker="none",
        duration_s=60.0,
        observers=[RecordedTelemetry(path)],
        tap=lambda message, _t: again.append(message),
    )
    sectors = [(m.topic, m.payload) for m in first if "/asterix/" in m.topic]
    assert len(sectors) > 960
    assert sectors == [(m.topic, m.payload) for m in again if "/asterix/" in m.topic]


class SlowToConnect(InstantClock):
    """A session that connects for a while before its time begins."""

    def start(self) -> int:
        self.jump(self.now_ns() + 146_800_123)
        return super().start()


@pytest.mark.asyncio
async def test_scripted_drones_set_out_when_the_session_is_said_to_begin(tmp_path: Path) -> None:
    scene = load(scene_file(tmp_path, scene_text(sensors=radar(), port=1883)))
    path, first, again = tmp_path / "x.mcap", list[Message](), list[Message]()
    with Recorder(path, attachments=attachments_of(scene, 0), waits=True) as recorder:
        observers = [SessionRecorder(recorder, ledger_is_sent=True)]
        clock = SlowToConnect(1_700_000_000_000_000_000)
        taps = {"tap": lambda message, _t: first.append(message)}
        await run(scene, clock=clock, broker="none", duration_s=4.0, observers=observers, **taps)
    clock = InstantClock(SessionRecord.open(path).start_utc_ns)
    taps = {"tap": lambda message, _t: again.append(message)}
    await run(scene, clock=clock, broker="none", duration_s=4.0, **taps)
    first, again = (
        sorted((m.topic, m.payload) for m in messages if not m.topic.endswith("/session"))
        for messages in (first, again)
    )
    assert first == again
    assert len(first) > 20


def test_a_folder_that_a_killed_run_has_left_is_cleared_by_the_next(
    record: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir()
    words = ("run", record, "--broker", "none", "--duration", "3600")
    with started(*words) as killed, started(*words):
        wait_until(lambda: len([*(tmp_path / "tmp").glob("plotfeed-run-*/lock")]) == 2)
        left = {*(tmp_path / "tmp").glob("plotfeed-run-*")}
        killed.kill()
        killed.wait()
        with pytest.MonkeyPatch.context() as anew:
            anew.setattr(tempfile, "tempdir", None)  # the environment says which
            assert plotfeed_here("run", record, *SIMULATED).returncode == 0
        still = {*(tmp_path / "tmp").glob("plotfeed-run-*")}
        assert len(still) == 1
        assert still < left


@pytest.mark.parametrize(
    "options", [("--start", "1", "--end", "2"), ("--topic", "plotfeed/radar/#")]
)
def test_a_part_of_a_record_is_a_record(
    options: tuple[str, ...], record: Path, tmp_path: Path
) -> None:
    part = tmp_path / "part.mcap"
    assert plotfeed_here("convert", record, part, *options).returncode == 0
    assert SessionRecord.open(part).start_utc_ns == SessionRecord.open(record).start_utc_ns
    again = plotfeed_here("run", part, *SIMULATED)
    assert (again.returncode, again.stderr) == (0, "")
    with McapReader(record) as whole, McapReader(part) as some:
        told = {m.topic: m.payload for m in whole.messages() if m.log_time_ns == START_NS}
        of_part = list(some.messages())
    if options[0] == "--start":
        first = {m.topic: m.payload for m in of_part if m.log_time_ns == START_NS + NS}
        for name in ("radar/settings", "radar/description", "session"):
            assert first[f"plotfeed/{name}"] == told[f"plotfeed/{name}"]
        assert all(START_NS + NS <= m.log_time_ns < START_NS + 2 * NS for m in of_part)
        report = plotfeed_here("report", part)
        assert "scene test" in report.stdout
        assert "cannot be used" not in report.stdout
    else:
        assert {m.topic.split("/")[1] for m in of_part} == {"radar", "session"}
