"""Posting tracks to servers, and asking services of Remote ID: slow, broken, strict or away."""

from __future__ import annotations

import asyncio
import json
import logging
import threading
from collections.abc import Callable
from typing import Any
from uuid import UUID

import pytest
from support.brokers import free_port
from support.deliveries import FollowedDelivery
from support.own_time import in_own_time
from support.servers import BABBLE, HANG_UP, SAY_NOTHING, Answer, HttpReceiver, http_receiver
from support.waiting import PATIENCE_S, kept_up, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import HttpDestination
from plotfeed.feeds.scene.telemetry_keys import TelemetrySource
from plotfeed.feeds.telemetry.position_report import PositionReport, Refused
from plotfeed.feeds.transport.http import HttpClient, HttpTransport
from plotfeed.feeds.transport.live_source import SLOWEST_S, LiveSource
from plotfeed.feeds.transport.mqtt.address import AccessError
from plotfeed.models.state import AltitudeReference

BY_TOKEN = {"token": "UTM"}


@pytest.fixture(autouse=True)
def _warned(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    caplog.set_level(logging.WARNING)
    monkeypatch.setenv("PLOTFEED_HTTP_TOKEN_UTM", "s3cret")


def posting(port: int, **keys: Any) -> HttpTransport:
    tree = {"url": f"http://127.0.0.1:{port}/set/{{session}}?a=1", "timeout_s": 20.0, **keys}
    return HttpTransport(HttpDestination.model_validate(tree), "http[0]")


def message(text: str, kind: str = "air-traffic") -> Message:
    content_type = HttpDestination(url="http://h/", carries=kind).content_type  # type: ignore[arg-type]
    return Message("t", text.encode(), content_type, 0)


def publish(transport: HttpTransport, *texts: str) -> list[FollowedDelivery]:
    made = [FollowedDelivery(message(text)) for text in texts]
    transport.publish(made)
    return made


async def outcome(
    answers: list[Answer], *texts: str, **keys: Any
) -> tuple[HttpReceiver, list[bool | None]]:
    """What came of posts to a server that answers so."""
    async with http_receiver(answers) as server:
        transport = posting(server.port, **keys)
        async with kept_up(transport.run()):
            made = publish(transport, *texts)
            await until(lambda: all(each.was_delivered is not None for each in made))
    return server, [each.was_delivered for each in made]


@in_own_time
async def test_messages_are_posted_in_order_on_one_connection_with_the_token() -> None:
    server, delivered = await outcome([], "one", "two", "three", **BY_TOKEN)
    assert delivered == [True] * 3
    assert server.bodies == [b"one", b"two", b"three"]
    assert server.connections == 1
    path, fields, _ = server.posts[0]
    assert {each[0] for each in server.posts} == {path}
    assert path.startswith("/set/")
    assert path.endswith("?a=1")
    assert UUID(path[len("/set/") : -len("?a=1")]).version == 4
    assert fields["authorization"] == "Bearer s3cret"
    assert fields["content-type"] == "application/json"


@pytest.mark.parametrize("trouble", [500, 429, HANG_UP, SAY_NOTHING, BABBLE], ids=str)
@in_own_time
async def test_what_a_server_in_trouble_did_not_take_is_posted_again(
    trouble: Answer, caplog: pytest.LogCaptureFixture
) -> None:
    server, delivered = await outcome([trouble, trouble], "one", "two")
    assert delivered == [True, True]
    assert server.bodies == [b"one", b"one", b"one", b"two"]
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == 2, "a line when it begins to fail, and one when it works again"
    assert "http[0] http://127.0.0.1" in told[0]
    assert "again" in told[1]


@pytest.mark.parametrize("refusal", [400, 401, 404, 422, 307])
@in_own_time
async def test_what_a_server_refuses_is_not_posted_again_and_told_of_once(
    refusal: int, caplog: pytest.LogCaptureFixture
) -> None:
    server, delivered = await outcome([refusal] * 3, "one", "two", "three", **BY_TOKEN)
    assert delivered == [False] * 3
    assert server.bodies == [b"one", b"two", b"three"]
    (line,) = [record.getMessage() for record in caplog.records]
    assert str(refusal) in line
    assert "s3cret" not in line


@in_own_time
async def test_a_message_is_given_up_after_its_retries_and_the_next_has_its_turn() -> None:
    server, delivered = await outcome([500] * 3, "one", "two", retries=2)
    assert delivered == [False, True]
    assert server.bodies == [b"one"] * 3 + [b"two"]


@in_own_time
async def test_a_server_that_comes_late_gets_the_newest_that_found_room() -> None:
    port = free_port()
    transport = posting(port, queue_messages=2, retries=100)
    other = FollowedDelivery(message("x", "f3411"))  # which is left to others
    transport.publish([other])
    async with kept_up(transport.run()):
        made = publish(transport, "one", "two", "three", "four")
        assert [each.was_delivered for each in made] == [False, False, None, None]
        async with http_receiver(port=port) as server:
            await until(lambda: all(each.was_delivered is not None for each in made))
        (late,) = publish(transport, "five")
    assert server.bodies[-2:] == [b"three", b"four"]
    assert (late.was_delivered, late.not_to) == (False, (transport.name,))
    assert (other.said, other.not_to) == ([True], ())


@pytest.mark.parametrize(
    ("token", "words"), [("", "no PLOTFEED_HTTP_TOKEN_UTM"), ("a\r\nB: c", "ASCII")]
)
def test_a_token_that_is_none_is_told_and_not_shown(
    token: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PLOTFEED_HTTP_TOKEN_UTM", token)
    with pytest.raises(AccessError, match=words) as refused:
        posting(1, **BY_TOKEN)
    assert "B: c" not in str(refused.value)


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


NOW = 1_767_225_600_000_000_000
VIEW = [40.43, -3.76, 40.47, -3.70]


def flights(*flights: dict[str, Any], status: int = 200, more: str = "") -> bytes:
    """An answer to who asks for them."""
    body = json.dumps({"flights": flights}).encode()
    head = f"HTTP/1.1 {status} said\r\n{more}Content-Length: {len(body)}\r\n\r\n"
    return head.encode() + body


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


Heard = list[tuple[str, PositionReport | Refused]]


async def listen(
    answers: list[Answer], enough: Callable[[Heard, HttpReceiver], object]
) -> tuple[Heard, HttpReceiver]:
    """What a service that answers so is heard to say, until that is enough."""
    heard: Heard = []
    async with http_receiver(answers) as provider:
        url = f"remote-id:http://127.0.0.1:{provider.port}/rid"
        settings = TelemetrySource.model_validate({"url": url, "view": VIEW, "poll_s": 0.2})
        both = {"take": lambda *r: heard.append(r), "refuse": lambda *r: heard.append(r)}
        source = LiveSource(settings, now_utc_ns=lambda: NOW, **both)
        await source.open()
        async with kept_up(source.run()):
            await until(lambda: enough(heard, provider))
        source.close()
    return heard, provider


@in_own_time
async def test_flights_are_taken_once_with_their_accuracies(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("PLOTFEED_REMOTE_ID_TOKEN", "abc")
    answer = flights(flight(1), flight(2, lat="north"), flight(3, alt=-1000))
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
        answer = flights(status=302, more=f"Location: {there}/\r\n")
        await listen([answer] * 9, lambda _, provider: len(provider.posts) == 2)
    assert other.connections == 0
    assert "status 302" in caplog.text
    assert "abc" not in caplog.text


@in_own_time
async def test_a_service_that_fails_is_asked_again_and_more_slowly(
    caplog: pytest.LogCaptureFixture,
) -> None:
    began_s = asyncio.get_running_loop().time()
    failures: list[Answer] = [*[flights(status=401)] * 6, BABBLE, HANG_UP]
    await listen([*failures, flights(flight(1))], lambda heard, _: heard)
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
