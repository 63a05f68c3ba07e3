"""When a sensor's scans begin: at whole multiples of its period, or about then."""

from __future__ import annotations

from functools import lru_cache

from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.scan import Sector, next_sector, sector_at, sector_within

MOST_SIGMAS = 4.0


class Timetable:
    """Scans and their sectors; with jitter, a scan begins `jitter_ns` of sigma off its time.

    The beginnings are drawn for each scan by itself, clipped at four sigmas: they do not add up.
    """

    def __init__(
        self, period_ns: int, sectors: int, jitter_ns: float = 0.0, chance: Chance | None = None
    ) -> None:
        """`chance` is needed for jitter alone, of at most a fiftieth of the period."""
        self.period_ns = period_ns
        self.sectors = sectors
        self._jitter_ns = jitter_ns
        self._chance = chance if jitter_ns else None
        self._start_ns = lru_cache(maxsize=8)(self._drawn_start_ns)

    def sector_at(self, t_utc_ns: int) -> Sector:
        """The sector under way at a time."""
        if self._chance is None:
            return sector_at(t_utc_ns, self.period_ns, self.sectors)
        scan = t_utc_ns // self.period_ns
        scan += (self._start_ns(scan + 1) <= t_utc_ns) - (self._start_ns(scan) > t_utc_ns)
        start_ns, end_ns = self._start_ns(scan), self._start_ns(scan + 1)
        index = (t_utc_ns - start_ns) * self.sectors // (end_ns - start_ns)
        return sector_within(start_ns, end_ns, scan, index, self.sectors)

    def next_sector(self, sector: Sector) -> Sector:
        """The one after it."""
        if self._chance is None:
            return next_sector(sector, self.period_ns, self.sectors)
        carry, index = divmod(sector.index + 1, self.sectors)
        scan = sector.scan + carry
        return sector_within(
            self._start_ns(scan), self._start_ns(scan + 1), scan, index, self.sectors
        )

    def turn(self, scan: int) -> Sector:
        """A whole scan of a rotating sensor, as if it were one sector."""
        start_ns, end_ns = self._start_ns(scan), self._start_ns(scan + 1)
        return Sector(scan, 0, start_ns, end_ns, 0.0, 360.0)

    def _drawn_start_ns(self, scan: int) -> int:
        if self._chance is None:
            return scan * self.period_ns
        off = float(self._chance.rng(Purpose.SCAN_TIMES, scan).standard_normal())
        off = min(max(off, -MOST_SIGMAS), MOST_SIGMAS)
        return scan * self.period_ns + round(off * self._jitter_ns)
