"""Whoever takes sensors over goes on at the right scan, with the bytes that were due."""

from __future__ import annotations

import asyncio

import pytest
from support.fleet_oracle import judged, reference
from support.fleet_scenes import by_topic, mixed
from support.sessions import AtWork, StallingClock

from plotfeed.feeds.fleet.partition import partition
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.session.observer import Tap
from plotfeed.feeds.session.part import SessionPart
from plotfeed.feeds.session.session import run_over
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, fly

DURATION_S = 5.0
EVERY = tuple(sensor.id for sensor in mixed().sensor)


@pytest.fixture(scope="module")
def whole() -> list[Message]:
    """What one session sends of all."""
    return fly(mixed(), DURATION_S).messages


def part_flown(sensors: tuple[str, ...], joins_ns: int, ends_ns: int | None) -> list[Message]:
    """What a session sends that begins anew at one time, and ends at another."""
    messages: list[Message] = []

    tap = Tap(lambda message, _: messages.append(message))
    part = SessionPart(sensors=sensors, began_utc_ns=START_NS)
    clock = InstantClock(joins_ns)
    asyncio.run(
        run_over(
            ([], {}),
            mixed(),
            clock=clock,
            duration_s=DURATION_S if ends_ns is None else (ends_ns - START_NS) / NS,
            observers=[tap],
            part=part,
        )
    )
    return messages


@pytest.mark.parametrize("at_s", [2.0, 3.37])
def test_what_follows_is_what_one_session_would_have_sent(
    at_s: float, whole: list[Message]
) -> None:
    at_ns = START_NS + round(at_s * NS)
    assert by_topic(part_flown(EVERY, at_ns, None), at_ns) == by_topic(whole, at_ns)


def test_what_ends_and_what_joins_then_send_together_all_and_nothing_twice(
    whole: list[Message],
) -> None:
    at_ns = START_NS + 5 * NS // 2
    before = [by_topic(part_flown(sensors, START_NS, at_ns)) for sensors in partition(mixed(), 2)]
    after = [by_topic(part_flown(sensors, at_ns, None)) for sensors in partition(mixed(), 3)]
    found: dict[str, list[bytes]] = {}
    for part in [*before, *after]:
        for topic, payloads in part.items():
            found[topic] = found.get(topic, []) + payloads
    assert found == by_topic(whole)


@pytest.mark.parametrize("stall_s", [0.4, 1.6])
def test_what_a_late_machine_leaves_out_is_told_and_changes_nothing_that_follows(
    stall_s: float,
) -> None:
    """Of what keeps a state, too: trackers, a steered beam, a camera that is cued."""
    clock = StallingClock(START_NS, 2.0, stall_s)
    at_work = AtWork(clock)
    part = SessionPart(sensors=EVERY, began_utc_ns=START_NS)
    asyncio.run(
        run_over(
            ([], {}), mixed(), clock=clock, duration_s=DURATION_S, observers=[at_work], part=part
        )
    )
    told = at_work.session.take_not_sent()
    gaps = [
        {"sensors": [name], "from_utc_ns": first_ns - 1, "to_utc_ns": last_ns}
        for name, (first_ns, last_ns) in told.items()
    ]
    heard = by_topic([message for message, _ in at_work.said])
    verdict = judged(reference(mixed(), START_NS, DURATION_S), heard, gaps)
    assert (verdict.twice, verdict.foreign_topics, verdict.disordered) == (0, set(), 0)
    assert not verdict.missing
    assert all(last_ns - first_ns < stall_s * NS for first_ns, last_ns in told.values())
    if stall_s > 1.0:
        assert set(told) == set(EVERY)
        assert verdict.in_gaps > len(EVERY)
    assert at_work.session.take_not_sent() == {}
