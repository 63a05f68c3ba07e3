"""What a reader could not read, kept within bounds."""

from __future__ import annotations

from plotfeed.replay.recorded import Damage

MAX_DAMAGES = 1000


class Damages(list[Damage]):
    """The first ones, each place once, and one entry more that says that there are others."""

    def __init__(self) -> None:
        super().__init__()
        self._offsets: set[int] = set()

    def add(self, offset: int, what: str) -> None:
        """Note what is wrong with the octets from `offset` on, unless something was already."""
        if offset in self._offsets or len(self) > MAX_DAMAGES:
            return
        self._offsets.add(offset)
        what = what if len(self) < MAX_DAMAGES else "from here on, more that is not listed"
        self.append(Damage(offset=offset, what=what))
