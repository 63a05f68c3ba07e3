"""The command in a process of its own, or in the test's."""

from __future__ import annotations

import atexit
import io
import json
import logging
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from functools import cache
from pathlib import Path
from threading import Lock
from typing import IO
from unittest.mock import patch

from support import ready_process
from support.waiting import PATIENCE_S

from plotfeed.feeds.cli.main import main

# As a user starts it: for tests of the start itself, which takes a second of imports.
PLOTFEED = [sys.executable, "-m", "plotfeed.feeds.cli"]
LOOK_EVERY_S = 0.01
_asking = Lock()


@cache
def ready() -> socket.socket:
    """To one that has imported everything and waits, which ends when this process does."""
    ours, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
    with theirs:
        words = [sys.executable, ready_process.__file__, str(theirs.fileno())]
        process = subprocess.Popen(words, stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()])

    def end() -> None:
        ours.close()
        process.wait()

    atexit.register(end)
    return ours


class Started:
    """A process of `plotfeed`, forked by one that waits, with what tests use of `Popen`."""

    def __init__(self, *words: object, folder: Path | None = None, stdin: str = "") -> None:
        news, tells = os.pipe()
        given, gives = os.pipe()
        out, says = os.pipe()
        err, complains = os.pipe()
        environment = dict(os.environ)
        orders = json.dumps([[*map(str, words)], str(folder or Path.cwd()), environment])
        with _asking:
            socket.send_fds(ready(), [orders.encode()], [tells, given, says, complains])
        for theirs in (tells, given, says, complains):
            os.close(theirs)
        with os.fdopen(gives, "w") as typed:
            typed.write(stdin)
        self.stdout: IO[str] = os.fdopen(out)
        self.stderr: IO[str] = os.fdopen(err)
        self._news = os.fdopen(news)
        self.pid = int(self._news.readline())
        self.returncode: int | None = None
        self._said: tuple[str, str] | None = None
        self._ending = Lock()  # Threads of a test may ask at the same time

    def poll(self) -> int | None:
        """Its exit code once it has ended."""
        with self._ending:
            if self.returncode is None and select.select([self._news], [], [], 0)[0]:
                self.returncode = int(self._news.readline())
                self._news.close()
            return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        end_s = time.monotonic() + (float("inf") if timeout is None else timeout)
        while (code := self.poll()) is None:
            if time.monotonic() >= end_s:
                raise subprocess.TimeoutExpired("plotfeed", timeout or 0.0)
            time.sleep(LOOK_EVERY_S)
        return code

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """What it has yet written to its end; one that does not end in time is killed."""
        if self._said is None:
            with ThreadPoolExecutor() as reading:
                out, err = (reading.submit(each.read) for each in (self.stdout, self.stderr))
                try:
                    self.wait(timeout)
                except BaseException:
                    self.kill()
                    raise
            self._said = out.result(), err.result()
            self.stdout.close()
            self.stderr.close()
        return self._said

    def send_signal(self, which: signal.Signals) -> None:
        if self.poll() is None:
            with suppress(ProcessLookupError):  # it has ended, and that is about to be told
                os.kill(self.pid, which)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


@contextmanager
def started(*words: object, folder: Path | None = None) -> Iterator[Started]:
    """At work, and killed at last."""
    process = Started(*words, folder=folder)
    try:
        yield process
    finally:
        process.kill()
        process.communicate(PATIENCE_S)


def plotfeed(
    *words: object, stdin: str = "", wait_s: float = PATIENCE_S
) -> subprocess.CompletedProcess[str]:
    """Run it to its end in a process of its own; whatever happens, no traceback."""
    process = Started(*words, stdin=stdin)
    out, err = process.communicate(wait_s)
    assert "Traceback" not in err, err
    return subprocess.CompletedProcess([*words], process.wait(), out, err)


def plotfeed_here(*words: object) -> subprocess.CompletedProcess[str]:
    """Run it in this process, which has its modules already: for what soon ends by itself."""
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
    argv = ["plotfeed", *map(str, words)]
    log, level = logging.getLogger(), logging.getLogger().level
    with (
        patch.object(sys, "argv", argv),
        patch.object(log, "handlers", []),  # where there are any, the command adds none
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as end:
            code = end.code
        finally:
            log.setLevel(level)
    return subprocess.CompletedProcess(
        argv, int(code or 0), *(each.buffer.getvalue().decode() for each in (out, err))
    )


def refusal(*words: object) -> str:
    """The line in which it refuses what it is asked, which may stand behind how it is used."""
    done = plotfeed_here(*words)
    assert (done.returncode, done.stdout) == (2, "")
    *before, line = done.stderr.splitlines()
    assert not before or before[0].startswith("Usage: ")
    return line


class Running:
    """A session that has introduced itself."""

    def __init__(self, *words: object, folder: Path | None = None) -> None:
        self.process = Started(*words, folder=folder)
        self.introduction: list[str] = []
        for line in self.process.stdout:
            self.introduction.append(line.rstrip())
            if line.startswith("look at it"):
                return
        raise AssertionError(f"it ended: {self.process.communicate()}")

    def port(self, protocol: str) -> int:
        (line,) = (x for x in self.introduction if x.strip().startswith(protocol))
        return int(line.split("://")[1].split(":")[1].split()[0].rstrip("/"))

    def ports(self) -> list[tuple[int, int]]:
        """The port of the embedded broker with each version that it speaks."""
        return [(self.port("MQTT"), version) for version in (4, 5)]

    def end(self, how: signal.Signals) -> tuple[int, str, str]:
        """Exit code, and what was written after the introduction."""
        self.process.send_signal(how)
        out, err = self.process.communicate(PATIENCE_S)
        return self.process.wait(), out, err


@contextmanager
def running(*words: object, folder: Path | None = None) -> Iterator[Running]:
    """In that folder, or where the tests run."""
    session = Running(*words, folder=folder)
    try:
        yield session
    finally:
        session.process.kill()
        session.process.communicate(PATIENCE_S)
