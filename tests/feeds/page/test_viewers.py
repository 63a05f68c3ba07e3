from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.engine.sensor_description import description_of
from plotfeed.feeds.page.scene_outline import connections
from plotfeed.feeds.page.updates import MAX_QUEUED, MAX_QUEUED_OCTETS, Update, Viewer
from plotfeed.feeds.scene.scene import example, load

SNAPSHOT = Update(b"all", b"+true", True)


def update(number: int, octets: int = 4) -> Update:
    return Update(number.to_bytes(octets, "big"), b"!", False)


async def taken(viewer: Viewer, count: int) -> list[bytes]:
    return [await viewer.next() for _ in range(count)]


async def has_next(viewer: Viewer) -> bool:
    try:
        await asyncio.wait_for(viewer.next(), 0.01)
    except TimeoutError:
        return False
    return True


@pytest.mark.asyncio
async def test_a_viewer_begins_with_a_snapshot_and_goes_on_with_updates() -> None:
    viewer = Viewer(lambda: SNAPSHOT)
    viewer.offer(update(1))  # the snapshot holds it already
    assert await viewer.next() == b"all"
    for number in (2, 3):
        viewer.offer(update(number))
    assert await taken(viewer, 2) == [update(2).public, update(3).public]
    assert not await has_next(viewer)


@pytest.mark.asyncio
async def test_a_slow_viewer_drops_what_waits_and_makes_up_by_a_snapshot() -> None:
    viewer = Viewer(lambda: SNAPSHOT)
    await viewer.next()
    for number in range(MAX_QUEUED + 6):
        viewer.offer(update(number))
    made_up = await viewer.next()
    assert made_up.startswith(b"all")
    assert f'{{"missed_updates": {MAX_QUEUED + 6}}}'.encode() in made_up
    assert not await has_next(viewer)
    viewer.offer(update(99))
    assert await viewer.next() == update(99).public


@pytest.mark.asyncio
async def test_what_waits_for_a_viewer_is_bounded_in_octets_too() -> None:
    viewer = Viewer(lambda: SNAPSHOT)
    await viewer.next()
    viewer.offer(update(1, MAX_QUEUED_OCTETS + 1))
    assert b'"missed_updates": 1' in await viewer.next()
    viewer.start_again()  # as when another scene begins: nothing was missed
    assert await viewer.next() == b"all"


@pytest.mark.parametrize("shown", [True, False])
@pytest.mark.asyncio
async def test_the_truth_comes_with_a_snapshot_and_goes_with_one(shown: bool) -> None:
    viewer = Viewer(lambda: SNAPSHOT)
    viewer.show_truth(shown=not shown)
    await viewer.next()
    viewer.offer(update(1))
    viewer.show_truth(shown=shown)
    assert await viewer.next() == (b"all+true" if shown else b"all")
    viewer.offer(update(2))
    assert await viewer.next() == update(2).public + (b"!" if shown else b"")
    viewer.show_truth(shown=shown)  # no news
    assert not await has_next(viewer)


if TYPE_CHECKING:
    pass

URLS = {"MQTT": "mqtt://127.0.0.1:1884 (port 1884 is taken)"}
UDP = """
[[udp]]
destination = "239.255.0.1:8600"
interface = "lo"

[[udp]]
destination = "127.0.0.1:8601"
sensors = ["other"]
"""


def test_topics_are_those_that_the_sensors_describe() -> None:
    scene = example("field-day")
    told = connections(scene, URLS)
    assert told["brokers"] == [
        {"protocol": "MQTT", "url": "mqtt://127.0.0.1:1884", "needs_password": False}
    ]
    for sensor in scene.sensor:
        outputs = [o.topic for o in description_of(scene, scene.sea_level(), sensor).outputs]
        assert [t["topic"] for t in told["sensors"][sensor.id]["topics"]] == outputs != []
    assert "truth" not in json.dumps(told)
    assert "control" not in json.dumps(told)


def test_a_sensor_is_told_where_its_own_datagrams_go(tmp_path: Path) -> None:
    text = scene_text(sensors=radar("one") + radar("other")) + UDP
    scene = load(scene_file(tmp_path, text))
    told = connections(scene, URLS)["sensors"]
    assert [to["destination"] for to in told["one"]["udp"]] == ["239.255.0.1:8600"]
    assert [to["destination"] for to in told["other"]["udp"]] == [
        "239.255.0.1:8600",
        "127.0.0.1:8601",
    ]
    told = connections(scene, URLS, sends_udp=False)["sensors"]
    assert told["other"]["udp"] == []
