"""Events on their way to TAK servers that hang up, come back, do not read, want certificates."""

from __future__ import annotations

import asyncio
import contextlib
import json
import ssl
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.brokers import free_port
from support.certificates import Certificates
from support.deliveries import FollowedDelivery
from support.own_time import in_own_time
from support.told_tracks import RADAR, told_tracks
from support.waiting import PATIENCE_S, kept_up, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import TakServer
from plotfeed.feeds.transport.mqtt.address import AccessError
from plotfeed.feeds.transport.tak import TakTransport
from plotfeed.proto.content_types import COT
from plotfeed.proto.tracks.encode_tracks import cot_events


def to(server: str, **keys: Any) -> TakTransport:
    return TakTransport(TakServer.model_validate({"server": server, **keys}))


def publish(transport: TakTransport, *events: bytes) -> list[FollowedDelivery]:
    made = [FollowedDelivery(Message("t", event, COT, 0)) for event in events]
    transport.publish(made)
    return made


class Ears:
    """A server that keeps what it reads, and passes it on to the others, as TAK servers do."""

    def __init__(self, *, reads: bool = True, greets: bool = True) -> None:
        self.heard = b""
        self.connections: list[asyncio.StreamWriter] = []
        self._reads, self._greets = reads, greets

    async def attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections.append(writer)
        writer.write(b"<event/>" * self._greets)  # of others, which nobody here wants
        if not self._reads:
            await asyncio.Event().wait()
        with contextlib.suppress(ConnectionError):
            while octets := await reader.read(65_536):
                self.heard += octets
                for other in {*self.connections} - {writer}:
                    other.write(octets)
        writer.close()


@contextlib.asynccontextmanager
async def listening(
    ears: Ears, port: int = 0, tls: ssl.SSLContext | None = None
) -> AsyncIterator[int]:
    server = await asyncio.start_server(ears.attend, "127.0.0.1", port, ssl=tls)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for writer in ears.connections:
            writer.transport.abort()


@in_own_time
async def test_events_come_one_behind_the_other_and_again_after_the_server_has_gone() -> None:
    port, first, second = free_port(), Ears(), Ears()
    transport = to(f"tcp://127.0.0.1:{port}")
    async with kept_up(transport.run()):
        async with listening(first, port):
            publish(transport, b"<event>1</event>", b"<event>2</event>")
            await until(lambda: first.heard == b"<event>1</event><event>2</event>")
        async with listening(second, port):

            def goes_on() -> bool:
                publish(transport, b"<event>3</event>")
                return b"<event>3</event>" in second.heard

            await until(goes_on)


@in_own_time
async def test_a_server_that_does_not_read_is_left_and_the_oldest_give_way() -> None:
    ears = Ears(reads=False)
    async with listening(ears) as port:
        transport = to(f"tcp://127.0.0.1:{port}", queue_messages=3)
        async with kept_up(transport.run()):
            made = publish(transport, *[b"x" * 4_000_000] * 3)
            await until(lambda: len(ears.connections) > 1)
            more = publish(transport, *[b"y"] * 3)
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
    async with listening(ears, tls=tls) as port:
        transport = to(f"tls://localhost:{port}", **keys)
        async with kept_up(transport.run()):
            (made,) = publish(transport, b"<event/>")
            if who == "client":
                await until(lambda: ears.heard == b"<event/>")
                assert made.was_delivered
            else:
                # By TLS 1.3 a server says only afterwards whom it does not let in.
                await until(lambda: publish(transport, b"<event/>") and told(caplog))
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
CLIENT = ROOT / "tests" / "support" / "pytak_client.py"


@pytest.mark.asyncio
async def test_pytak_receives_every_event_that_a_server_passes_on() -> None:
    if not PYTHON.exists():
        pytest.skip("PyTAK is not here: make .venv-utm/.ready")
    tracks, ears = told_tracks(20, np.random.default_rng(611)), Ears(greets=False)
    async with listening(ears) as port:
        words = (str(CLIENT), f"tcp://127.0.0.1:{port}", str(len(tracks)))
        client = await asyncio.create_subprocess_exec(
            str(PYTHON), *words, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
        )
        transport = to(f"tcp://127.0.0.1:{port}")
        try:
            await until(lambda: ears.connections or client.returncode is not None)
            async with kept_up(transport.run()):
                publish(transport, *cot_events(tracks, RADAR))
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
