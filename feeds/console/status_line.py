"""How far something is: a line of status, over itself in a terminal; a bar of progress."""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import click

from plotfeed.feeds.console.printed import printable, say

TERMINAL_EVERY_S = 0.5
LOG_EVERY_S = 10.0
PATIENCE_S = 1.0  # A bar is shown only for what takes longer
BETWEEN_S = 0.1
LOOK_EVERY = 256
GONE = "\r\033[K\033[?25h"  # Takes the bar away and shows the cursor again

T = TypeVar("T")


def interval_s() -> float:
    """Seconds from one status line to the next."""
    return TERMINAL_EVERY_S if sys.stdout.isatty() else LOG_EVERY_S


async def show_status(text: Callable[[], str], *, quiet: bool = False) -> None:
    """Write what `text` gives, again and again, until cancelled; with `quiet` nothing at all."""
    start, end = ("\r\033[K", "") if sys.stdout.isatty() else ("", "\n")
    while not quiet:
        await asyncio.sleep(interval_s())
        sys.stdout.write(f"{start}{printable(text())}{end}")
        sys.stdout.flush()


def show_last_status(text: str) -> None:
    """Write the status at the end, over the last one in a terminal, so that it stays."""
    if sys.stdout.isatty():
        sys.stdout.write("\r\033[K")
    say(text)


def with_progress(
    things: Iterable[T],
    what: str,
    done: Callable[[], int],
    all_: int,
    *,
    look_every: int = LOOK_EVERY,
) -> Iterator[T]:
    """Give all things on; a bar says meanwhile how much of `all_` is done, if anybody can see.

    It is looked at after every so many things.
    """
    if not sys.stderr.isatty():
        yield from things
        return
    bar = click.progressbar(length=all_, label=what, file=sys.stderr)
    is_shown, next_s = False, time.monotonic() + PATIENCE_S
    try:
        for n, thing in enumerate(things):
            yield thing
            if n % look_every or time.monotonic() < next_s:
                continue
            is_shown, next_s = True, time.monotonic() + BETWEEN_S
            bar.update(min(done(), all_) - bar.pos)
    finally:
        if is_shown:
            sys.stderr.write(GONE)
