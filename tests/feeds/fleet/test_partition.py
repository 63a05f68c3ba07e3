"""Parts of a scene: every sensor in one, those that need each other in the same, and same bytes."""

from __future__ import annotations

import asyncio
import random
from collections import Counter

import numpy as np
import pytest
from support.fleet_scenes import by_topic, drones, mixed, wanderers

from plotfeed.feeds.fleet.partition import load_of, partition, together
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene, example
from plotfeed.feeds.session.observer import Tap
from plotfeed.feeds.session.part import SessionPart
from plotfeed.feeds.session.session import run_over
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.beam import CULLED_FROM
from plotfeed.testing import START_NS, fly, radar, rotating, scene, staring

DURATION_S = 4.0


def flown_in_part(scene: Scene, part: SessionPart) -> list[Message]:
    """What the session of one part sends, in simulated time."""
    messages: list[Message] = []
    tap = Tap(lambda message, _: messages.append(message))
    clock = InstantClock(START_NS)
    asyncio.run(
        run_over(([], {}), scene, clock=clock, duration_s=DURATION_S, observers=[tap], part=part)
    )
    return messages


def test_any_partition_sends_the_bytes_of_one_process() -> None:
    """A tracker, a steered beam, a cued camera, drifts, events and jitter among them.

    Of the drones, so many are out of reach of some sensors or of all that they are looked for.
    """
    made = mixed(cooperative={"period_s": 0.5}, drone=[*drones(), *wanderers()])
    assert len(made.drone) >= CULLED_FROM
    whole = by_topic(fly(made, DURATION_S).messages)
    assert len(whole) > 15
    for n in (2, 7):
        parts = partition(made, n)
        assert len(parts) == n
        together: dict[str, list[bytes]] = {}
        for i, sensors in enumerate(parts):
            part = SessionPart(number=i + 1, parts=n, sensors=sensors, began_utc_ns=START_NS)
            found = by_topic(flown_in_part(made, part))
            assert not together.keys() & found.keys(), n
            together |= found
        assert together == whole, n


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
    assert Counter(name for part in parts for name in part) == Counter(
        sensor.id for sensor in made.sensor
    )
    load = {sensor.id: load_of(made, sensor) for sensor in made.sensor}
    of_parts = [sum(load[name] for name in part) for part in parts]
    assert max(of_parts) < 1.2 * np.mean(of_parts)


def test_those_that_need_each_other_stay_together_and_leave_fewer_parts() -> None:
    made = mixed()
    number = dict(zip([sensor.id for sensor in made.sensor], together(made).tolist(), strict=True))
    assert number["camera"] == number["cues"]
    assert len(set(number.values())) == len(number) - 1
    assert len(partition(made, 100)) == 8
    assert partition(made, 1) == [tuple(sensor.id for sensor in made.sensor)]


def test_the_sensors_of_a_system_stay_together() -> None:
    base = {"id": "s", "preset": "xpeller"}
    made = scene([radar(id="alone", scan=staring())], seed=1, system=[base])
    members = {sensor.id for sensor in made.sensor} - {"alone"}
    assert len(members) > 1
    assert sorted(map(len, partition(made, 9))) == [1, len(members)]


def test_neighbours_stay_together() -> None:
    """Two towns, far from each other, are two parts."""
    sensors = [
        radar(id=f"{town}{i}", position_enu_m=[x + 100.0 * i, 50.0 * i, 0.0])
        for i in range(5)
        for town, x in (("east", 40e3), ("west", -40e3))
    ]
    parts = partition(scene(sensors, seed=1), 2)
    assert [{name[:4] for name in part} for part in parts] == [{"west"}, {"east"}]


def test_shipped_scenes_can_be_shared_out() -> None:
    for name in ("section-4", "city"):
        made = example(name)
        parts = partition(made, 2)
        assert sorted(sum(parts, ())) == sorted(sensor.id for sensor in made.sensor)
