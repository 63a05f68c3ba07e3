"""When and where a sensor looks: scans, their sectors, and cover."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import wrap_360
from plotfeed.models.state import Bools, Floats, Ints

MOST_SIGMAS = 4.0


@dataclass(frozen=True, slots=True)
class Sector:
    """A stretch of a scan that is reported at once: a sector, or the whole scan of a staring one.

    The scan's number is floor(time / period), so it does not depend on when anything started.
    """

    scan: int
    index: int
    start_ns: int
    end_ns: int
    start_deg: float
    end_deg: float
    stares: bool = False
    """Whether everything is looked at once, when it ends."""


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

    def sector(self, scan: int, index: int) -> Sector:
        """Sector `index` of a scan; its edges are shared with its neighbours to the nanosecond.

        The first sector of a scan starts at true north.
        """
        start_ns = self._start_ns(scan)
        duration_ns, n = self._start_ns(scan + 1) - start_ns, self.sectors
        first_ns = start_ns - (-index * duration_ns // n)
        last_ns = start_ns - (-(index + 1) * duration_ns // n)
        start_deg, end_deg = 360.0 * index / n, 360.0 * (index + 1) / n  # 360 at the last
        return Sector(scan, index, first_ns, last_ns, start_deg, end_deg, stares=n == 1)

    def sector_at(self, t_utc_ns: int) -> Sector:
        """The sector under way at a time."""
        scan = t_utc_ns // self.period_ns
        scan += (self._start_ns(scan + 1) <= t_utc_ns) - (self._start_ns(scan) > t_utc_ns)
        start_ns, end_ns = self._start_ns(scan), self._start_ns(scan + 1)
        return self.sector(scan, (t_utc_ns - start_ns) * self.sectors // (end_ns - start_ns))

    def next_sector(self, sector: Sector) -> Sector:
        """The one after it."""
        carry, index = divmod(sector.index + 1, self.sectors)
        return self.sector(sector.scan + carry, index)

    def turn(self, scan: int) -> Sector:
        """A whole scan of a rotating sensor, as if it were one sector."""
        return Sector(scan, 0, self._start_ns(scan), self._start_ns(scan + 1), 0.0, 360.0)

    def _drawn_start_ns(self, scan: int) -> int:
        if self._chance is None:
            return scan * self.period_ns
        off = float(self._chance.rng(Purpose.SCAN_TIMES, scan).standard_normal())
        off = min(max(off, -MOST_SIGMAS), MOST_SIGMAS)
        return scan * self.period_ns + round(off * self._jitter_ns)


def beam_times_ns(sector: Sector, azimuth_deg: Floats) -> Ints:
    """When a rotating beam is at those azimuths within its sector; the end of a staring scan."""
    if sector.stares:
        return np.full(len(azimuth_deg), sector.end_ns, np.int64)
    share = wrap_360(azimuth_deg - sector.start_deg) / (sector.end_deg - sector.start_deg)
    return time_after_share_ns(sector.start_ns, sector.end_ns, share)


def time_after_share_ns(start_ns: Ints | int, end_ns: Ints | int, share: Floats) -> Ints:
    """The times after shares of stretches of time, kept within these; (n,)."""
    into_ns = np.rint(share * (end_ns - start_ns)).astype(np.int64)
    return start_ns + np.clip(into_ns, 0, end_ns - start_ns - 1)


@dataclass(frozen=True, slots=True)
class AzimuthCover:
    """Clockwise from one azimuth to another, degrees from true north; at most the full circle."""

    min_deg: float
    max_deg: float

    @property
    def span_deg(self) -> float:
        """Width of the cover, degrees."""
        return min(self.max_deg - self.min_deg, 360.0)

    def holds(self, azimuth_deg: Floats) -> Bools:
        """Whether azimuths lie within; an undefined one does not."""
        if self.span_deg == 360.0:
            return ~np.isnan(azimuth_deg)
        return wrap_360(azimuth_deg - self.min_deg) <= self.span_deg

    def shares_in(self, sector: Sector) -> list[tuple[float, float]]:
        """The pieces of the cover that lie in a sector, as shares of the cover: 0, 1 or 2."""
        if sector.stares:
            return [(0.0, 1.0)]
        start_deg = float(wrap_360(sector.start_deg - self.min_deg))
        end_deg = start_deg + sector.end_deg - sector.start_deg
        pieces = []
        for turn_deg in (0.0, 360.0):
            low_deg = max(start_deg - turn_deg, 0.0)
            high_deg = min(end_deg - turn_deg, self.span_deg)
            if low_deg < high_deg:
                pieces.append((low_deg / self.span_deg, high_deg / self.span_deg))
        return pieces


@dataclass(frozen=True, kw_only=True)
class Volume:
    """What a radar covers: from the blind range to the instrumented one, azimuths, elevations."""

    range_min_m: float
    range_max_m: float
    azimuth_cover: AzimuthCover
    elevation_min_deg: float
    elevation_max_deg: float

    def in_cover(self, range_m: Floats, azimuth_deg: Floats, elevation_deg: Floats) -> Bools:
        """Whether places lie within; one with an undefined angle does not."""
        return (
            (range_m >= self.range_min_m)
            & (range_m > 0)
            & (range_m <= self.range_max_m)
            & self.azimuth_cover.holds(azimuth_deg)
            & (elevation_deg >= self.elevation_min_deg)
            & (elevation_deg <= self.elevation_max_deg)
        )
