"""Lines of what is live, as it comes, until it ends or is ended."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Iterator

from plotfeed.feeds.console import INTERRUPTED
from plotfeed.feeds.console.printed import say
from plotfeed.feeds.console.process import stopped_by_signals
from plotfeed.feeds.recording.record import CaptureSource
from plotfeed.replay.recorded import Recorded

MAX_WAITING_LINES = 100_000


def show_live(
    source: CaptureSource,
    lines_of: Callable[[Recorded], Iterator[str]],
    *,
    count: int | None,
    duration_s: float | None,
) -> int:
    """Print so many of the lines of its messages, for so long; the exit code."""
    return asyncio.run(_shown(source, lines_of, count, duration_s))


async def _shown(
    source: CaptureSource,
    lines_of: Callable[[Recorded], Iterator[str]],
    count: int | None,
    duration_s: float | None,
) -> int:
    lines: asyncio.Queue[str] = asyncio.Queue(MAX_WAITING_LINES)
    dropped = 0

    def receive(message: Recorded) -> None:
        nonlocal dropped
        for line in lines_of(message):
            if lines.full():
                dropped += 1
            else:
                lines.put_nowait(line)

    try:
        await source.open(receive)
        printing = asyncio.create_task(_print(lines, count), name="print")
        with stopped_by_signals(printing.cancel) as signals:
            await asyncio.wait({printing}, timeout=duration_s)
        printing.cancel()
        await asyncio.gather(printing, return_exceptions=True)
    finally:
        await source.close()
    if dropped:
        say(f"plotfeed: {dropped} lines were not shown: the terminal is slower", err=True)
    return INTERRUPTED if signal.SIGINT in signals else 0


async def _print(lines: asyncio.Queue[str], count: int | None) -> None:
    printed = 0
    while count is None or printed < count:
        say(await lines.get())
        printed += 1
