"""Whoever asks for tracks as network Remote ID is answered by ASTM F3411, or told why not."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from typing import Any

import numpy as np
import pytest
from support.brokers import free_port
from support.deliveries import taken
from support.own_time import LoopClock, in_own_time
from support.sessions import at_work
from support.waiting import kept_up, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import RemoteIdService
from plotfeed.feeds.scene.scene import Scene, SceneError
from plotfeed.feeds.scene.telemetry_keys import TelemetrySource
from plotfeed.feeds.session.session import run
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.feeds.transport.listening import ASKING, RemoteIdTransport
from plotfeed.feeds.transport.live_source import LiveSource
from plotfeed.feeds.transport.mqtt.address import AccessError
from plotfeed.feeds.transport.ways_out import TransportError
from plotfeed.proto.utc import NS, iso_utc_ms
from plotfeed.testing import flown, radar, scene, waypoint

NOW = 1_767_225_600 * NS
VIEW = "view=40.44,-3.74,40.45,-3.73"
TOKEN: Any = {"token": "RID"}  # the name of one


async def ask(port: int, path: str, *fields: str, host: str = "localhost") -> tuple[int, Any]:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    lines = [f"GET {path} HTTP/1.1", f"Host: {host}:{port}", *fields, "", ""]
    writer.write("\r\n".join(lines).encode())
    head, _, body = (await reader.read()).partition(b"\r\n\r\n")
    writer.close()
    return int(head.split()[1]), json.loads(body)


def flights(name: str = "radar-1") -> bytes:
    stamp = {"value": iso_utc_ms(NOW), "format": "RFC3339"}
    position = {"lat": 40.445, "lng": -3.735, "alt": 700.0}
    state = {"timestamp": stamp, "position": position}
    return json.dumps(
        {"timestamp": stamp, "flights": [{"id": name, "current_state": state}]}
    ).encode()


@contextlib.asynccontextmanager
async def service(**keys: Any) -> AsyncIterator[RemoteIdTransport]:
    settings = RemoteIdService(port=free_port(), **keys)
    transport = RemoteIdTransport(settings, lambda: NOW)
    async with kept_up(transport.run()):
        await transport.wait_until_up()
        message = Message("radar/f3411", flights(), settings.content_type, NOW)
        assert taken(transport, message)
        yield transport


@in_own_time
async def test_what_is_asked_for_is_answered() -> None:
    asked = [
        (f"/uss/flights?{VIEW}", 200, '"id": "radar-1"'),
        (f"/uss/flights?{VIEW}&recent_positions_duration=60", 200, '"recent_positions"'),
        ("/uss/flights/radar-1/details", 200, '{"details": {"id": "radar-1"}}'),
        ("/uss/flights/radar-2/details", 404, "no such flight"),
        (f"/display_data?{VIEW}", 200, '"most_recent_position"'),
        ("/display_data/radar-1", 200, '{"uas": {"id": "radar-1"}}'),
        ("/uss/flights?view=40,-4,41,-3", 413, "at most 7000"),
        ("/uss/flights", 400, "view=lat1"),
        (f"/uss/flights?{VIEW}&recent_positions_duration=x", 400, "in seconds"),
        ("/else", 404, "/uss/flights"),
    ]
    async with service() as transport:
        for path, status, words in asked:
            found, told = await ask(transport.settings.port, path)
            assert found == status
            assert words in json.dumps(told)


@in_own_time
async def test_who_may_ask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLOTFEED_HTTP_TOKEN_RID", "secret")
    path = f"/uss/flights?{VIEW}"
    async with service(**TOKEN) as transport:
        port = transport.settings.port
        right = "Authorization: Bearer secret"
        assert (await ask(port, path))[0] == 401
        assert (await ask(port, path, "Authorization: Bearer wrong"))[0] == 401
        assert (await ask(port, path, right))[0] == 200
        assert (await ask(port, path, right, "Origin: http://evil.example"))[0] == 403
        assert (await ask(port, path, right, host="evil.example"))[0] == 403


@in_own_time
async def test_who_asks_is_answered_whatever_others_say_and_however_many_are_silent() -> None:
    async with service() as transport:
        port, carried = transport.settings.port, transport.settings.content_type
        silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(140)]
        for octets in (b"\x16\x03\x01\r\n\r\n", b"POST / HTTP/1.1\r\n\r\n"):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(octets)
            assert (await reader.read()).startswith(b"HTTP/1.1 40")
            writer.close()
        assert len(transport._places._held) <= 100
        damaged = Message("t", flights("radar-2").replace(b"{", b"["), carried, NOW)
        assert taken(transport, damaged)
        _, told = await ask(port, f"/uss/flights?{VIEW}")
        await asyncio.sleep(ASKING.patience_s)
        assert not transport._places._held
        for _, writer in silent:
            writer.close()
    assert [each["id"] for each in told["flights"]] == ["radar-1"]


def made(port: int) -> Scene:
    sensor = radar(report=["f3411"], scan={"kind": "staring", "period_s": 0.5})
    drones = [flown("d", waypoint(30, 8, 900), waypoint(30, 8, 2000))]
    return scene([sensor], drones, seed=501, remote_id_service=[{"port": port}])


@in_own_time
async def test_another_session_follows_the_tracks_of_one_by_asking() -> None:
    port, clock = free_port(), LoopClock()
    what = made(port)
    site = what.scene.site
    corners = (-0.02, -0.02, 0.02, 0.02)
    here = (site.latitude_deg, site.longitude_deg) * 2
    view = tuple(x + d for x, d in zip(here, corners, strict=True))
    heard: list[tuple[str, PositionReport]] = []
    source = LiveSource(
        TelemetrySource(url=f"remote-id:http://127.0.0.1:{port}", view=view, poll_s=0.2),
        now_utc_ns=clock.now_ns,
        take=lambda name, report: heard.append((name, report)),
        refuse=lambda _name, _refused: None,
    )
    await source.open()
    async with at_work(what, None, clock=clock), kept_up(source.run()):
        await until(lambda: heard)
    source.close()
    name, report = heard[0]
    assert name == "radar-1"
    assert report.latitude_deg == pytest.approx(site.latitude_deg, abs=0.02)
    assert np.isfinite(report.velocity_enu_m_s[:2]).all()


@in_own_time
async def test_a_port_that_is_taken_is_told_with_its_key() -> None:
    server = await asyncio.start_server(lambda _r, _w: None, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    with pytest.raises(TransportError, match=r"remote_id_service\[0\].port"):
        await run(made(port), clock=LoopClock(), broker="none", stop=asyncio.Event())
    server.close()


def test_what_a_service_needs_is_told_before_anything_is_sent() -> None:
    with pytest.raises(AccessError, match="the environment has no PLOTFEED_HTTP_TOKEN_RID"):
        RemoteIdTransport(RemoteIdService(port=1, **TOKEN), lambda: NOW)
    sensor = radar(report=["plots"], scan={"kind": "staring", "period_s": 0.5})
    with pytest.raises(SceneError, match=r"remote_id_service\[0\].*'f3411'.*report"):
        scene([sensor], [], seed=1, remote_id_service=[{"port": 1}])
