"""What commands print: columns of text, JSON of any numbers, text that others sent."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

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
