"""Tracks of a session at all their destinations: UTM by HTTP, TAK, a map, and events by UDP."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port
from support.servers import http_receiver
from support.sessions import at_work
from support.udp_receiver import heard, place, receiver
from support.waiting import until
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from plotfeed.feeds.scene.scene import Scene, SceneError
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.testing import START_NS, flown, radar, scene, staring, waypoint

REPORT = ["air-traffic", "cot", "geojson"]


def made(**destinations: Any) -> Scene:
    drones = [flown("d", waypoint(30, 8, 900), waypoint(30, 8, 2000))]
    return scene([radar(report=REPORT, scan=staring(0.5))], drones, seed=501, **destinations)


def clock() -> WallClock:
    return WallClock(START_NS, speed=4.0)


@pytest.mark.asyncio
async def test_each_destination_gets_its_format_and_what_failed_is_in_the_ledger() -> None:
    port = free_port()
    with receiver() as ears:
        async with http_receiver([401]) as utm:
            what = made(
                http=[{"url": f"http://127.0.0.1:{utm.port}/set_air_traffic/{{session}}"}],
                udp=[{"destination": place(ears), "carries": "cot"}],
                websocket=[{"port": port}],
            )
            async with at_work(what, None, clock=clock()) as ran:
                async with connect(f"ws://127.0.0.1:{port}") as client:
                    told = [str(await client.recv()) for _ in range(3)]
                await until(lambda: len(utm.posts) > 5)
        events = heard(ears)
    assert utm.bodies == ran.on("radar/air-traffic")
    assert events == ran.on("radar/cot")
    assert ET.fromstring(events[0]).attrib["uid"] == "radar-1"  # noqa: S314 - our own
    assert set(told) <= {payload.decode() for payload in ran.on("radar/geojson")}
    assert json.loads(told[0])["features"][0]["id"] == "radar-1"
    (name,) = ran.totals.undelivered_to
    assert name.startswith("http[0] http://127.0.0.1")
    assert ran.totals.undelivered_to[name] == 1
    assert [list(each.not_to) for each in ran.sent if each.not_to] == [[name]]


@pytest.mark.asyncio
async def test_a_websocket_lets_in_pages_that_are_named_and_those_who_ask_for_this_host() -> None:
    port, good, bad = free_port(), "http://localhost:5173", "http://evil.example"
    what = made(websocket=[{"port": port, "origins": [good], "max_clients": 5}])
    url, refused = f"ws://127.0.0.1:{port}", []
    async with at_work(what, None, clock=clock()):
        async with connect(url, origin=good):  # type: ignore[arg-type]
            pass
        for how in ({"origin": bad}, {"additional_headers": {"Host": "evil.example"}}):
            with pytest.raises(InvalidStatus) as error:
                async with connect(url, **how):  # type: ignore[arg-type]
                    pass
            refused.append(error.value.response.status_code)
    assert refused == [403, 403]


@pytest.mark.parametrize(
    ("destinations", "words"),
    [
        ({"http": [{"url": "http://h/", "carries": "f3411"}]}, r"http\[0\].*'f3411'.*report"),
        ({"tak": [{"server": "tcp://h", "sensors": ["x"]}]}, r"tak\[0\].sensors"),
        ({"http": [{"url": "http://u:p@h/"}]}, "without a user"),
        ({"http": [{"url": "ftp://h/"}]}, "http://HOST"),
        ({"http": [{"url": "http://h/", "token": "a b"}]}, "token"),
        ({"websocket": [{"port": 1, "host": "example.org"}]}, "host"),
    ],
)
def test_destinations_that_cannot_be_are_refused(destinations: Any, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        made(**destinations)


def test_a_scene_that_is_only_data_sends_nowhere(tmp_path: Path) -> None:
    what = made(tak=[{"server": "tcp://h"}], http=[{"url": "http://h/"}], websocket=[{"port": 1}])
    to = what.enclosed({}).outgoing
    assert (to.tak, to.http, to.websocket, to.udp) == ((), (), (), ())
