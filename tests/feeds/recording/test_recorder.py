"""Recording beside a session: what is in the file, when, and what a slow or full disk costs."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

import pytest
from support.recordings import MS, SCENE, START_NS, messages, read_log
from support.waiting import until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.recorder import MAX_WAITING_CHUNKS, Recorder, SessionRecorder
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.recorded import Recorded, Stage

MESSAGE = Message(
    topic="plotfeed/radar/asterix/048",
    payload=b"\x30\x00\x04\x00",
    content_type="application/x-asterix; cat=48",
    due_utc_ns=START_NS,
    properties=(("sensor", "radar"), ("scan", "7")),
    retain=True,
    qos=1,
)


def recorded(t_ns: int, stage: Stage = Stage.RECEIVED) -> Recorded:
    """A message as it is recorded at that time."""
    times = {"log_time_ns": t_ns, "publish_time_ns": MESSAGE.due_utc_ns, "stage": stage}
    alike = ("topic", "payload", "content_type", "properties", "retain", "qos")
    return Recorded(**{name: getattr(MESSAGE, name) for name in alike} | times)


def test_a_message_of_a_session_is_there_before_and_after_its_link(tmp_path: Path) -> None:
    path = tmp_path / "session.mcap"
    with Recorder(path, attachments=[SCENE]) as recorder:
        session = SessionRecorder(recorder, ledger_is_sent=True)
        session.received("plotfeed/telemetry/d1", b"t", None, START_NS - MS)
        session.before_link(MESSAGE)
        session.after_link(MESSAGE, START_NS + 300 * MS)
        session.ledger(MESSAGE)
    assert (recorder.messages, recorder.octets, recorder.failure) == (3, 9, "")
    found, reader = read_log(path.read_bytes())
    assert reader.damage == []
    assert reader.attachment("scene.toml") == SCENE
    telemetry = Recorded(
        topic="plotfeed/telemetry/d1",
        payload=b"t",
        log_time_ns=START_NS - MS,
        publish_time_ns=START_NS - MS,
        stage=Stage.TELEMETRY,
    )
    after = recorded(START_NS + 300 * MS, Stage.AFTER)
    assert found == [telemetry, recorded(START_NS, Stage.BEFORE), after]


@pytest.mark.asyncio
async def test_what_comes_after_the_end_is_no_trouble(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap")
    recorder.close()
    recorder.write(recorded(START_NS))
    recorder.close()
    await recorder.stop()
    assert read_log(recorder.path.read_bytes())[0] == []


def test_a_file_that_is_there_is_kept_unless_it_is_to_go(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("mine")
    with pytest.raises(PlotfeedError, match="is there already; --force"):
        Recorder(path)
    assert path.read_text() == "mine"
    with pytest.raises(FileNotFoundError):
        Recorder(tmp_path / "nowhere" / "a.mcap")
    with Recorder(path, force=True) as recorder:
        recorder.write(recorded(-1))  # which no file can hold
        recorder.write(recorded(START_NS))
    assert (recorder.refused, recorder.messages) == (1, 1)
    assert len(read_log(path.read_bytes())[0]) == 1


@pytest.mark.asyncio
async def test_while_it_runs_everything_is_soon_in_the_file(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap")
    running = asyncio.create_task(recorder.run())
    for count in range(1, 4):
        recorder.write(recorded(START_NS + count))
        await until(lambda: len(read_log(recorder.path.read_bytes())[0]) >= count)  # noqa: B023
    await recorder.stop()
    await running  # it ends by itself
    found, reader = read_log((tmp_path / "a.mcap").read_bytes())
    assert len(found) == 3
    assert reader.is_indexed


@pytest.mark.parametrize("waits", [False, True])
def test_a_disk_that_stands_still_costs_messages_and_no_time_or_is_waited_for(
    waits: bool, tmp_path: Path
) -> None:
    sent, go_on = messages(10_000, octets=4000), threading.Event()
    recorder = Recorder(tmp_path / "a.mcap", waits=waits)
    recorder._thread.submit(go_on.wait)
    timer = threading.Timer(0.2, go_on.set)
    if waits:
        timer.start()
    for each in sent:
        recorder.write(each)
    assert recorder.messages + recorder.dropped == len(sent)
    assert (recorder.dropped == 0) if waits else (recorder.dropped > 100)
    assert recorder.octets > MAX_WAITING_CHUNKS * 200_000
    go_on.set()
    recorder.close()
    timer.cancel()
    found, reader = read_log(recorder.path.read_bytes())
    assert found == sent[: recorder.messages]
    assert reader.damage == []


@pytest.mark.asyncio
async def test_a_failure_is_told_once_and_ends_the_recording_alone(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap")
    running = asyncio.create_task(recorder.run())
    recorder.write(recorded(START_NS))
    recorder._mcap.flush()
    recorder._thread.submit(int).result()  # it is in the file
    recorder._file.close()
    recorder.write(recorded(START_NS + 1))
    await running
    assert recorder.failure.startswith(f"{recorder.path}: ")
    assert recorder.failure.endswith("what came after is not in the file")
    recorder.write(recorded(START_NS + 2))
    await recorder.stop()
    assert recorder.messages == 2
    found, reader = read_log(recorder.path.read_bytes())
    assert [m.log_time_ns for m in found] == [START_NS]
    assert len(reader.damage) == 1


def test_what_is_missing_in_a_file_is_told(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap") as recorder:
        recorder._mcap._last_id = 65_535
        recorder.write(recorded(1))
        recorder.dropped = 3
    assert list(recorder.losses()) == [
        f"{recorder.path}: 3 messages were dropped: the disk is slower",
        f"{recorder.path}: 1 messages were not recorded: no such file can hold them",
    ]
