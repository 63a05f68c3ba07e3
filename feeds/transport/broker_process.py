"""What runs in the child processes of the embedded broker: iotcore's broker, or its WebSocket.

Run as a module with its orders in JSON. It serves until its standard input closes, which it does
when the parent ends, however that ends, and leaves no file behind.
"""

from __future__ import annotations

import asyncio
import contextlib
import http
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.console.posix import allow_many_files
from plotfeed.feeds.transport.local_hosts import LOOPBACK, LOOPBACK_NAMES, name_in_host

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

OUT_OF_MEMORY = 70  # The exit code of one that took more memory than it may
LOOK_EVERY_S = 0.1  # From one look at the memory to the next
MIB = 1 << 20
MEMORY = Path("/proc/self/statm")
READ_OCTETS = 1 << 16


def main(orders: dict[str, Any]) -> None:
    """Serve what the orders say."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    allow_many_files()
    if MEMORY.exists():
        watched = (int(orders["max_memory_mib"]) * MIB,)
        threading.Thread(target=_end_beyond, args=watched, daemon=True).start()
    if "configuration" in orders:
        _serve_mqtt(orders["configuration"])
    else:
        gate = _serve_websocket(orders["port"], orders["broker_port"], orders["origins"])
        asyncio.run(gate)


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    os._exit(0)


def _end_beyond(octets: int) -> None:
    page = os.sysconf("SC_PAGE_SIZE")
    while int(MEMORY.read_text("ascii").split()[1]) * page <= octets:
        time.sleep(LOOK_EVERY_S)
    os._exit(OUT_OF_MEMORY)


def _serve_mqtt(configuration: str) -> None:
    from iotcore import IotCoreBroker

    with TemporaryDirectory(prefix="plotfeed-broker-") as folder:
        path = Path(folder, "broker.toml")
        path.write_text(configuration, encoding="utf-8")
        broker = IotCoreBroker(config_path=str(path))  # it has read it now
    broker.run_forever()


async def _serve_websocket(port: int, broker_port: int, origins: Sequence[str]) -> None:
    """Pass on what comes over WebSocket, from pages of those origins and from who is no browser."""
    from websockets.asyncio.server import serve
    from websockets.typing import Origin, Subprotocol

    async def pass_on(client: ServerConnection) -> None:
        try:
            reader, writer = await asyncio.open_connection(LOOPBACK, broker_port)
        except OSError:
            return  # which closes it
        back = asyncio.create_task(_answers(reader, client))
        try:
            async for data in client:
                writer.write(data.encode() if isinstance(data, str) else data)
                await writer.drain()
        except OSError:
            pass
        finally:
            back.cancel()
            writer.close()

    server = await serve(
        pass_on,
        LOOPBACK,
        port,
        origins=[None, *map(Origin, origins)],
        subprotocols=[Subprotocol("mqtt")],
        compression=None,
        process_request=_refusal,
    )
    await server.serve_forever()


async def _answers(reader: asyncio.StreamReader, client: ServerConnection) -> None:
    with contextlib.suppress(OSError):
        while octets := await reader.read(READ_OCTETS):
            await client.send(octets)
    await client.close()


def _refusal(client: ServerConnection, request: Request) -> Response | None:
    """Answer those whose page has a name of its own for this machine."""
    if name_in_host(request.headers.get("Host", "")) in LOOPBACK_NAMES:
        return None
    return client.respond(http.HTTPStatus.FORBIDDEN, "This is not the host that was asked for.\n")


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
