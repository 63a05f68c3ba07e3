"""What a reader could not read, kept within bounds."""

from __future__ import annotations

from plotfeed.replay.recorded import Damage

MAX_DAMAGES = 1000


class Damages(list[Damage]):
    """The first ones, and one entry more that says that there are others."""

    def add(self, offset: int, what: str) -> None:
        """Note what is wrong with the octets from `offset` on."""
        if len(self) < MAX_DAMAGES:
            self.append(Damage(offset=offset, what=what))
        elif len(self) == MAX_DAMAGES:
            self.append(Damage(offset=offset, what="from here on, more that is not listed"))
