"""Parts of a scene: who needs whom, the same bytes, and whoever takes over goes on with them."""

from __future__ import annotations

import asyncio
import random

import numpy as np
import pytest
from support.fleets import by_topic, drones, judged, mixed, reference
from support.sessions import AtWork, StallingClock

from plotfeed.feeds.fleet.parts import load_of, partition, together
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer, Tap
from plotfeed.feeds.session.part import SessionPart
from plotfeed.feeds.session.session import run_over
from plotfeed.feeds.timing.clock import Clock, InstantClock
from plotfeed.models.beam import CULLED_FROM
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, fly, radar, rotating, scene

DURATION_S = 5.0
EVERY = tuple(sensor.id for sensor in mixed().sensor)


@pytest.fixture(scope="module")
def whole() -> list[Message]:
    """What one session sends of all."""
    return fly(mixed(), DURATION_S).messages


def part_flown(
    made: Scene, part: SessionPart, for_s: float, clock: Clock | None = None, *more: Observer
) -> list[Message]:
    """What a session of some sensors sends, which joins when its clock says so."""
    messages: list[Message] = []
    observers = [Tap(lambda message, _: messages.append(message)), *more]
    clock = clock or InstantClock(START_NS)
    asyncio.run(
        run_over(([], {}), made, clock=clock, duration_s=for_s, observers=observers, part=part)
    )
    return messages


def part_of(sensors: tuple[str, ...], number: int = 1, parts: int = 1) -> SessionPart:
    return SessionPart(number=number, parts=parts, sensors=sensors, began_utc_ns=START_NS)


@pytest.mark.parametrize("at_s", [2.0, 3.37])
def test_what_follows_is_what_one_session_would_have_sent(
    at_s: float, whole: list[Message]
) -> None:
    at_ns = START_NS + round(at_s * NS)
    found = part_flown(mixed(), part_of(EVERY), DURATION_S, InstantClock(at_ns))
    assert by_topic(found, at_ns) == by_topic(whole, at_ns)


def test_what_ends_and_what_joins_then_send_together_all_and_nothing_twice(
    whole: list[Message],
) -> None:
    at_ns, made, found = START_NS + 5 * NS // 2, mixed(), list[Message]()
    for sensors in partition(made, 2):
        found += part_flown(made, part_of(sensors), (at_ns - START_NS) / NS)
    for sensors in partition(made, 3):
        found += part_flown(made, part_of(sensors), DURATION_S, InstantClock(at_ns))
    assert by_topic(found) == by_topic(whole)


@pytest.mark.parametrize("stall_s", [0.4, 1.6])
def test_what_a_late_machine_leaves_out_is_told_and_changes_nothing_that_follows(
    stall_s: float,
) -> None:
    """Of what keeps a state, too: trackers, a steered beam, a camera that is cued."""
    clock = StallingClock(START_NS, 2.0, stall_s)
    at_work = AtWork(clock)
    part_flown(mixed(), part_of(EVERY), DURATION_S, clock, at_work)
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


def test_any_partition_sends_the_bytes_of_one_process() -> None:
    """A tracker, a steered beam, a cued camera, drifts, events and jitter among them.

    Of the drones, so many are out of reach of some sensors or of all that they are looked for.
    """
    made = mixed(
        cooperative={"period_s": 0.5}, drone=[*drones(), *drones(24, 2, 4.0, (10_000, 60_000))]
    )
    assert len(made.drone) >= CULLED_FROM
    whole = by_topic(fly(made, 4.0).messages)
    assert len(whole) > 15
    for n in (2, 7):
        parts = partition(made, n)
        assert len(parts) == n
        found: list[Message] = []
        for i, part in enumerate(parts, 1):
            found += part_flown(made, part_of(part, i, n), 4.0)
        assert by_topic(found) == whole, n


@pytest.mark.parametrize("seed", range(2))
def test_every_sensor_is_in_one_part_and_parts_cost_about_the_same(seed: int) -> None:
    by_chance = random.Random(seed)  # noqa: S311
    sensors = [
        radar(
            id=f"s{i}",
            scan=rotating(by_chance.choice([0.5, 1.0, 4.0]), by_chance.choice([8, 32])),
            position_enu_m=[by_chance.uniform(-9e3, 9e3), by_chance.uniform(-9e3, 9e3), 0.0],
        )
        for i in range(200)
    ]
    made = scene(sensors, seed=seed)
    parts = partition(made, 7)
    assert parts == partition(made, 7)
    assert sorted(sum(parts, ())) == sorted(sensor.id for sensor in made.sensor)
    load = {sensor.id: load_of(made, sensor) for sensor in made.sensor}
    sectors_per_s = {s.id: s.scan.sectors / s.scan.period_s for s in made.sensor}
    assert load == pytest.approx(sectors_per_s, rel=0.05)  # hardly a false alarm adds to it
    of_parts = [sum(load[name] for name in part) for part in parts]
    assert max(of_parts) < 1.2 * np.mean(of_parts)


def test_those_that_need_each_other_stay_together_and_leave_fewer_parts() -> None:
    """A camera and who cues it, and the sensors of a system."""
    made = mixed()
    number = dict(zip(EVERY, together(made).tolist(), strict=True))
    assert number["camera"] == number["cues"]
    assert len(set(number.values())) == len(number) - 1 == len(partition(made, 100))
    assert partition(made, 1) == [EVERY]
    system = scene([radar(id="alone")], seed=1, system=[{"id": "s", "preset": "xpeller"}])
    members = {sensor.id for sensor in system.sensor} - {"alone"}
    assert len(members) > 1
    assert sorted(map(len, partition(system, 9))) == [1, len(members)]


def test_neighbours_stay_together() -> None:
    """Two towns, far from each other, are two parts."""
    sensors = [
        radar(id=f"{town}{i}", position_enu_m=[x + 100.0 * i, 50.0 * i, 0.0])
        for i in range(5)
        for town, x in (("east", 40e3), ("west", -40e3))
    ]
    parts = partition(scene(sensors, seed=1), 2)
    assert [{name[:4] for name in part} for part in parts] == [{"west"}, {"east"}]
