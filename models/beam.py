"""When a sensor looks where: scans, sectors and cover, and which drones a rotating beam meets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np

from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import LocalFrame, wrap_180, wrap_360
from plotfeed.models.state import NS, Bools, Floats, Ints, TruthState, rows_where
from plotfeed.models.truth import Trajectories

MOST_SIGMAS = 4.0
"""Bound of the jitter of a scan."""
ON_BEAM_DEG = 1e-7
"""How near a look's instant brings beam and target."""
LEAP_DEG = 5.0
"""A target that never comes as near as this leapt over the beam: it flew over the sensor."""
MAX_STEPS = 50
CULLED_FROM = 32
"""Drones, of which those out of reach are left out before anything is computed of them."""
FASTEST_M_S = 1000.0
"""Speed that no drone exceeds between one border and the next."""


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
    """Clockwise from one azimuth to another, degrees from true north; at most the full circle.

    Of sensors with covers of their own, columns: an azimuth is held against that of its row.
    """

    min_deg: float
    max_deg: float

    @property
    def span_deg(self) -> float:
        """Width of the cover, degrees."""
        span_deg = self.max_deg - self.min_deg
        return min(span_deg, 360.0) if isinstance(span_deg, float) else np.minimum(span_deg, 360.0)

    def holds(self, azimuth_deg: Floats) -> Bools:
        """Whether azimuths lie within; an undefined one does not."""
        if isinstance(self.span_deg, float) and self.span_deg == 360.0:
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


@dataclass(frozen=True, slots=True)
class Sectors:
    """Several sectors, of one sensor or of many, columns (m,), wherever one could stand.

    `sensor` is an index into the scene's sensors; the other columns are those of `Sector`.
    """

    sensor: Ints
    scan: Ints
    index: Ints
    start_ns: Ints
    end_ns: Ints
    start_deg: Floats
    end_deg: Floats
    stares: Bools

    @classmethod
    def of(cls, sectors: Sequence[Sector], sensor: int = 0) -> Self:
        """Columns of those sectors, all of one sensor."""
        return cls(
            sensor=np.full(len(sectors), sensor, np.int64),
            scan=np.array([s.scan for s in sectors], np.int64),
            index=np.array([s.index for s in sectors], np.int64),
            start_ns=np.array([s.start_ns for s in sectors], np.int64),
            end_ns=np.array([s.end_ns for s in sectors], np.int64),
            start_deg=np.array([s.start_deg for s in sectors], np.float64),
            end_deg=np.array([s.end_deg for s in sectors], np.float64),
            stares=np.array([s.stares for s in sectors], np.bool_),
        )

    def __len__(self) -> int:
        """How many there are."""
        return len(self.sensor)

    def rows(self, which: Ints | Bools) -> Sectors:
        """Sectors at those indices, which may recur; (m,)."""
        return Sectors(
            sensor=self.sensor[which],
            scan=self.scan[which],
            index=self.index[which],
            start_ns=self.start_ns[which],
            end_ns=self.end_ns[which],
            start_deg=self.start_deg[which],
            end_deg=self.end_deg[which],
            stares=self.stares[which],
        )

    def one(self, i: int) -> Sector:
        """The i-th by itself."""
        return Sector(
            scan=int(self.scan[i]),
            index=int(self.index[i]),
            start_ns=int(self.start_ns[i]),
            end_ns=int(self.end_ns[i]),
            start_deg=float(self.start_deg[i]),
            end_deg=float(self.end_deg[i]),
            stares=bool(self.stares[i]),
        )


@dataclass(frozen=True, slots=True)
class Border:
    """Where every drone was taken to be when a sector ended.

    The sector after it takes that over, whatever telemetry says since: else a drone could be on
    either side of the border in both.
    """

    t_utc_ns: int
    azimuth_deg: Floats


@dataclass(frozen=True, slots=True)
class Meetings:
    """What the beam meets in several sectors: drones in the order of time, and all borders."""

    truth: TruthState
    borders: Sequence[Border]
    """One at the end of each sector."""


def meetings(
    sectors: Sequence[Sector],
    frame: LocalFrame,
    trajectories: Trajectories,
    before: Border | None = None,
    reach_m: float = np.inf,
) -> Meetings:
    """Whom the beam meets in sectors that follow each other; the first begins with `before`.

    Drones that stay further away than `reach_m` may be left out.
    """
    edges_ns = np.array([sectors[0].start_ns, *(s.end_ns for s in sectors)], np.int64)
    positions_ecef_m = trajectories.positions_at(edges_ns)
    if positions_ecef_m.shape[1] < CULLED_FROM:
        azimuth_deg = frame.azimuths_deg(positions_ecef_m)
    else:
        between_s = float(np.diff(edges_ns).max()) / NS
        reached = frame.has_within(positions_ecef_m, reach_m + FASTEST_M_S * between_s)
        near = rows_where(np.any(reached, axis=0))
        azimuth_deg = np.full(positions_ecef_m.shape[:2], np.nan)
        azimuth_deg[:, near] = frame.azimuths_deg(positions_ecef_m[:, near])
    if before is not None and before.t_utc_ns == edges_ns[0]:
        taken = before.azimuth_deg
        known = azimuth_deg[0, : len(taken)]
        azimuth_deg[0, : len(taken)] = np.where(np.isnan(taken), known, taken)
    borders = [Border(s.end_ns, azimuth_deg[i + 1]) for i, s in enumerate(sectors)]
    borders_deg = np.array([sectors[0].start_deg, *(s.end_deg % 360.0 for s in sectors)])
    ahead_deg = ahead_of_beam_deg(azimuth_deg, borders_deg[:, None])
    passed, share = passes_between(ahead_deg[:-1], ahead_deg[1:])
    which, drones = np.nonzero(passed)
    if not len(drones):
        return Meetings(trajectories.state_at(sectors[0].end_ns, drones), borders)
    of_each = Sectors.of(sectors).rows(which)

    def azimuth_at(share: Floats) -> Floats:
        t_utc_ns = time_after_share_ns(of_each.start_ns, of_each.end_ns, share)
        return frame.azimuths_deg(trajectories.position_at(t_utc_ns, drones))

    met_share = beam_meets(of_each, share[passed], azimuth_at)
    met = ~np.isnan(met_share)
    of_met = of_each.rows(met)
    t_utc_ns = time_after_share_ns(of_met.start_ns, of_met.end_ns, met_share[met])
    state = trajectories.state_at(t_utc_ns, drones[met])
    return Meetings(state.rows(np.argsort(state.t_utc_ns, kind="stable")), borders)


def ahead_of_beam_deg(azimuth_deg: Floats, beam_deg: float | Floats) -> Floats:
    """Angle by which targets are ahead of a beam, in [-180, 180) degrees: negative behind it."""
    return wrap_180(azimuth_deg - beam_deg)


def passes_between(ahead_deg: Floats, still_ahead_deg: Floats) -> tuple[Bools, Floats]:
    """Which targets a clockwise beam passes within a sector, and after what share of it.

    A target is passed when it was ahead of the beam at the start and is behind it at the end. The
    two instants are shared with the neighbouring sectors, and so is the arithmetic to the last bit,
    so that nobody falls between two of them and nobody is seen in both. NaN, of azimuths at the
    zenith, is never passed.
    """
    passed = (ahead_deg >= 0) & (still_ahead_deg < 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = ahead_deg / (ahead_deg - still_ahead_deg)
    return passed, share


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
