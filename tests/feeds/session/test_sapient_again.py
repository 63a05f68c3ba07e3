"""A session that was asked things over SAPIENT is run again as it was, answers and all."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from sapient_msg.bsi_flex_335_v2_0.task_pb2 import Task
from support.sapient_middleware import Peer, listening
from support.sapient_tasks import ONE, THREE, TWO, task
from support.waiting import until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.recorder import (
    RecordedTelemetry,
    Recorder,
    SessionRecord,
    SessionRecorder,
    attachments_of,
)
from plotfeed.feeds.session.observer import Tap
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.testing import radar, scene, staring

SENSORS = [radar(report=["sapient"], scan=staring(0.1), pfa=1e-6)]

KINDS = {"plotfeed.sapient", "plotfeed.sapient.answer"}


def octets(messages: list[Message]) -> list[bytes]:
    """Of detections and answers; statuses between them have stamps of their own."""
    return [m.payload for m in messages if dict(m.properties).get("type") in KINDS]


@pytest.mark.asyncio
async def test_tasks_are_recorded_and_done_again(tmp_path: Path) -> None:
    path, stop, first = tmp_path / "record.mcap", asyncio.Event(), list[Message]()

    async def asking(peer: Peer) -> None:
        await peer.next()
        peer.acknowledge()
        hearing = asyncio.create_task(peer.hear_all())
        for asked in (
            task(ONE, detection_threshold="DISCRETE_THRESHOLD_LOW"),
            task(TWO, mode_change="standby"),
            task(TWO, Task.CONTROL_STOP),
            task(THREE, request="dance"),
        ):
            answers = peer.kinds().count("task_ack")
            await asyncio.sleep(0.25)
            peer.send(asked)
            await until(lambda answers=answers: peer.kinds().count("task_ack") > answers)
        await asyncio.sleep(0.25)
        stop.set()
        await hearing

    async with listening(asking) as middleware:
        flown = scene(SENSORS, seed=3, sapient={"middleware": middleware.address})
        recorder = Recorder(path, attachments=attachments_of(flown, 0), waits=True)
        observers = [
            Tap(lambda message, _t_utc_ns: first.append(message)),
            SessionRecorder(recorder, ledger_is_sent=False),
        ]
        totals = await run(flown, broker="none", stop=stop, observers=observers)
        recorder.close()
    assert (totals.sapient_tasks, totals.sapient_rejected) == (3, 1)

    record, again = SessionRecord.open(path), list[Message]()
    last_ns = max(m.due_utc_ns for m in first if octets([m]))
    await run(
        scene(SENSORS, seed=3),
        clock=InstantClock(record.start_utc_ns),
        broker="none",
        duration_s=(last_ns - record.start_utc_ns) / 1e9 + 1e-6,
        observers=[Tap(lambda message, _t_utc_ns: again.append(message)), RecordedTelemetry(path)],
    )
    missed = set(octets(again)) - set(octets(first))  # scans, if the machine was late
    assert len(octets(first)) > 20
    # What is asked just before a tick is answered before what is due at it, or after.
    assert sorted(one for one in octets(again) if one not in missed) == sorted(octets(first))
