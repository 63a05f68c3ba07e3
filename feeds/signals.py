"""SIGINT and SIGTERM as a request to come to an end, inside a running loop."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Callable, Iterator

INTERRUPTED = 130
"""Exit code after SIGINT, as shells have it."""


@contextlib.contextmanager
def stopped_by_signals(stop: Callable[[], object]) -> Iterator[list[signal.Signals]]:
    """Call `stop` at each SIGINT or SIGTERM; gives the list of those that came."""
    came: list[signal.Signals] = []
    loop = asyncio.get_running_loop()

    def note(which: signal.Signals) -> None:
        came.append(which)
        stop()

    for which in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(which, note, which)
    try:
        yield came
    finally:
        for which in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(which)
