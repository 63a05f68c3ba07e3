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
from plotfeed.feeds.recording.show_file import show_file
from plotfeed.feeds.transport.mqtt.address import (
    DEFAULT_PORTS,
    AddressError,
    BrokerAddress,
    without_secrets,
)
from plotfeed.feeds.transport.mqtt.client import MqttLink

DEFAULT_FILTER = "plotfeed/#"
CONNECT_S = 5.0
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
    if "://" in source:
        place, topic_filter = _split(source)
        address = BrokerAddress.parse(place, **access)
        return asyncio.run(
            _show_broker(
                address,
                topic_filter,
                count,
                duration,
                partial(message_lines, as_json=as_json, categories=categories),
            )
        )
    return show_file(
        Path(source), listed=listed, count=count, as_json=as_json, categories=categories
    )


async def _show_broker(
    address: BrokerAddress,
    topic_filter: str,
    count: int | None,
    duration_s: float | None,
    lines_of: Callable[[str, bytes, str | None], Iterator[str]],
) -> int:
    lines: asyncio.Queue[str] = asyncio.Queue(MAX_WAITING_LINES)
    dropped = 0

    def heard(topic: str, payload: bytes, content_type: str | None) -> None:
        nonlocal dropped
        for line in lines_of(topic, payload, content_type):
            if lines.full():
                dropped += 1
            else:
                lines.put_nowait(line)

    link = MqttLink(address, "plotfeed-show", subscribe=[topic_filter], on_message=heard)
    running = asyncio.create_task(link.run(), name="link[show]")
    try:
        await link.wait_until_up(CONNECT_S)
        printing = asyncio.create_task(_print(lines, count), name="print")
        with stopped_by_signals(printing.cancel) as signals:
            await asyncio.wait({printing}, timeout=duration_s)
        printing.cancel()
        await asyncio.gather(printing, return_exceptions=True)
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
    if dropped:
        click.echo(f"plotfeed: {dropped} lines were not shown: the terminal is slower", err=True)
    return INTERRUPTED if signal.SIGINT in signals else 0


async def _print(lines: asyncio.Queue[str], count: int | None) -> None:
    printed = 0
    while count is None or printed < count:
        click.echo(await lines.get())
        printed += 1


def _split(url: str) -> tuple[str, str]:
    """Address and topic filter of mqtt://HOST:PORT/FILTER, where the filter may hold # and +."""
    scheme, _, rest = url.partition("://")
    place, _, topic_filter = rest.partition("/")
    if scheme not in DEFAULT_PORTS:
        shown = without_secrets(url)
        raise AddressError(f"{shown!r}: expected a file or mqtt://HOST:PORT/TOPIC-FILTER")
    return f"{scheme}://{place}", topic_filter or DEFAULT_FILTER
