"""Tracks on their way to servers of UTM and TAK that are slow, broken, strict or away."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import ssl
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
import pytest
from support.brokers import free_port
from support.certificates import Certificates
from support.deliveries import published
from support.own_time import in_own_time
from support.servers import (
    BABBLE,
    HANG_UP,
    SAY_NOTHING,
    Answer,
    HttpReceiver,
    http_receiver,
    serving,
)
from support.told_tracks import RADAR, told_tracks
from support.waiting import PATIENCE_S, kept_up, until

from plotfeed.feeds.scene.output_keys import HttpDestination, TakServer
from plotfeed.feeds.transport.http import HttpTransport
from plotfeed.feeds.transport.mqtt.address import AccessError
from plotfeed.feeds.transport.tak import TakTransport
from plotfeed.proto.content_types import COT
from plotfeed.proto.tracks.encode_tracks import cot_events

BY_TOKEN = {"token": "UTM"}
TRAFFIC, F3411 = (
    HttpDestination(url="http://h/", carries=kind).content_type  # type: ignore[arg-type]
    for kind in ("air-traffic", "f3411")
)


@pytest.fixture(autouse=True)
def _warned(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    caplog.set_level(logging.WARNING)
    monkeypatch.setenv("PLOTFEED_HTTP_TOKEN_UTM", "s3cret")


def posting(port: int, **keys: Any) -> HttpTransport:
    tree = {"url": f"http://127.0.0.1:{port}/set/{{session}}?a=1", "timeout_s": 20.0, **keys}
    return HttpTransport(HttpDestination.model_validate(tree), "http[0]")


async def outcome(
    answers: list[Answer], *bodies: bytes, **keys: Any
) -> tuple[HttpReceiver, list[bool | None]]:
    """What came of posts to a server that answers so."""
    async with http_receiver(answers) as server:
        transport = posting(server.port, **keys)
        async with kept_up(transport.run()):
            made = published(transport, TRAFFIC, *bodies)
            await until(lambda: all(each.was_delivered is not None for each in made))
    return server, [each.was_delivered for each in made]


@in_own_time
async def test_messages_are_posted_in_order_on_one_connection_with_the_token() -> None:
    server, delivered = await outcome([], b"one", b"two", b"three", **BY_TOKEN)
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
    server, delivered = await outcome([trouble, trouble], b"one", b"two")
    assert delivered == [True, True]
    assert server.bodies == [b"one", b"one", b"one", b"two"]
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == 2, "a line when it begins to fail, and one when it works again"
    assert "http[0] http://127.0.0.1" in told[0]
    assert "again" in told[1]


@pytest.mark.parametrize(
    ("refusal", "retries"), [(400, 9), (401, 9), (404, 9), (422, 9), (307, 9), (500, 2)]
)
@in_own_time
async def test_what_a_server_refuses_or_never_takes_is_given_up_and_told_of_once(
    refusal: int, retries: int, caplog: pytest.LogCaptureFixture
) -> None:
    """Only a server in trouble is asked again, a message as often as its retries."""
    posts = 3 if refusal == 500 else 1
    answers: list[Answer] = [refusal] * (2 * posts)
    server, delivered = await outcome(answers, b"one", b"two", retries=retries, **BY_TOKEN)
    assert delivered == [False, False]
    assert server.bodies == [b"one"] * posts + [b"two"] * posts
    (line,) = [record.getMessage() for record in caplog.records]
    assert str(refusal) in line
    assert "s3cret" not in line


@in_own_time
async def test_a_server_that_comes_late_gets_the_newest_that_found_room() -> None:
    port = free_port()
    transport = posting(port, queue_messages=2, retries=100)
    (other,) = published(transport, F3411, b"x")  # which is left to others
    async with kept_up(transport.run()):
        made = published(transport, TRAFFIC, b"one", b"two", b"three", b"four")
        assert [each.was_delivered for each in made] == [False, False, None, None]
        async with http_receiver(port=port) as server:
            await until(lambda: all(each.was_delivered is not None for each in made))
        (late,) = published(transport, TRAFFIC, b"five")
    assert server.bodies[-2:] == [b"three", b"four"]
    assert (late.was_delivered, late.not_to) == (False, (transport.name,))
    assert (other.said, other.not_to) == ([True], ())


def test_a_token_that_is_none_is_told_and_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    for token, words in (("", "no PLOTFEED_HTTP_TOKEN_UTM"), ("a\r\nB: c", "ASCII")):
        monkeypatch.setenv("PLOTFEED_HTTP_TOKEN_UTM", token)
        with pytest.raises(AccessError, match=words) as refused:
            posting(1, **BY_TOKEN)
        assert "B: c" not in str(refused.value)


# TAK servers: events over TCP or TLS.


def to(server: str, **keys: Any) -> TakTransport:
    return TakTransport(TakServer.model_validate({"server": server, **keys}))


class Ears:
    """A server that keeps what it reads, and passes it on to the others, as TAK servers do."""

    def __init__(self, *, reads: bool = True, greets: bool = True) -> None:
        self.heard = b""
        self.connections: list[asyncio.StreamWriter] = []
        self._reads, self._greets = reads, greets

    async def attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections.append(writer)
        writer.write(b"<event/>" * self._greets)  # of others, which nobody here wants
        try:
            while octets := await (reader.read(65_536) if self._reads else asyncio.Future()):
                self.heard += octets
                for other in {*self.connections} - {writer}:
                    other.write(octets)
        except ConnectionError:
            pass
        finally:
            writer.close()


@in_own_time
async def test_events_come_one_behind_the_other_and_again_after_the_server_has_gone() -> None:
    port, first, second = free_port(), Ears(), Ears()
    transport = to(f"tcp://127.0.0.1:{port}")
    async with kept_up(transport.run()):
        async with serving(first.attend, port):
            published(transport, COT, b"<event>1</event>", b"<event>2</event>")
            await until(lambda: first.heard == b"<event>1</event><event>2</event>")
        await asyncio.sleep(0.1)  # its goodbye comes before the next event
        async with serving(second.attend, port):
            published(transport, COT, b"<event>3</event>")
            await until(lambda: second.heard == b"<event>3</event>")


@in_own_time
async def test_a_server_that_does_not_read_is_left_and_the_oldest_give_way() -> None:
    ears = Ears(reads=False)
    async with serving(ears.attend) as port:
        transport = to(f"tcp://127.0.0.1:{port}", queue_messages=3)
        async with kept_up(transport.run()):
            made = published(transport, COT, *[b"x" * 4_000_000] * 3)
            await until(lambda: len(ears.connections) > 1)
            more = published(transport, COT, *[b"y"] * 3)
            assert made[0].was_delivered is not None
    assert all(each.was_delivered is not None for each in [*made, *more])


def told(caplog: pytest.LogCaptureFixture) -> list[str]:
    """Lines about the server; the one of this test has its own to say."""
    return [text for text in caplog.messages if text.startswith("tak tls://localhost")]


@pytest.mark.parametrize("who", ["client", "nobody", "another-ca"])
@in_own_time
async def test_tls_with_certificates_of_both_sides(
    tmp_path: Path, who: str, caplog: pytest.LogCaptureFixture
) -> None:
    certificates, ears = Certificates(tmp_path), Ears()
    tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=certificates.ca)
    tls.load_cert_chain(certificates.broker.certificate, certificates.broker.key)
    tls.verify_mode = ssl.CERT_REQUIRED
    ca = certificates.other_ca if who == "another-ca" else certificates.ca
    keys: dict[str, Any] = {"ca_file": str(ca)}
    if who != "nobody":
        keys["client_certificate_file"] = str(certificates.client.certificate)
        keys["client_key_file"] = str(certificates.client.key)
    async with serving(ears.attend, tls=tls) as port:
        transport = to(f"tls://localhost:{port}", **keys)
        async with kept_up(transport.run()):
            (made,) = published(transport, COT, b"<event/>")
            if who == "client":
                await until(lambda: ears.heard == b"<event/>")
                assert made.was_delivered
            else:
                # By TLS 1.3 a server says only afterwards whom it does not let in.
                await until(lambda: published(transport, COT, b"<event/>") and told(caplog))
                assert len(told(caplog)) == 1
    assert (ears.heard == b"<event/>") == (who == "client")


def test_what_is_no_server_and_certificates_that_are_not_there_are_told_at_once() -> None:
    for keys, words in (
        ({"server": "udp://h:1"}, "tcp://HOST:PORT"),
        ({"server": "tcp://u:p@h:1"}, "tcp://HOST:PORT"),
        ({"server": "tcp://h:1", "ca_file": "x"}, "need tls"),
    ):
        with pytest.raises(ValueError, match=words):
            to(**keys)
    with pytest.raises(AccessError, match="CA file"):
        to("tls://h", ca_file="/nowhere/ca.pem")


ROOT = Path(__file__).parents[3]
PYTHON = ROOT / ".venv-utm" / "bin" / "python"
CLIENT = ROOT / "tests" / "support" / "utm_oracles.py"


@pytest.mark.asyncio
async def test_pytak_receives_every_event_that_a_server_passes_on() -> None:
    if not PYTHON.exists():
        pytest.skip("PyTAK is not here: make .venv-utm/.ready")
    tracks, ears = told_tracks(20, np.random.default_rng(611)), Ears(greets=False)
    async with serving(ears.attend) as port:
        words = (str(CLIENT), f"tcp://127.0.0.1:{port}", str(len(tracks)))
        client = await asyncio.create_subprocess_exec(
            str(PYTHON), *words, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
        )
        transport = to(f"tcp://127.0.0.1:{port}")
        try:
            await until(lambda: ears.connections or client.returncode is not None)
            async with kept_up(transport.run()):
                published(transport, COT, *cot_events(tracks, RADAR))
                async with asyncio.timeout(PATIENCE_S):
                    said, complaints = await client.communicate()
        finally:
            with contextlib.suppress(ProcessLookupError):
                client.kill()
    assert client.returncode == 0, complaints.decode()
    found = [json.loads(line) for line in said.splitlines()]
    assert [each["uid"] for each in found] == [f"radar-{number}" for number in tracks.track]
    for name, column in (("lat", tracks.latitude_deg), ("lon", tracks.longitude_deg)):
        assert [each[name] for each in found] == pytest.approx(column.tolist(), abs=1e-7)
