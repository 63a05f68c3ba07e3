"""Events as PyTAK receives them from a server, over TCP: which, and where they say things are."""

from __future__ import annotations

import asyncio
import contextlib
import json
from pathlib import Path

import numpy as np
import pytest
from support.brokers import free_port
from support.deliveries import FollowedDelivery
from support.told_tracks import RADAR, T_NS, told_tracks
from support.waiting import PATIENCE_S, kept_up, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import TakServer
from plotfeed.feeds.transport.tak import TakTransport
from plotfeed.proto.content_types import COT
from plotfeed.proto.tracks.encode_tracks import cot_events

ROOT = Path(__file__).parents[3]
PYTHON = ROOT / ".venv-utm" / "bin" / "python"
CLIENT = ROOT / "tests" / "support" / "pytak_client.py"
TRACKS = told_tracks(20, np.random.default_rng(611))


class Relay:
    """A server that passes on what one client says to all the others, as TAK servers do."""

    def __init__(self) -> None:
        self.clients: list[asyncio.StreamWriter] = []

    async def attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.clients.append(writer)
        with contextlib.suppress(ConnectionError):
            while octets := await reader.read(65_536):
                for other in self.clients:
                    if other is not writer:
                        other.write(octets)


@pytest.mark.asyncio
async def test_pytak_receives_every_event_that_a_server_passes_on() -> None:
    if not PYTHON.exists():
        pytest.skip("PyTAK is not here: make .venv-utm/.ready")
    port, relay = free_port(), Relay()
    server = await asyncio.start_server(relay.attend, "127.0.0.1", port)
    words = (str(CLIENT), f"tcp://127.0.0.1:{port}", str(len(TRACKS)))
    client = await asyncio.create_subprocess_exec(
        str(PYTHON), *words, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    transport = TakTransport(TakServer(server=f"tcp://127.0.0.1:{port}"))
    try:
        await until(lambda: relay.clients or client.returncode is not None)
        async with kept_up(transport.run()):
            events = cot_events(TRACKS, RADAR)
            transport.publish([FollowedDelivery(Message("t", e, COT, T_NS)) for e in events])
            async with asyncio.timeout(PATIENCE_S):
                said, complaints = await client.communicate()
    finally:
        with contextlib.suppress(ProcessLookupError):
            client.kill()
        server.close()
        for writer in relay.clients:
            writer.transport.abort()
    assert client.returncode == 0, complaints.decode()
    found = [json.loads(line) for line in said.splitlines()]
    assert [each["uid"] for each in found] == [f"radar-{number}" for number in TRACKS.track]
    for name, column in (("lat", TRACKS.latitude_deg), ("lon", TRACKS.longitude_deg)):
        assert [each[name] for each in found] == pytest.approx(column.tolist(), abs=1e-7)
