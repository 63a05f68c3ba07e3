"""Who connects to the page and says nothing, or half of it: everybody else is served meanwhile."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from urllib.request import urlopen

import pytest
from support.command import running
from support.waiting import PATIENCE_S, wait_until

pytest.importorskip("uvicorn")

HALF = (b"", b"G", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n", b"GET / HTTP/1.1\r\nX: " + b"x" * 900)
MANY = 220


@contextlib.contextmanager
def connections(port: int, count: int) -> Iterator[list[socket.socket]]:
    with contextlib.ExitStack() as stack:
        yield [
            stack.enter_context(socket.create_connection(("127.0.0.1", port), PATIENCE_S))
            for _ in range(count)
        ]


def status(port: int) -> int:
    with urlopen(f"http://127.0.0.1:{port}/", timeout=PATIENCE_S) as answer:
        return int(answer.status)


def is_closed(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


def test_half_sent_requests_keep_nobody_out() -> None:
    with running("demo", "--broker", "none") as demo:
        port = demo.port("page")
        with connections(port, MANY) as attackers:
            for number, attacker in enumerate(attackers):
                with contextlib.suppress(OSError):
                    attacker.sendall(HALF[number % len(HALF)])
            assert status(port) == 200
            wait_until(lambda: all(map(is_closed, attackers)), "they stay")
        assert status(port) == 200


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
