"""A progress bar on a terminal, for what takes more than a second."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from rich.progress import Progress

PATIENCE_S = 1.0
BETWEEN_S = 0.1
LOOK_EVERY = 256

T = TypeVar("T")


def with_progress(
    things: Iterable[T], what: str, done: Callable[[], int], all_: int
) -> Iterator[T]:
    """The same things; a bar meanwhile says how much of `all_` is done, if anybody can see it."""
    if not sys.stderr.isatty():
        yield from things
        return
    bar: Progress | None = None
    next_s = time.monotonic() + PATIENCE_S
    try:
        for n, thing in enumerate(things):
            yield thing
            if n % LOOK_EVERY or time.monotonic() < next_s:
                continue
            next_s = time.monotonic() + BETWEEN_S
            bar = bar or _bar(what, all_)
            bar.update(bar.task_ids[0], completed=min(done(), all_))
    finally:
        if bar is not None:
            bar.stop()


def _bar(what: str, all_: int) -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TimeRemainingColumn

    columns = ("{task.description}", BarColumn(), DownloadColumn(), TimeRemainingColumn())
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    bar.add_task(what, total=all_)
    bar.start()
    return bar
