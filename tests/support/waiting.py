"""Waits for what must come sooner or later, all with one patience."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import threading
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

PATIENCE_S = 120.0  # On a machine that may be busy


async def until(holds: Callable[[], object], says: str = "it never came to that") -> None:
    """Return when it holds; meanwhile the event loop goes on. What takes long is looked at less."""
    loop, pause_s = asyncio.get_running_loop(), 0.005
    deadline_s = loop.time() + PATIENCE_S
    while not holds():
        assert loop.time() < deadline_s, says
        await asyncio.sleep(pause_s)
        pause_s = min(1.1 * pause_s, 0.1)


def wait_until(
    holds: Callable[[], object],
    says: str = "it never came to that",
    pause: Callable[[float], object] = time.sleep,
) -> None:
    """Return when it holds, where no event loop has to go on."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline_s, says
        pause(0.01)


@contextlib.asynccontextmanager
async def kept_up(work: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
    """Do that work, which has begun, for as long as this lasts."""
    running = asyncio.create_task(work)
    await asyncio.sleep(0)
    try:
        yield
    finally:
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running


def first_lines(command: Sequence[str | Path], count: int, **environment: str) -> list[str]:
    """So many lines of a program that never ends by itself, and has nothing to complain of."""
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | environment,
    )
    late = threading.Timer(PATIENCE_S, process.kill)
    late.start()
    try:
        assert process.stdout is not None
        found = [line.rstrip() for line in islice(process.stdout, count)]
    finally:
        late.cancel()
        process.kill()
        _, errors = process.communicate()
    assert errors == ""
    assert len(found) == count
    return found
