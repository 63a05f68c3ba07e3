"""Flights by network Remote ID (ASTM F3411): asked of services, and answered to who asks."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any

import numpy as np
import pytest
from support.brokers import deaf_server, free_port
from support.deliveries import taken
from support.own_time import LoopClock, in_own_time
from support.servers import BABBLE, HANG_UP, SAY_NOTHING, Answer, HttpReceiver, http_receiver
from support.sessions import at_work
from support.waiting import PATIENCE_S, kept_up, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import RemoteIdService
from plotfeed.feeds.scene.scene import Scene, SceneError
from plotfeed.feeds.scene.telemetry_keys import TelemetrySource
from plotfeed.feeds.session.session import run
from plotfeed.feeds.telemetry.position_report import PositionReport, Refused
from plotfeed.feeds.transport.http import HttpClient
from plotfeed.feeds.transport.listening import ASKING, RemoteIdTransport
from plotfeed.feeds.transport.live_source import SLOWEST_S, LiveSource
from plotfeed.feeds.transport.mqtt.address import AccessError
from plotfeed.feeds.transport.ways_out import TransportError
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.utc import NS
from plotfeed.testing import flown, radar, scene, waypoint

NOW = 1_767_225_600 * NS
AREA = (40.43, -3.76, 40.47, -3.70)
VIEW = "view=40.445,-3.735,40.455,-3.725"
FLIGHTS = f"/uss/flights?{VIEW}"
TOKEN: Any = {"token": "RID"}  # the name of one


async def ask(port: int, path: str, *fields: str) -> tuple[int, Any]:
    """Status and answer, of this host unless a field is of another."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    host = [] if any(field.startswith("Host") for field in fields) else [f"Host: localhost:{port}"]
    lines = [f"GET {path} HTTP/1.1", *host, *fields, "", ""]
    writer.write("\r\n".join(lines).encode())
    head, _, body = (await reader.read()).partition(b"\r\n\r\n")
    writer.close()
    return int(head.split()[1]), json.loads(body)


def flight(number: int, **position: object) -> dict[str, Any]:
    """As F3411-22a has it."""
    place = {"lat": 40.45, "lng": -3.73, "alt": 760.5, "accuracy_h": "HA3m", "accuracy_v": "VA10m"}
    return {
        "id": f"flight-{number}",
        "aircraft_type": "Helicopter",
        "current_state": {
            "timestamp": {"value": "2026-01-01T00:00:00.5Z", "format": "RFC3339"},
            "position": {**place, **position},
            "track": 90.0,
            "speed": 10.0,
            "vertical_speed": 63.0,
            "speed_accuracy": "SA1mps",
        },
    }


def told_of(*flights: dict[str, Any]) -> bytes:
    """What a service says of those."""
    return json.dumps({"flights": flights}).encode()


@contextlib.asynccontextmanager
async def service(**keys: Any) -> AsyncIterator[RemoteIdTransport]:
    settings = RemoteIdService(port=free_port(), **keys)
    transport = RemoteIdTransport(settings, lambda: NOW)
    async with kept_up(transport.run()):
        await transport.wait_until_up()
        message = Message("radar/f3411", told_of(flight(1)), settings.content_type, NOW)
        assert taken(transport, message)
        yield transport


OURS, WRONG = (f"Authorization: Bearer {word}" for word in ("secret", "wrong"))
ASKED = [
    ((FLIGHTS, OURS), 200, '"id": "flight-1"'),
    ((f"{FLIGHTS}&recent_positions_duration=60", OURS), 200, '"recent_positions"'),
    (("/uss/flights/flight-1/details", OURS), 200, '{"details": {"id": "flight-1"}}'),
    (("/uss/flights/flight-2/details", OURS), 404, "no such flight"),
    ((f"/display_data?{VIEW}", OURS), 200, '"most_recent_position"'),
    (("/display_data/flight-1", OURS), 200, '{"uas": {"id": "flight-1"}}'),
    (("/uss/flights?view=40,-4,41,-3", OURS), 413, "at most 7000"),
    (("/uss/flights", OURS), 400, "view=lat1"),
    ((f"{FLIGHTS}&recent_positions_duration=x", OURS), 400, "in seconds"),
    (("/else", OURS), 404, "/uss/flights"),
    ((FLIGHTS,), 401, "bearer token"),
    ((FLIGHTS, WRONG), 401, "bearer token"),
    ((FLIGHTS, OURS, "Origin: http://evil.example"), 403, "web pages"),
    ((FLIGHTS, OURS, "Host: evil.example"), 403, "by its own name"),
]


@in_own_time
async def test_who_may_ask_is_answered_what_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLOTFEED_HTTP_TOKEN_RID", "secret")
    async with service(**TOKEN) as transport:
        for asked, status, words in ASKED:
            found, told = await ask(transport.settings.port, *asked)
            assert (found, words in json.dumps(told)) == (status, True), asked


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
        damaged = Message("t", told_of(flight(2)).replace(b"{", b"["), carried, NOW)
        assert taken(transport, damaged)
        _, told = await ask(port, FLIGHTS)
        await asyncio.sleep(ASKING.patience_s)
        assert not transport._places._held
        for _, writer in silent:
            writer.close()
    assert [each["id"] for each in told["flights"]] == ["flight-1"]


Heard = list[tuple[str, PositionReport | Refused]]


@contextlib.asynccontextmanager
async def asking(
    place: str, view: Sequence[float], now_utc_ns: Callable[[], int] = lambda: NOW
) -> AsyncIterator[Heard]:
    """What a service there is heard to say meanwhile."""
    heard: Heard = []
    url = f"remote-id:http://{place}"
    settings = TelemetrySource.model_validate({"url": url, "view": view, "poll_s": 0.2})
    both = {"take": lambda *r: heard.append(r), "refuse": lambda *r: heard.append(r)}
    source = LiveSource(settings, now_utc_ns=now_utc_ns, **both)
    await source.open()
    async with kept_up(source.run()):
        yield heard
    source.close()


def made(port: int) -> Scene:
    sensor = radar(report=["f3411"], scan={"kind": "staring", "period_s": 0.5})
    drones = [flown("d", waypoint(30, 8, 900), waypoint(30, 8, 2000))]
    return scene([sensor], drones, seed=501, remote_id_service=[{"port": port}])


@in_own_time
async def test_another_session_follows_the_tracks_of_one_by_asking() -> None:
    port, clock = free_port(), LoopClock()
    what = made(port)
    site = what.scene.site
    here = (site.latitude_deg, site.longitude_deg) * 2
    view = [x + d for x, d in zip(here, (-0.02, -0.02, 0.02, 0.02), strict=True)]
    async with (
        asking(f"127.0.0.1:{port}", view, clock.now_ns) as heard,
        at_work(what, None, clock=clock),
    ):
        await until(lambda: heard)
    name, report = heard[0]
    assert name == "radar-1"
    assert isinstance(report, PositionReport)
    assert report.latitude_deg == pytest.approx(site.latitude_deg, abs=0.02)
    assert np.isfinite(report.velocity_enu_m_s[:2]).all()


@in_own_time
async def test_a_port_that_is_taken_is_told_with_its_key() -> None:
    with deaf_server() as port, pytest.raises(TransportError, match=r"remote_id_service\[0\].port"):
        await run(made(port), clock=LoopClock(), broker="none", stop=asyncio.Event())


def test_what_a_service_needs_is_told_before_anything_is_sent() -> None:
    with pytest.raises(AccessError, match="the environment has no PLOTFEED_HTTP_TOKEN_RID"):
        RemoteIdTransport(RemoteIdService(port=1, **TOKEN), lambda: NOW)
    sensor = radar(report=["plots"], scan={"kind": "staring", "period_s": 0.5})
    with pytest.raises(SceneError, match=r"remote_id_service\[0\].*'f3411'.*report"):
        scene([sensor], [], seed=1, remote_id_service=[{"port": 1}])


# Services that are asked.

CHUNKS = b'5;x=y\r\n{"fli\r\nA\r\nghts": []}\r\n0\r\na: b\r\n\r\n'


@pytest.mark.parametrize(
    "answer",
    [
        b"Transfer-Encoding: chunked\r\nConnection: close\r\n\r\n" + CHUNKS,
        b'Connection: close\r\n\r\n{"flights": []}',
        b'Content-Length: 15\r\n\r\n{"flights": []}',
    ],
)
@in_own_time
async def test_an_answer_is_read_however_its_length_is_told(answer: bytes) -> None:
    whole = b"HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 200 OK\r\n" + answer
    async with http_receiver([whole, whole]) as server:
        client = HttpClient(f"http://127.0.0.1:{server.port}/", None)
        for most, body in ((100, b'{"flights": []}'), (10, None)):
            assert await client.ask("GET", (), b"", timeout_s=PATIENCE_S, most=most) == (200, body)
            client.hang_up()


def answer_of(*flights: dict[str, Any], status: int = 200, more: str = "") -> bytes:
    """An answer to who asks for them."""
    body = told_of(*flights)
    head = f"HTTP/1.1 {status} said\r\n{more}Content-Length: {len(body)}\r\n\r\n"
    return head.encode() + body


async def listen(
    answers: list[Answer], enough: Callable[[Heard, HttpReceiver], object]
) -> tuple[Heard, HttpReceiver]:
    """What a service that answers so is heard to say, until that is enough."""
    async with (
        http_receiver(answers) as provider,
        asking(f"127.0.0.1:{provider.port}/rid", AREA) as heard,
    ):
        await until(lambda: enough(heard, provider))
    return heard, provider


@in_own_time
async def test_flights_are_taken_once_with_their_accuracies(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("PLOTFEED_REMOTE_ID_TOKEN", "abc")
    answer = answer_of(flight(1), flight(2, lat="north"), flight(3, alt=-1000))
    heard, provider = await listen([answer] * 9, lambda _, provider: len(provider.posts) >= 4)
    path, fields, _ = provider.posts[0]
    assert path == "/rid/uss/flights?view=40.430000,-3.760000,40.470000,-3.700000"
    assert fields["authorization"] == "Bearer abc"
    (found,) = [said for _, said in heard if isinstance(said, PositionReport)]  # of four answers
    assert (found.t_utc_ns, found.altitude_m) == (NOW + 500_000_000, 760.5)
    assert found.altitude_reference is AltitudeReference.ELLIPSOID
    assert found.horizontal_accuracy_m == pytest.approx(3 / 2.4477, rel=1e-4)
    assert found.vertical_accuracy_m == pytest.approx(10 / 1.95996, rel=1e-4)
    assert found.velocity_enu_m_s == pytest.approx((10, 0, float("nan")), nan_ok=True, abs=1e-9)
    refused = {drone: said.detail for drone, said in heard if isinstance(said, Refused)}
    assert refused == {
        "flight-2": "lat is 'north'; expected a number",
        "flight-3": "position.alt is missing or unknown",
    }


@in_own_time
async def test_a_token_goes_to_nobody_else(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("PLOTFEED_REMOTE_ID_TOKEN", "abc")
    async with http_receiver() as other:
        there = f"http://127.0.0.1:{other.port}"
        monkeypatch.setenv("http_proxy", there)
        answer = answer_of(status=302, more=f"Location: {there}/\r\n")
        await listen([answer] * 9, lambda _, provider: len(provider.posts) == 2)
    assert other.connections == 0
    assert "status 302" in caplog.text
    assert "abc" not in caplog.text


@in_own_time
async def test_a_service_that_fails_is_asked_again_and_more_slowly(
    caplog: pytest.LogCaptureFixture,
) -> None:
    began_s = asyncio.get_running_loop().time()
    failures: list[Answer] = [*[answer_of(status=401)] * 6, BABBLE, HANG_UP]
    await listen([*failures, answer_of(flight(1))], lambda heard, _: heard)
    waited_s = asyncio.get_running_loop().time() - began_s
    assert waited_s == pytest.approx(0.2 * sum(2**n for n in range(1, 8)) + SLOWEST_S, abs=2.0)
    assert "status 401, it wants a token: PLOTFEED_REMOTE_ID_TOKEN" in caplog.text
    assert "it answers again" in caplog.text
    assert len(caplog.records) == 2


@in_own_time
async def test_a_service_that_is_silent_holds_up_no_end() -> None:
    """No thread waits for it: who is cancelled has ended when its connection has."""
    before, tasks = threading.active_count(), asyncio.all_tasks()

    def is_asked(_: Heard, provider: HttpReceiver) -> bool:
        assert threading.active_count() == before
        return bool(provider.posts)

    await listen([SAY_NOTHING], is_asked)
    await until(lambda: asyncio.all_tasks() == tasks)  # who was asked sees the end
