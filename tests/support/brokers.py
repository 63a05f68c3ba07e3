"""Real brokers for tests, each on a free port of its own."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import json
import os
import random
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import (
    AbstractContextManager,
    ExitStack,
    asynccontextmanager,
    contextmanager,
    suppress,
)
from functools import cache
from itertools import cycle
from pathlib import Path
from typing import NamedTuple

from support.forked import NUMBER
from support.tools import needed
from support.waiting import PATIENCE_S, wait_until

from plotfeed.feeds.scene.output_keys import EmbeddedBrokerKeys
from plotfeed.feeds.transport.broker_process import listeners, serve
from plotfeed.feeds.transport.embedded_broker import EmbeddedBroker, Ports

TOGETHER = 3  # Ports that an embedded broker takes, one after the other
PROCESSES = 20  # Of tests, each with ports of its own: a port is free until it is listened on
# Below those that systems give to whoever connects, who may take one before we listen on it.
PORTS = range(20_000, 32_000, TOGETHER)


@cache
def _ports(number: str) -> Iterator[int]:
    """Those of a process of tests, from any of them on, over and over."""
    own = PORTS[int(number) % PROCESSES :: PROCESSES]
    first = random.SystemRandom().randrange(len(own))
    return cycle([*own[first:], *own[:first]])


def free_port() -> int:
    """One that is free as the next two are, and that nobody else in this process was given."""
    while True:
        # What is collected, which the process does that the others are forked from, has its own.
        port = next(_ports(os.environ.get(NUMBER, "-1")))
        with ExitStack() as held, suppress(OSError):
            for each in range(port, port + TOGETHER):
                held.enter_context(socket.socket()).bind(("127.0.0.1", each))
            return port


@contextmanager
def port_is_taken(port: int) -> Iterator[None]:
    """By this test alone: a session of another test that has it may end at any time."""
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)

        def holds_it() -> bool:
            with suppress(OSError):
                listener.bind(("127.0.0.1", port))
                listener.listen()
                return True
            return False

        wait_until(holds_it, f"somebody else has port {port}, and keeps it")
        yield


@contextmanager
def mosquitto(
    folder: Path, port: int, settings: str | None = None, *, per_listener: bool = True
) -> Iterator[subprocess.Popen[bytes]]:
    """Mosquitto on that port, for MQTT 3.1.1 and 5; skips the test where it is not installed.

    `settings` stand instead of a listener on loopback for everybody.
    """
    if settings is None:
        settings = f"listener {port} 127.0.0.1\nallow_anonymous true\n"
    program = needed("mosquitto")
    config = folder / f"mosquitto-{port}.conf"
    user = "user root\n" if os.geteuid() == 0 else ""  # else it may not read what we wrote
    each = "per_listener_settings true\nset_tcp_nodelay true\n" if per_listener else ""
    config.write_text(f"{user}{each}{settings}")
    command = [program, "-c", str(config)]

    def started() -> subprocess.Popen[bytes]:
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    broker = started()

    def listens() -> bool:
        """Begun anew where it ended: somebody else may have tried its port just then."""
        nonlocal broker
        if broker.poll() is not None:
            broker = started()
        return is_listening(port)

    try:
        wait_until(listens, f"nobody listens on port {port}")
        yield broker
    finally:
        broker.terminate()
        broker.wait(PATIENCE_S)


def quiet_mosquitto(folder: Path, port: int) -> AbstractContextManager[subprocess.Popen[bytes]]:
    """Mosquitto whose own queues are not what is tested."""
    listener = f"listener {port} 127.0.0.1\nallow_anonymous true\n"
    return mosquitto(folder, port, f"{listener}max_queued_messages 0\n")


def password_file(folder: Path, username: str, password: str) -> Path:
    """Of mosquitto, which keeps PBKDF2 hashes."""
    salt, rounds = os.urandom(12), 101
    digest = hashlib.pbkdf2_hmac("sha512", password.encode(), salt, rounds)
    packed = [base64.b64encode(octets).decode() for octets in (salt, digest)]
    path = folder / "passwords"
    path.write_text(f"{username}:$7${rounds}${'$'.join(packed)}\n")
    path.chmod(0o600)
    return path


@contextmanager
def mosquitto_with(folder: Path, access: str) -> Iterator[int]:
    """Its port, where plotfeed has that access and who does not say his name has all."""
    port, list_file = free_port(), folder / "access"
    list_file.write_text(f"topic readwrite #\n\n{access}\n")
    list_file.chmod(0o600)
    settings = (
        f"listener {port} 127.0.0.1\nallow_anonymous true\n"
        f"password_file {password_file(folder, 'plotfeed', 'secret')}\nacl_file {list_file}\n"
    )
    with mosquitto(folder, port, settings):
        yield port


@contextmanager
def own_broker(folder: Path, port: int) -> Iterator[subprocess.Popen[bytes]]:
    """The one that plotfeed brings; it writes nothing to the folder."""
    orders = EmbeddedBroker(Ports(port), EmbeddedBrokerKeys(), "plotfeed").orders
    broker = subprocess.Popen(
        [sys.executable, "-m", "plotfeed.feeds.transport.broker_process"],
        stdin=subprocess.PIPE,  # it lives as long as this is open
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    assert broker.stdin is not None
    try:
        broker.stdin.write(json.dumps(orders).encode() + b"\n")
        broker.stdin.flush()
        wait_until_listening(port)
        yield broker
    finally:
        with contextlib.suppress(BrokenPipeError):
            broker.stdin.close()  # first: whatever becomes of the rest, no open file is left behind
        broker.terminate()
        broker.wait(PATIENCE_S)


@asynccontextmanager
async def broker_here(**orders: object) -> AsyncIterator[int]:
    """The port of the same broker in the running loop, whose time may be its own."""
    with ExitStack() as held:
        (listener,) = listeners("127.0.0.1", [0], may_be_others=True)
        held.enter_context(listener)
        port = listener.getsockname()[1]
        keys = EmbeddedBroker(Ports(port), EmbeddedBrokerKeys(), "plotfeed").orders
        serving = asyncio.create_task(serve({**keys, **orders}, listener))
        try:
            yield port
        finally:
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)


def has_ipv6() -> bool:
    """Whether this machine has the loopback address of IPv6."""
    try:
        with socket.socket(socket.AF_INET6) as listener:
            listener.bind(("::1", 0))
    except OSError:
        return False
    return True


def wait_until_listening(port: int) -> None:
    wait_until(lambda: is_listening(port), f"nobody listens on port {port}")


def wait_until_silent(port: int) -> None:
    wait_until(lambda: not is_listening(port), f"somebody still listens on port {port}")


def is_listening(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 5):
        return True
    return False


class Socket(NamedTuple):
    """One by TCP of this machine, as the kernel tells of it."""

    address: str  # Its own, in hexadecimal
    port: int
    peer_port: int
    listens: bool
    inode: str


def sockets() -> list[Socket]:
    """All of this machine."""
    found = []
    for file in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{file}").read_text().splitlines()[1:]:
            _, local, peer, state, *_, inode = line.split()[:10]
            address, _, port = local.partition(":")
            peer_port = int(peer.rpartition(":")[2], 16)
            found.append(Socket(address, int(port, 16), peer_port, state == "0A", inode))
    return found


@contextmanager
def deaf_server() -> Iterator[int]:
    """The port of a server that takes connections and never says a word."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield listener.getsockname()[1]
