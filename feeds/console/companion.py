"""A program that runs beside a session: what it says last, and how it ends."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from asyncio.subprocess import DEVNULL, PIPE, STDOUT, Process
from collections.abc import AsyncIterator, Mapping, Sequence

from plotfeed.feeds.console.posix import end_group
from plotfeed.proto.errors import PlotfeedError

TERM_S = 5.0  # It has so long to end when it is told to; then it is killed
MAX_LINE = 200  # Characters of its last line that are told


@contextlib.asynccontextmanager
async def beside(
    words: Sequence[str], environment: Mapping[str, str], name: str
) -> AsyncIterator[Companion]:
    """A program that runs meanwhile, and is gone afterwards with all that it has started.

    `environment` is added to this process's own. Raises `PlotfeedError`, which names the option of
    that name.
    """
    try:
        process = await asyncio.create_subprocess_exec(
            *words,
            stdin=DEVNULL,
            stdout=PIPE,
            stderr=STDOUT,
            env={**os.environ, **environment, "PYTHONUNBUFFERED": "1"},
            start_new_session=True,
        )
    except OSError as error:
        raise PlotfeedError(f"--{name}: {error.strerror or error}") from None
    companion = Companion(process, name)
    try:
        yield companion
    finally:
        await companion.end()


class Companion:
    """A program while it runs."""

    def __init__(self, process: Process, name: str) -> None:
        self._process, self._name = process, name
        self._said = asyncio.Event()
        self._last = ""
        self._reading = asyncio.create_task(self._read(), name=name)

    async def wait_until_ready(self, patience_s: float) -> None:
        """Wait for its first line or its end, or for so long."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._said.wait(), patience_s)

    def failure(self) -> str:
        """How it has ended by now, although nobody told it to; empty while it runs."""
        code = self._process.returncode
        if code is None:
            return ""
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        return f"the {self._name} ended by itself, {how}" + (f": {self._last}" * bool(self._last))

    async def end(self) -> None:
        """Tell it to end, and kill it if it does not."""
        end_group(self._process, kill=False)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._process.wait(), TERM_S)
        end_group(self._process, kill=True)
        await self._process.wait()
        self._reading.cancel()
        await asyncio.gather(self._reading, return_exceptions=True)

    async def _read(self) -> None:
        """Read what it says, so that it never waits: the last line counts."""
        stream = self._process.stdout
        line = b""
        while stream is not None and (octets := await stream.read(1 << 16)):
            *whole, line = (line + octets).split(b"\n")
            line = line[-MAX_LINE:]
            if whole:
                self._said.set()
                last = next((each for each in reversed(whole) if each.strip()), b"")
                self._last = last[-MAX_LINE:].decode(errors="replace").strip() or self._last
        self._last = line.decode(errors="replace").strip() or self._last
        self._said.set()
