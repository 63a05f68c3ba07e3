"""What commands print: columns, JSON of any numbers, text of others, a line of status, a bar."""

from __future__ import annotations

import logging
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import click

Row = Sequence[str]
MAX_DAMAGES_TOLD = 5
STANDARD_OUTPUT = "standard output"


def widths(rows: Sequence[Row]) -> list[int]:
    """Characters of the widest cell of each column."""
    return [max(map(len, column)) for column in zip(*rows, strict=True)]


def aligned(rows: Sequence[Row], sides: str) -> Iterator[str]:
    """Rows as lines, each column to its side: `<` or `>`; columns without a side run on."""
    wide = widths(rows)
    for row in rows:
        cells = (f"{cell:{side}{n}}" for cell, side, n in zip(row, sides, wide, strict=False))
        yield "  ".join([*cells, *row[len(sides) :]])


def finite(value: Any) -> Any:
    """A tree with null for numbers that JSON does not know."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def in_short(value: Any) -> Any:
    """A tree with its fractions to six digits, as people read them: 2e-05 for 2.0000000001e-05."""
    if isinstance(value, Mapping):
        return {key: in_short(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [in_short(item) for item in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def printable(text: str) -> str:
    """Text on one line in which what a terminal would obey is written out.

    That is line ends, escapes and other controls, marks that change the direction of writing, and
    halves of characters.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def bracketed(host: str) -> str:
    """A host as it stands before a colon and a port: IPv6 in brackets."""
    return f"[{host}]" if ":" in host else host


@contextmanager
def naming(what: str) -> Iterator[None]:
    """Let an `OSError` without the name of a file say what could not be written."""
    try:
        yield
    except OSError as error:
        if error.filename is None and not isinstance(error, BrokenPipeError):
            error.filename = what
        raise


def say(text: str, *, err: bool = False) -> None:
    """Print lines, whoever wrote what is in them: all that commands say goes through here."""
    with naming("standard error" if err else STANDARD_OUTPUT):
        click.echo("\n".join(map(printable, text.split("\n"))), err=err)


class PrintableFormatter(logging.Formatter):
    """Formats what is logged as `say` prints."""

    def format(self, record: logging.LogRecord) -> str:
        """Lines without anything that a terminal would obey."""
        return "\n".join(map(printable, super().format(record).split("\n")))


def say_damage(path: object, found: Sequence[object], *, all_in: str = "") -> None:
    """Print on standard error the first places where a file is damaged, and how many more are.

    `all_in` says where all of them are told.
    """
    for each in found[:MAX_DAMAGES_TOLD]:
        say(f"plotfeed: {path}: {each}", err=True)
    if len(found) > MAX_DAMAGES_TOLD:
        more = f"and {len(found) - MAX_DAMAGES_TOLD} more, the last at {found[-1]}"
        say(f"plotfeed: {path}: {more}{all_in}", err=True)


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
    import asyncio  # which --help does without

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
