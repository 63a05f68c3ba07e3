"""Posting tracks to servers that are slow, broken, strict or away."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any
from uuid import UUID

import pytest
from support.brokers import free_port
from support.deliveries import FollowedDelivery
from support.http_receiver import BABBLE, HANG_UP, SAY_NOTHING, Answer, HttpReceiver, http_receiver
from support.waiting import kept_up, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import HttpDestination
from plotfeed.feeds.transport import ways_out
from plotfeed.feeds.transport.http import HttpTransport
from plotfeed.feeds.transport.mqtt.address import AccessError

BY_TOKEN = {"token": "UTM"}
TOKEN = {"PLOTFEED_HTTP_TOKEN_UTM": "s3cret"}


@pytest.fixture(autouse=True)
def _in_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ways_out, "BACKOFF_S", (0.01,))


def posting(port: int, environment: Mapping[str, str] = TOKEN, **keys: Any) -> HttpTransport:
    tree = {"url": f"http://127.0.0.1:{port}/set/{{session}}?a=1", "timeout_s": 60.0, **keys}
    return HttpTransport(HttpDestination.model_validate(tree), "http[0]", environment)


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


@pytest.mark.asyncio
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


@pytest.mark.parametrize("trouble", [500, 503, 429, HANG_UP, SAY_NOTHING, BABBLE], ids=str)
@pytest.mark.asyncio
async def test_what_a_server_in_trouble_did_not_take_is_posted_again(
    trouble: Answer, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    timeout_s = 1.0 if trouble == SAY_NOTHING else 60.0
    server, delivered = await outcome([trouble, trouble], "one", "two", timeout_s=timeout_s)
    assert delivered == [True, True]
    assert server.bodies == [b"one", b"one", b"one", b"two"]
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == 2, "a line when it begins to fail, and one when it works again"
    assert "http[0] http://127.0.0.1" in told[0]
    assert "again" in told[1]


@pytest.mark.asyncio
async def test_a_message_is_given_up_after_its_retries_and_the_next_has_its_turn() -> None:
    server, delivered = await outcome([500] * 3, "one", "two", retries=2)
    assert delivered == [False, True]
    assert server.bodies == [b"one"] * 3 + [b"two"]


@pytest.mark.parametrize("refusal", [400, 401, 403, 404, 422, 307])
@pytest.mark.asyncio
async def test_what_a_server_refuses_is_not_posted_again_and_told_of_once(
    refusal: int, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    server, delivered = await outcome([refusal] * 3, "one", "two", "three", **BY_TOKEN)
    assert delivered == [False] * 3
    assert server.bodies == [b"one", b"two", b"three"]
    (line,) = [record.getMessage() for record in caplog.records]
    assert str(refusal) in line
    assert "s3cret" not in line


@pytest.mark.asyncio
async def test_a_server_that_comes_late_gets_the_newest_that_found_room() -> None:
    port = free_port()
    transport = posting(port, queue_messages=2, retries=100)
    async with kept_up(transport.run()):
        made = publish(transport, "one", "two", "three", "four")
        assert [each.was_delivered for each in made] == [False, False, None, None]
        async with http_receiver(port=port) as server:
            await until(lambda: all(each.was_delivered is not None for each in made))
    assert server.bodies[-2:] == [b"three", b"four"]


@pytest.mark.asyncio
async def test_what_waits_at_the_end_was_not_delivered() -> None:
    transport = posting(free_port(), retries=100)
    async with kept_up(transport.run()):
        (made,) = publish(transport, "one")
    assert made.was_delivered is False
    assert made.not_to == (transport.name,)


@pytest.mark.asyncio
async def test_other_formats_are_left_to_others() -> None:
    transport = posting(free_port())
    other = FollowedDelivery(message("x", "f3411"))
    transport.publish([other])
    assert other.said == [True]
    assert other.not_to == ()


@pytest.mark.parametrize(
    ("environment", "words"),
    [({}, "no PLOTFEED_HTTP_TOKEN_UTM"), ({"PLOTFEED_HTTP_TOKEN_UTM": "a\r\nB: c"}, "ASCII")],
)
def test_a_token_that_is_none_is_told_and_not_shown(
    environment: dict[str, str], words: str
) -> None:
    with pytest.raises(AccessError, match=words) as refused:
        posting(1, environment, **BY_TOKEN)
    assert "B: c" not in str(refused.value)
