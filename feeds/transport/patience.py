"""How long ways out wait: before they try again, and at the end for what has not left yet."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

BACKOFF_S = (0.25, 0.5, 1.0, 2.0, 4.0)  # After the first failure, and the next ones in a row
LOOK_EVERY_S = 0.001


def backoff_s(failures: int) -> float:
    """How long to wait after a failure that so many others in a row came before."""
    return BACKOFF_S[min(failures, len(BACKOFF_S) - 1)]


async def wait_while(waits: Callable[[], object], timeout_s: float) -> None:
    """Return once nothing waits, or the time is up."""
    loop = asyncio.get_running_loop()
    deadline_s = loop.time() + timeout_s
    while waits() and loop.time() <= deadline_s:  # noqa: ASYNC110 - of any condition
        await asyncio.sleep(LOOK_EVERY_S)
