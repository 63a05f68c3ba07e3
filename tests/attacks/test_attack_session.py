"""Garbage and halves of requests at every door of a session: it goes on as if nobody sent them."""

from __future__ import annotations

import contextlib
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from urllib.request import urlopen

import pytest
from fuzz.targets import LIVE
from support.brokers import free_port
from support.chaos import DOORS, OVER_TCP, WAYS, beside
from support.command import running
from support.waiting import PATIENCE_S, wait_until

pytest.importorskip("uvicorn")

HALF = (b"", b"G", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n", b"GET / HTTP/1.1\r\nX: " + b"x" * 900)
UPGRADE = (
    "GET /feed HTTP/1.1\r\nHost: 127.0.0.1:{0}\r\nOrigin: http://127.0.0.1:{0}\r\n"
    "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)
GARBAGE = (b"\x10\xff\xff\xff\x7f", b"\x30\x02\x00", b"\0" * 99, bytes(range(256)))
MANY = 220


@contextlib.contextmanager
def connections(port: int, count: int) -> Iterator[list[socket.socket]]:
    with contextlib.ExitStack() as stack:
        yield [
            stack.enter_context(socket.create_connection(("127.0.0.1", port), PATIENCE_S))
            for _ in range(count)
        ]


def status(port: int, path: str = "") -> int:
    with urlopen(f"http://127.0.0.1:{port}/{path}", timeout=PATIENCE_S) as answer:
        return int(answer.status)


def is_closed(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        while connection.recv(65536):
            pass
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True


def test_half_sent_requests_and_garbage_keep_nobody_out() -> None:
    metrics = free_port()
    with running("demo", "--broker", "none", "--metrics", metrics) as demo:
        port = demo.port("page")
        openings = [*HALF, *GARBAGE, UPGRADE.format(port).encode() + GARBAGE[-1]]
        with connections(port, MANY) as attackers, connections(metrics, len(openings)) as others:
            for number, attacker in enumerate([*attackers, *others]):
                with contextlib.suppress(OSError):
                    attacker.sendall(openings[number % len(openings)])
            assert status(port) == status(metrics, "metrics") == 200
            wait_until(lambda: all(map(is_closed, attackers)), "they stay")
        assert status(port) == 200
        code, _, err = demo.end(signal.SIGTERM)
    assert (code, err) == (0, "")


def test_a_second_request_that_does_not_end_is_given_up_too() -> None:
    with running("demo", "--broker", "none") as demo:
        port = demo.port("page")
        with connections(port, 1) as (slow,):
            whole = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode()
            slow.sendall(whole + b"GET / HT")
            answer = b""
            while more := slow.recv(65536):
                answer += more
            assert answer.startswith(b"HTTP/1.1 200")


SECONDS = 1.5  # tools/soak/chaos.py has ten, for each door alone


@pytest.mark.parametrize("ways", [WAYS[:3], WAYS[3:]], ids=" ".join)
@pytest.mark.asyncio
async def test_whoever_misbehaves_at_all_doors_changes_no_octet(
    ways: tuple[str, ...], tmp_path: Path
) -> None:
    found = await beside(DOORS, ways, SECONDS, tmp_path)
    assert (found.differing, found.sectors > 5, found.refused > 0) == (0, True, True)


def test_every_kind_of_live_source_is_a_door() -> None:
    assert {door.partition(" ")[0] for door in DOORS if " " in door} == LIVE.keys()
    assert {*OVER_TCP} == LIVE.keys() - {"remote-id"}
