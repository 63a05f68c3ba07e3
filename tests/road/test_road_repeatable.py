"""The same scene gives the same bytes, and what does not concern a sensor changes none of its."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from plotfeed.feeds.messages.message import Message
from plotfeed.proto.ledger import entries_in
from plotfeed.proto.ledger_pb2 import LedgerBatch
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, flown, fly, held, radar, rotating, scene, waypoint

SENSORS = (
    radar(id="turning", scan=rotating(1.0, 8), pfa=1e-5),
    radar(id="staring", sic=2, pfa=1e-5),
    radar(id="south", sic=3, pfa=1e-5, azimuth_min_deg=90.0, azimuth_max_deg=270.0),
)


def drones(start_s: float = 0.0) -> list[dict[str, Any]]:
    moving = flown("moving", waypoint(300.0, 5.0, 9000.0), waypoint(80.0, 5.0, 9000.0))
    return [
        moving | {"start_s": start_s},
        held("north", 10.0, 5.0, 9000.0, start_s=start_s),
        held("south", 170.0, 5.0, 9000.0, start_s=start_s),
    ]


def unnumbered(message: Message) -> Iterator[Message]:
    """The ledger, by sector, numbers messages from the beginning of the session."""
    if not message.topic.endswith("/truth"):
        yield message
        return
    ends_ns = LedgerBatch.FromString(message.payload).sectors.end_utc_ns
    for entry, end_ns in zip(entries_in(message.payload), ends_ns, strict=True):
        for sent in entry.messages:
            sent.number = 0
        payload = entry.SerializeToString()
        yield Message(message.topic, payload, message.content_type, end_ns)


def told(road: Feed, sensor: str | None = None, since_ns: int = 0) -> list[Message]:
    """What left from then on, of one sensor or of all with the ledger; its status is not told."""
    return [
        m
        for each in road.messages
        for m in unnumbered(each)
        if m.due_utc_ns > since_ns
        and not m.topic.endswith(("/status", "/settings", "/description", "/session"))
        and (sensor is None or m.topic.startswith(f"plotfeed/{sensor}/"))
    ]


def run(seed: int = 81, *, sensors: Any = SENSORS, start_s: float = 0.0, **more: Any) -> Feed:
    start_ns = more.pop("start_ns", START_NS)
    which = more.pop("drones", None)
    flying = [d for d in drones(start_s) if which is None or d["id"] in which]
    return fly(scene(sensors, flying, seed=seed), more.pop("duration_s", 30.0), start_ns)


def test_a_run_that_begins_later_says_the_same_of_the_scans_that_both_cover() -> None:
    """The drones of the earlier one take off when the later one begins."""
    earlier = run(start_s=7.0, duration_s=37.0)
    later = run(start_ns=START_NS + 7 * NS)
    assert told(earlier, since_ns=START_NS + 7 * NS) == told(later)
    assert len(told(later)) > 500
