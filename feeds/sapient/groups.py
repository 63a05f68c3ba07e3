"""Which detections leave together: a middleware wants stamps to be equal or 80 ms apart."""

from __future__ import annotations

from plotfeed.models.scan import Sector

MIN_GAP_NS = 80_000_000
ROUNDING_NS = 2000
"""By which rounding to nanoseconds and microseconds may shorten a gap."""


class Groups:
    """Runs of as many sectors as take 80 ms, counted from 1970.

    So a sector's group does not depend on when the session began, or on what was missed.
    """

    def __init__(self, period_ns: int, sectors: int) -> None:
        self._sectors = sectors
        self.size = -(-MIN_GAP_NS * sectors // period_ns)
        whole = self.size * period_ns % (1000 * sectors) == 0
        if not whole and self.size * period_ns < (MIN_GAP_NS + ROUNDING_NS) * sectors:
            self.size += 1
        self.longest_ns = -(-self.size * period_ns // sectors)

    def number(self, sector: Sector) -> int:
        """The group that a sector is in."""
        return self._count(sector) // self.size

    def ends_with(self, sector: Sector) -> bool:
        """Whether it is the last of its group."""
        return (self._count(sector) + 1) % self.size == 0

    def _count(self, sector: Sector) -> int:
        return sector.scan * self._sectors + sector.index
