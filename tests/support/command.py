"""The command in a process of its own, as a user starts it."""

from __future__ import annotations

import io
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import patch

from support.waiting import PATIENCE_S

from plotfeed.feeds.cli.main import main

PLOTFEED = [sys.executable, "-m", "plotfeed.feeds.cli"]


def plotfeed(
    *arguments: object, stdin: str = "", wait_s: float = PATIENCE_S
) -> subprocess.CompletedProcess[str]:
    """Run it to its end; whatever happens, no traceback."""
    done = subprocess.run(
        [*PLOTFEED, *map(str, arguments)],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=wait_s,
        check=False,
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done


def plotfeed_here(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run it in this process, which has its modules already: for what soon ends by itself."""
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
    words = ["plotfeed", *map(str, arguments)]
    with patch.object(sys, "argv", words), redirect_stdout(out), redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = end.code
    return subprocess.CompletedProcess(
        words, int(code or 0), *(each.buffer.getvalue().decode() for each in (out, err))
    )


class Running:
    """A session that has introduced itself."""

    def __init__(self, *arguments: object, folder: Path | None = None) -> None:
        self.process = subprocess.Popen(
            [*PLOTFEED, *map(str, arguments)],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.introduction: list[str] = []
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.introduction.append(line.rstrip())
            if line.startswith("look at it"):
                return
        raise AssertionError(f"it ended: {self.process.communicate()}")

    def port(self, protocol: str) -> int:
        (line,) = (x for x in self.introduction if x.strip().startswith(protocol))
        return int(line.split("://")[1].split(":")[1].split()[0].rstrip("/"))

    def ports(self) -> list[tuple[int, int]]:
        """Ports and versions of the embedded broker."""
        return [(self.port("MQTT 3.1.1"), 4), (self.port("MQTT 5"), 5)]

    def end(self, how: signal.Signals) -> tuple[int, str, str]:
        """Exit code, and what was written after the introduction."""
        self.process.send_signal(how)
        out, err = self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode, out, err


@contextmanager
def running(*arguments: object, folder: Path | None = None) -> Iterator[Running]:
    """In that folder, or where the tests run."""
    session = Running(*arguments, folder=folder)
    try:
        yield session
    finally:
        if session.process.poll() is None:
            session.process.kill()
        session.process.communicate(timeout=PATIENCE_S)
