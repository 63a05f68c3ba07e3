"""One line that tells how far something is: over itself in a terminal, now and then in a log."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable

import click

TERMINAL_EVERY_S = 0.5
LOG_EVERY_S = 10.0


def interval_s() -> float:
    """Seconds from one status line to the next."""
    return TERMINAL_EVERY_S if sys.stdout.isatty() else LOG_EVERY_S


async def show_status(text: Callable[[], str], *, quiet: bool = False) -> None:
    """Write what `text` gives, again and again, until cancelled; with `quiet` nothing at all."""
    start, end = ("\r\033[K", "") if sys.stdout.isatty() else ("", "\n")
    while not quiet:
        await asyncio.sleep(interval_s())
        sys.stdout.write(f"{start}{text()}{end}")
        sys.stdout.flush()


def show_last_status(text: str) -> None:
    """Write the status at the end, over the last one in a terminal, so that it stays."""
    click.echo(f"\r\033[K{text}" if sys.stdout.isatty() else text)


def printable(text: str) -> str:
    """Text that others sent, so that it does not move the cursor of a terminal."""
    return text if text.isprintable() else ascii(text)
