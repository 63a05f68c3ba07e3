"""Late and lossy as asked: what a whole session delivers over impaired links, by its own ledger."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from support.significance import assert_sum

from plotfeed.feeds.messages.message import Message
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, fly, held, radar, rotating, scene, staring

MS = 1_000_000


def sent(road: Feed, sensor: str = "radar") -> list[pb.Sent]:
    return [one for entry in road.ledgers if entry.sensor == sensor for one in entry.messages]


def flight(
    link: dict[str, Any] | None, duration_s: float = 60.0, seed: int = 7, **more: Any
) -> Feed:
    sensor = radar(scan=rotating(1.0, 32), pfa=1e-8, **more)
    if link is not None:
        sensor["link"] = link
    return fly(scene([sensor], [held("d", 10.0, 5.0, 3000.0)], seed=seed), duration_s)


@cache
def clear() -> Feed:
    return flight(None)


def told(road: Feed) -> list[tuple[str, bytes]]:
    return [(m.topic, m.payload) for m in road.messages if "/radar/" in m.topic and _is_plots(m)]


def _is_plots(message: Message) -> bool:
    return "asterix" in message.topic or message.topic.endswith("/plots")


def test_latency_delays_all_and_changes_nothing_else() -> None:
    """Times of sending are not part of a message: delays change none of its octets."""
    late = flight({"latency_ms": 120.0})
    first, second = (
        [(m.topic, m.payload, m.due_utc_ns, m.properties) for m in road.messages if _is_plots(m)]
        for road in (late, clear())
    )
    assert first == second
    assert all(m.again() == m for m in clear().messages)
    assert {s.sent_utc_ns - s.due_utc_ns for s in sent(late)} == {120 * MS}
    assert {s.sent_utc_ns - s.due_utc_ns for s in sent(clear())} == {0}


def test_the_ledger_tells_of_every_message_once_and_what_is_lost_is_not_published() -> None:
    loss = {"kind": "random", "probability": 0.1}
    road = flight({"latency_ms": 50.0, "jitter_ms": 20.0, "duplicate": 0.1, "loss": loss})
    entries, n = sent(road), len(told(clear()))
    assert sorted(s.number for s in entries if not s.copy) == list(range(n))
    lost = sum(s.fate == pb.LOST for s in entries if not s.copy)
    assert_sum(lost, 0.1 * n, 0.09 * n, "lost")
    left = sum(s.fate == pb.SENT for s in entries)
    assert left == len(told(road))
    assert 0 < sum(s.copy for s in entries) < left / 5


def test_an_impaired_link_costs_other_sensors_nothing() -> None:
    other = radar(id="other", scan=rotating(1.0, 32), pfa=1e-6, sic=2)
    drones = [held("d", 10.0, 5.0, 3000.0)]
    alone = fly(scene([other], drones, seed=7), 20.0)
    lossy = radar(scan=staring(), link={"latency_ms": 70.0, "jitter_ms": 30.0})
    beside = fly(scene([lossy, other], drones, seed=7), 20.0)
    of_other = [
        [m for m in road.messages if "/other/asterix" in m.topic or "/other/plots" in m.topic]
        for road in (alone, beside)
    ]
    assert of_other[0] == of_other[1]


def test_a_scripted_outage_lasts_from_its_first_to_its_last_instant() -> None:
    road = flight(None, 20.0, event=[{"from_s": 5.0, "to_s": 8.0, "set": {"link": {"down": True}}}])
    for s in sent(road):
        out = 5 * NS <= s.due_utc_ns - START_NS < 8 * NS
        assert s.fate == (pb.OUTAGE if out else pb.SENT)


def test_a_scripted_degradation_multiplies_the_false_alarms() -> None:
    event = {"from_s": 30.0, "to_s": 60.0, "set": {"pfa_factor": 10}}
    sensor = radar(scan=staring(), pfa=1e-6, event=[event])
    road = fly(scene([sensor], [], seed=3), 60.0)
    alarms = (road.plots("radar").time_utc_ns - START_NS) / NS
    cells = scene([sensor], [], seed=3).sensor[0].model(None).resolution_cells  # type: ignore[arg-type]
    mean = 30 * cells * 1e-6
    before, after = int((alarms <= 30).sum()), int((alarms > 30).sum())
    assert_sum(before, mean, mean, "before")
    assert_sum(after, 10 * mean, 10 * mean, "after")


def test_a_sensor_that_is_switched_off_says_nothing_but_its_status() -> None:
    road = flight(None, 10.0, event=[{"from_s": 4.0, "to_s": 7.0, "set": {"enabled": False}}])
    due_s = {(s.due_utc_ns - START_NS) / NS for s in sent(road)}
    assert not [t for t in due_s if 4.02 < t <= 7.0]
    assert any(7.0 < t < 7.2 for t in due_s)
    states = [m.payload for m in road.messages if m.topic.endswith("radar/status")]
    assert False in {json.loads(state)["enabled"] for state in states}


def test_a_session_that_ends_by_itself_delivers_what_its_links_hold() -> None:
    road = flight({"latency_ms": 3000.0}, 5.0)
    assert {s.fate for s in sent(road)} == {pb.SENT}
    assert max(s.sent_utc_ns for s in sent(road)) > START_NS + 7 * NS


def test_duplicates_and_corrupted_octets_are_those_that_the_ledger_names() -> None:
    road = flight({"corrupt": 0.2}, 20.0)
    flipped = {s.number: s.flipped_bit for s in sent(road) if s.HasField("flipped_bit")}
    plain, other = told(flight(None, 20.0)), told(road)
    assert len(plain) == len(other)
    for number, (one, then) in enumerate(zip(plain, other, strict=True)):
        octets = bytearray(one[1])
        if number in flipped:
            octets[flipped[number] // 8] ^= 0x80 >> flipped[number] % 8
        assert (one[0], bytes(octets)) == then
    assert len(flipped) > 100


@pytest.mark.parametrize("late", ["drop", "restamp", "send"])
def test_sapient_that_a_link_makes_too_late_is_treated_as_the_scene_says(late: str) -> None:
    sensor = radar(scan=staring(), report=["sapient"], pfa=1e-6, link={"latency_ms": 2000.0})
    road = fly(scene([sensor], [], seed=5, sapient={"late": late}), 10.0)
    fates = {s.fate for s in sent(road)}
    assert fates == {pb.STALE if late == "drop" else pb.SENT}
    for message, due_ns in [
        (SapientMessage.FromString(m.payload), m.due_utc_ns)
        for m in road.messages
        if m.topic.endswith("sapient") and ("type", "plotfeed.sapient") in m.properties
    ]:
        stamp_ns = message.timestamp.ToNanoseconds()
        assert abs(stamp_ns - due_ns - (2 * NS if late == "restamp" else 0)) < 200 * MS


def test_a_rotating_beam_with_jitter_still_meets_every_drone_once_a_turn() -> None:
    sensor = radar(scan=rotating(1.0, 32) | {"jitter_ms": 10.0}, pfa=1e-8)
    road = fly(scene([sensor], [held("d", 200.0, 5.0, 2000.0)], seed=11), 60.0)
    looks = [look for entry in road.ledgers for look in entry.looks]
    assert len(looks) in (59, 60)
    gaps_s = np.diff([look.time_utc_ns for look in looks]) / NS
    assert 0.9 < gaps_s.min() < gaps_s.max() < 1.1
    assert gaps_s.std() > 0.001
