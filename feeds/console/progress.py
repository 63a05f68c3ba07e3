"""A progress bar on a terminal, for what takes more than a second."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import click

PATIENCE_S = 1.0
BETWEEN_S = 0.1
LOOK_EVERY = 256
GONE = "\r\033[K\033[?25h"
"""Takes the bar away and shows the cursor again."""

T = TypeVar("T")


def with_progress(
    things: Iterable[T], what: str, done: Callable[[], int], all_: int
) -> Iterator[T]:
    """Give all things on; a bar says meanwhile how much of `all_` is done, if anybody can see."""
    if not sys.stderr.isatty():
        yield from things
        return
    bar = click.progressbar(length=all_, label=what, file=sys.stderr)
    is_shown, next_s = False, time.monotonic() + PATIENCE_S
    try:
        for n, thing in enumerate(things):
            yield thing
            if n % LOOK_EVERY or time.monotonic() < next_s:
                continue
            is_shown, next_s = True, time.monotonic() + BETWEEN_S
            bar.update(min(done(), all_) - bar.pos)
    finally:
        if is_shown:
            click.echo(GONE, file=sys.stderr, nl=False)
