"""What a broker has, one line a message as they come; or a recording."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from plotfeed.feeds.console.signals import INTERRUPTED, stopped_by_signals
from plotfeed.feeds.recording.decoded_text import categories_of, message_lines
from plotfeed.feeds.recording.record_mqtt import BrokerSource
from plotfeed.feeds.recording.show_file import show_file
from plotfeed.replay.recorded import Recorded

MAX_WAITING_LINES = 100_000


def show_source(
    source: str,
    access: dict[str, Any],
    *,
    listed: bool,
    count: int | None,
    duration: float | None,
    as_json: bool,
    editions: Sequence[str] = (),
) -> int:
    """Print the messages of a broker, or what a file holds; the exit code.

    `access` holds the keyword arguments of `BrokerAddress.parse`, `listed` says that the messages
    of a file are wanted. Raises `PlotfeedError`, and `OSError` of a file.
    """
    categories = categories_of(editions)
    if "://" not in source:
        return show_file(
            Path(source), listed=listed, count=count, as_json=as_json, categories=categories
        )
    expected = "a file or mqtt://HOST:PORT/TOPIC-FILTER"
    broker = BrokerSource.parse(source, access, "plotfeed-show", expected=expected)
    lines_of = partial(message_lines, as_json=as_json, categories=categories)
    return asyncio.run(_show_broker(broker, count, duration, lines_of))


async def _show_broker(
    source: BrokerSource,
    count: int | None,
    duration_s: float | None,
    lines_of: Callable[[str, bytes, str | None], Iterator[str]],
) -> int:
    lines: asyncio.Queue[str] = asyncio.Queue(MAX_WAITING_LINES)
    dropped = 0

    def receive(message: Recorded) -> None:
        nonlocal dropped
        for line in lines_of(message.topic, message.payload, message.content_type or None):
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
        click.echo(f"plotfeed: {dropped} lines were not shown: the terminal is slower", err=True)
    return INTERRUPTED if signal.SIGINT in signals else 0


async def _print(lines: asyncio.Queue[str], count: int | None) -> None:
    printed = 0
    while count is None or printed < count:
        click.echo(await lines.get())
        printed += 1
