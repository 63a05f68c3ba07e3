"""What happens to the connections of many sensors at once, in few lines."""

from __future__ import annotations

import asyncio
import logging

log = logging.getLogger(__name__)

GATHER_S = 1.0  # Who has the same to tell within this time is one of a number


class SapientNews:
    """Tells of the first sensor to which something happens at once, and then how many more."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._more: dict[str, int] = {}  # By what was told a moment ago

    def tell(self, name: str, what: str, level: int = logging.WARNING) -> None:
        """Say of that connection what happened to it, unless others have just said the same."""
        if what in self._more:
            self._more[what] += 1
            return
        log.log(level, "%s: %s", name, what)
        self._more[what] = 0
        self._loop.call_later(GATHER_S, self._tell_more, what, level)

    def _tell_more(self, what: str, level: int) -> None:
        more = self._more.pop(what)
        if more:
            log.log(level, "sapient: %s, and so %d more sensors", what, more)
