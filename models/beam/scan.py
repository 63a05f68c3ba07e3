"""When a beam is where: scans, their sectors, and the instant at which it passes a target."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from plotfeed.models.frames import wrap_180, wrap_360
from plotfeed.models.state import Bools, Floats, Ints

ON_BEAM_DEG = 1e-7
"""As near as a look's instant brings beam and target."""
LEAP_DEG = 5.0
"""A target that never comes as near as this leapt over the beam: it flew over the sensor."""
MAX_STEPS = 50


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


@dataclass(frozen=True, slots=True)
class Sectors:
    """Several sectors, columns (m,), wherever one could stand."""

    start_ns: Ints
    end_ns: Ints
    start_deg: Floats
    end_deg: Floats

    @classmethod
    def of(cls, sectors: Sequence[Sector]) -> Self:
        """Those."""
        return cls(
            np.array([s.start_ns for s in sectors], np.int64),
            np.array([s.end_ns for s in sectors], np.int64),
            np.array([s.start_deg for s in sectors]),
            np.array([s.end_deg for s in sectors]),
        )

    def rows(self, which: Ints) -> Sectors:
        """Some of them, or one of them several times; (m,)."""
        return Sectors(
            self.start_ns[which], self.end_ns[which], self.start_deg[which], self.end_deg[which]
        )


def sector_at(t_utc_ns: int, period_ns: int, sectors: int) -> Sector:
    """The sector that is being scanned at a time; the first of a scan starts at true north."""
    scan, into_ns = divmod(t_utc_ns, period_ns)
    index = into_ns * sectors // period_ns
    return nth_sector(scan, index, period_ns, sectors)


def nth_sector(scan: int, index: int, period_ns: int, sectors: int) -> Sector:
    """Sector `index` of a scan; its edges are shared with its neighbours to the nanosecond."""
    return sector_within(scan * period_ns, (scan + 1) * period_ns, scan, index, sectors)


def sector_within(start_ns: int, end_ns: int, scan: int, index: int, sectors: int) -> Sector:
    """Sector `index` of a scan from one time to another."""
    duration_ns = end_ns - start_ns
    first_ns = start_ns - (-index * duration_ns // sectors)
    last_ns = start_ns - (-(index + 1) * duration_ns // sectors)
    start_deg, end_deg = 360.0 * index / sectors, 360.0 * (index + 1) / sectors  # 360 at the last
    return Sector(scan, index, first_ns, last_ns, start_deg, end_deg, stares=sectors == 1)


def next_sector(sector: Sector, period_ns: int, sectors: int) -> Sector:
    """The one that follows."""
    carry, index = divmod(sector.index + 1, sectors)
    return nth_sector(sector.scan + carry, index, period_ns, sectors)


def beam_passes(
    sector: Sector, azimuth_at_start_deg: Floats, azimuth_at_end_deg: Floats
) -> tuple[Bools, Floats]:
    """Which targets a clockwise beam passes within a sector, and after what share of it.

    A target is passed when it was ahead of the beam at the start and is behind it at the end. The
    two instants are shared with the neighbouring sectors, and so is the arithmetic to the last bit,
    so that nobody falls between two of them and nobody is seen in both. NaN azimuths, at the
    zenith, are never passed.
    """
    return passes_between(
        ahead_of_beam_deg(azimuth_at_start_deg, sector.start_deg),
        ahead_of_beam_deg(azimuth_at_end_deg, sector.end_deg % 360.0),
    )


def ahead_of_beam_deg(azimuth_deg: Floats, beam_deg: float | Floats) -> Floats:
    """By how much targets are ahead of a beam, in [-180, 180): negative behind it."""
    return wrap_180(azimuth_deg - beam_deg)


def passes_between(ahead_deg: Floats, still_ahead_deg: Floats) -> tuple[Bools, Floats]:
    """`beam_passes` by how far ahead of the beam targets are when it begins, and when it ends."""
    passed = (ahead_deg >= 0) & (still_ahead_deg < 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = ahead_deg / (ahead_deg - still_ahead_deg)
    return passed, share


def beam_times_ns(sector: Sector, azimuth_deg: Floats) -> Ints:
    """When a rotating beam is at those azimuths within its sector; the end of a staring scan."""
    if sector.stares:
        return np.full(len(azimuth_deg), sector.end_ns, np.int64)
    share = wrap_360(azimuth_deg - sector.start_deg) / (sector.end_deg - sector.start_deg)
    return time_after_share_ns(sector, share)


def time_after_share_ns(sector: Sector | Sectors, share: Floats) -> Ints:
    """The time after a share of a sector, kept within it."""
    into_ns = np.rint(share * (sector.end_ns - sector.start_ns)).astype(np.int64)
    return sector.start_ns + np.clip(into_ns, 0, sector.end_ns - sector.start_ns - 1)


def beam_meets(
    sector: Sector | Sectors, share: Floats, azimuth_at: Callable[[Floats], Floats]
) -> Floats:
    """The share of a sector after which the beam meets each target that it passes; (n,).

    By secants, halving where they lead out of what is left, from the first guess `share`;
    `azimuth_at` tells the targets' azimuths after shares. NaN where a target is gone, or leaps.
    """
    low, high = np.zeros(len(share)), np.ones(len(share))
    before, late_before = share, np.zeros(len(share))
    width_deg = sector.end_deg - sector.start_deg
    late = np.full(len(share), np.nan)
    for step in range(MAX_STEPS):
        late = beam_is_late_by(sector, share, azimuth_at(share))
        on_beam = np.abs(late) * width_deg <= ON_BEAM_DEG
        if on_beam.all():
            break
        low, high = np.where(late > 0, share, low), np.where(late < 0, share, high)
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = (late - late_before) / (share - before) if step else -1.0
            guess = share - late / slope
        good = (guess > low) & (guess < high) & (step % 4 < 3)
        following = np.where(on_beam, share, np.where(good, guess, (low + high) / 2))
        before, late_before, share = share, late, following
    return np.where(np.abs(late) * width_deg <= LEAP_DEG, share, np.nan)


def beam_is_late_by(sector: Sector | Sectors, share: Floats, azimuth_deg: Floats) -> Floats:
    """The share of a sector by which the beam has yet to turn to reach those azimuths."""
    width_deg = sector.end_deg - sector.start_deg
    return wrap_180(azimuth_deg - (sector.start_deg + share * width_deg)) / width_deg
