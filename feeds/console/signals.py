"""The process: SIGINT and SIGTERM as a request to end, and how it keeps house with its memory."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import gc
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


GARBAGE_AT = 50_000
"""Objects more than before at which the garbage collector looks at the youngest."""
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Of mallopt(3)."""
KEPT_OCTETS, OF_ITS_OWN_OCTETS = 128 << 20, 32 << 20


def collect_seldom() -> None:
    """Let the garbage collector leave alone what stays, and look less often at what goes.

    Sectors leave no cycles behind; each look at hundreds of sensors holds everything up.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(GARBAGE_AT, 10, 10)


def keep_freed() -> None:
    """Let the C library keep freed memory for the next array, where that is glibc.

    By default it hands back whatever lies free at the end of the heap: columns of ten thousand
    targets then cost more in page faults than in arithmetic.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library
        return
    mallopt(M_TRIM_THRESHOLD, KEPT_OCTETS)
    mallopt(M_MMAP_THRESHOLD, OF_ITS_OWN_OCTETS)
