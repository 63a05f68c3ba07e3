"""When a sensor looks where: scans, their sectors, and what it covers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np

from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.detection import cells_between, draw_count, whole_cells
from plotfeed.models.frames import Axes, are_all_within, rows_about, wrap_180, wrap_360
from plotfeed.models.state import NS, Bools, Columns, Floats, Ints, TruthState, trimmed
from plotfeed.models.truth import Trajectories

MOST_SIGMAS = 4.0  # Bound of the jitter of a scan
WHOLE_NUMBERS = ("scan", "index", "start_ns", "end_ns")
# Twice as long as any stretch of time whose sectors are worked out at once, half an hour.
SPAN_NS = 1 << 42


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


@dataclass(frozen=True, kw_only=True)
class Sectors(Columns):
    """Several sectors, columns (m,): by sensor, an index, and then in the order of time."""

    sensor: Ints
    scan: Ints
    index: Ints
    start_ns: Ints
    end_ns: Ints
    start_deg: Floats
    end_deg: Floats
    stares: Bools

    def __len__(self) -> int:
        """How many there are."""
        return len(self.sensor)

    @classmethod
    def of(cls, sectors: Sequence[Sector], sensor: int = 0) -> Self:
        """Columns of sectors of one sensor."""
        return cls(
            sensor=np.full(len(sectors), sensor, np.int64),
            **{n: np.array([getattr(s, n) for s in sectors], np.int64) for n in WHOLE_NUMBERS},
            start_deg=np.array([s.start_deg for s in sectors], np.float64),
            end_deg=np.array([s.end_deg for s in sectors], np.float64),
            stares=np.array([s.stares for s in sectors], np.bool_),
        )

    def one(self, i: int) -> Sector:
        """The i-th by itself."""
        columns = {name: column[i].item() for name, column in vars(self).items()}
        del columns["sensor"]
        return Sector(**columns)

    def first_of_sensors(self) -> Bools:
        """Which are the first of their sensors; (m,)."""
        first = np.ones(len(self.sensor), np.bool_)
        np.not_equal(self.sensor[1:], self.sensor[:-1], out=first[1:])
        return first

    def places(self, sensor: Ints, t_utc_ns: Ints) -> Ints:
        """Numbers that order rows by sensor and then by time; (n,) each."""
        places: Ints = sensor * SPAN_NS + (t_utc_ns - self.start_ns[0])
        return places

    def offsets(self, places: Ints) -> Ints:
        """Where the rows of each sector begin among rows in the order of `places`; (m + 1,).

        Times are within the sectors, at a sensor that stares also their ends.
        """
        ends = self.places(self.sensor, self.end_ns) + self.stares
        return np.concatenate([np.zeros(1, np.int64), np.searchsorted(places, ends)])


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

    @property
    def jitters(self) -> bool:
        """Whether scans begin off their times."""
        return self._chance is not None

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


class Timetables:
    """The sectors that are next, of several sensors by their index."""

    def __init__(self, timetables: Sequence[Timetable]) -> None:
        self._timetables = timetables
        self.period_ns = np.array([each.period_ns for each in timetables], np.int64)
        self.sectors = np.array([each.sectors for each in timetables], np.int64)
        self._jitters = [i for i, each in enumerate(timetables) if each.jitters]
        n = len(timetables)
        self._scan, self._index = np.zeros(n, np.int64), np.zeros(n, np.int64)
        # Of the scans under way.
        self._start_ns, self._end_ns = np.zeros(n, np.int64), self.period_ns.copy()

    def start(self, t_utc_ns: int) -> None:
        """Let the first whole sector of each after that time be its next."""
        for sensor, timetable in enumerate(self._timetables):
            sector = timetable.sector_at(t_utc_ns)
            if sector.start_ns < t_utc_ns:
                sector = timetable.next_sector(sector)
            self.go_on_with(sensor, sector)

    def go_on_with(self, sensor: int, sector: Sector) -> None:
        """Let that sector be a sensor's next."""
        turn = self._timetables[sensor].turn(sector.scan)
        self._scan[sensor], self._index[sensor] = sector.scan, sector.index
        self._start_ns[sensor], self._end_ns[sensor] = turn.start_ns, turn.end_ns

    @property
    def next_end_ns(self) -> Ints:
        """When the next sector of each sensor ends; (n,)."""
        duration_ns = self._end_ns - self._start_ns
        into_ns: Ints = np.floor_divide(-(self._index + 1) * duration_ns, self.sectors)
        return self._start_ns - into_ns

    @property
    def begins_scan(self) -> Bools:
        """Whether the next sector of each sensor is the first of a scan; (n,)."""
        begins: Bools = self._index == 0
        return begins

    def sector(self, sensor: int) -> Sector:
        """The next one of a sensor."""
        timetable = self._timetables[sensor]
        return timetable.sector(int(self._scan[sensor]), int(self._index[sensor]))

    def ending_before(self, t_utc_ns: int) -> Sectors:
        """All sectors that are next and end before that time; they remain next."""
        sensor = np.flatnonzero(self.next_end_ns < t_utc_ns)
        scan, index = self._scan[sensor], self._index[sensor]
        start_ns, end_ns = self._start_ns[sensor], self._end_ns[sensor]
        turns = []
        while len(sensor):
            sectors, duration_ns = self.sectors[sensor], end_ns - start_ns
            into_ns = np.minimum(t_utc_ns - start_ns, duration_ns + 1)
            last = np.maximum((into_ns - 1) * sectors // duration_ns, index)
            # Sectors from the next one up to the last of a scan of each sensor.
            number: Ints = index
            counts, which = last - index, np.arange(len(sensor))
            if not (counts == 1).all():
                which = np.repeat(which, counts)
                number = np.arange(len(which)) - (np.cumsum(counts) - counts - index)[which]
            first_ns: Ints = start_ns[which]
            lasts_ns, n = duration_ns[which], sectors[which]
            turns.append(
                Sectors(
                    sensor=sensor[which],
                    scan=scan[which],
                    index=number,
                    start_ns=first_ns - np.floor_divide(-number * lasts_ns, n),
                    end_ns=first_ns - np.floor_divide(-(number + 1) * lasts_ns, n),
                    start_deg=360.0 * number / n,
                    end_deg=360.0 * (number + 1) / n,
                    stares=n == 1,
                )
            )
            over = np.flatnonzero(last == sectors)
            sensor, scan, start_ns = sensor[over], scan[over] + 1, end_ns[over]
            index = np.zeros(len(over), np.int64)
            end_ns = self._starts_ns(sensor, scan + 1)
        if not turns:
            return Sectors.of([])
        found = Sectors.joined(turns)
        return found if len(turns) == 1 else found.rows(np.lexsort((found.end_ns, found.sensor)))

    def take(self, sectors: Sectors) -> None:
        """Go on past those sectors, which were next."""
        if not len(sectors):
            return
        last = np.append(np.flatnonzero(sectors.first_of_sensors()[1:]), len(sectors) - 1)
        sensor, scan, index = sectors.sensor[last], sectors.scan[last], sectors.index[last] + 1
        over = index == self.sectors[sensor]
        scan, index = scan + over, np.where(over, 0, index)
        self._index[sensor] = index
        new = np.flatnonzero(scan != self._scan[sensor])
        if len(new):
            sensor, scan = sensor[new], scan[new]
            self._scan[sensor] = scan
            self._start_ns[sensor] = self._starts_ns(sensor, scan)
            self._end_ns[sensor] = self._starts_ns(sensor, scan + 1)

    def _starts_ns(self, sensor: Ints, scan: Ints) -> Ints:
        starts_ns = scan * self.period_ns[sensor]
        for jitters in self._jitters:
            for row in np.flatnonzero(sensor == jitters).tolist():
                starts_ns[row] = self._timetables[jitters].turn(int(scan[row])).start_ns
        return starts_ns


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


# Which drones the beams of rotating sensors meet in their sectors, and exactly when.
ON_BEAM_DEG = 1e-7  # How near a look's instant brings beam and target
# A target that never comes as near as this leapt over the beam: it flew over the sensor.
LEAP_DEG = 5.0
MAX_STEPS = 50
# Drones, of which those out of reach are left out before anything is computed of them.
CULLED_FROM = 32
FASTEST_M_S = 1000.0  # Speed that no drone exceeds between one border and the next
NEVER_NS = np.iinfo(np.int64).min
NOBODY = TruthState(
    drone=np.zeros(0, np.int64),
    t_utc_ns=np.zeros(0, np.int64),
    position_ecef_m=np.zeros((0, 3)),
    velocity_ecef_m_s=np.zeros((0, 3)),
)


class Borders:
    """Where every drone was taken to be when the last sector of each sensor ended.

    The sector after it takes that over, whatever telemetry says since: else a drone could be on
    either side of the border in both.
    """

    def __init__(self, sensors: int) -> None:
        self.t_utc_ns = np.full(sensors, NEVER_NS, np.int64)
        # NaN where that is not known; (sensors, drones).
        self.azimuth_deg = np.full((sensors, 0), np.nan)

    def make_room(self, drones: int) -> None:
        """Have columns for at least so many drones."""
        more = drones - self.azimuth_deg.shape[1]
        if more > 0:
            room = np.full((len(self.t_utc_ns), max(more, drones - more)), np.nan)
            self.azimuth_deg = np.concatenate([self.azimuth_deg, room], axis=1)

    def forget(self, drones: Ints, n: int) -> None:
        """Take those drones for others; there are n, and no room is kept for many more."""
        known = drones[drones < self.azimuth_deg.shape[1]]
        self.azimuth_deg[:, known] = np.nan
        self.azimuth_deg = trimmed(self.azimuth_deg.T, n).T

    def take(self, sectors: Sectors, drones: Ints, azimuth_deg: Floats) -> None:
        """Note where drones are when the last sectors of sensors end, (m, drones); others nowhere.

        `drones` are in order.
        """
        sensor, n = sectors.sensor, len(drones)
        self.t_utc_ns[sensor] = sectors.end_ns
        if n and drones[-1] == n - 1:  # the first n, which is quicker
            self.azimuth_deg[sensor, :n] = azimuth_deg
            self.azimuth_deg[sensor, n:] = np.nan
            return
        self.azimuth_deg[sensor] = np.nan
        self.azimuth_deg[sensor[:, None], drones] = azimuth_deg


def meetings(
    sectors: Sectors,
    frames: Axes,
    trajectories: Trajectories,
    borders: Borders | None = None,
    reach_m: float | Floats = np.inf,
) -> tuple[TruthState, Ints]:
    """Whom beams meet, by sensor and then in the order of time, and each one's sector, by its row.

    `frames` are those of the sensors, by index, or the one of all. The first of each sensor begins
    where `borders` has it, and they are told where the last one ends. Drones that stay further away
    than `reach_m`, of each sensor or of all, may be left out.
    """
    first = sectors.first_of_sensors()
    borders = borders or Borders(int(sectors.sensor[-1]) + 1)
    about, start_deg, end_deg = _edges(
        sectors, first, frames, trajectories, borders, np.asarray(reach_m)
    )
    if first.all():
        borders.take(sectors, about, end_deg)
    else:
        last = np.append(first[1:], True)
        borders.take(sectors.rows(last), about, end_deg[last])
    passed, share = passes_between(
        ahead_of_beam_deg(start_deg, sectors.start_deg[:, None]),
        ahead_of_beam_deg(end_deg, (sectors.end_deg % 360.0)[:, None]),
    )
    row, of_about = np.nonzero(passed)
    if not len(row):
        return NOBODY, row
    drones = about[of_about]
    of_each = sectors.rows(row)
    frame_of_each = frames.rows(of_each.sensor)

    def azimuth_at(share: Floats) -> Floats:
        t_utc_ns = time_after_share_ns(of_each.start_ns, of_each.end_ns, share)
        return frame_of_each.azimuths_deg(trajectories.position_at(t_utc_ns, drones))

    met_share = beam_meets(of_each, share[passed], azimuth_at)
    met = ~np.isnan(met_share)
    if not met.all():
        of_each, met_share, row, drones = of_each.rows(met), met_share[met], row[met], drones[met]
    t_utc_ns = time_after_share_ns(of_each.start_ns, of_each.end_ns, met_share)
    order = np.lexsort((t_utc_ns, of_each.sensor))
    return trajectories.state_at(t_utc_ns[order], drones[order]), row[order]


def _edges(  # noqa: PLR0917
    sectors: Sectors,
    first: Bools,
    frames: Axes,
    trajectories: Trajectories,
    borders: Borders,
    reach_m: Floats,
) -> tuple[Ints, Floats, Floats]:
    """Drones that are near any end of a sector, and their azimuths at beginnings and ends.

    Each (m, drones). Nobody is passed who is near none of them, so that what is worked out does not
    grow with drones that are elsewhere.
    """
    positions_ecef_m, at_end = _positions_at(sectors.end_ns, trajectories)
    everybody, sensor = positions_ecef_m.shape[1], sectors.sensor
    about = np.arange(everybody)
    of_all = frames.rows(sensor[:, None])
    near = None
    if everybody >= CULLED_FROM:
        between_s = (sectors.end_ns - sectors.start_ns) / NS
        within_m = (reach_m[sensor] if reach_m.ndim else reach_m) + FASTEST_M_S * between_s
        about = rows_about(of_all, positions_ecef_m, within_m)
        positions_ecef_m = positions_ecef_m[:, about]
        if not are_all_within(of_all, positions_ecef_m, within_m):
            near = of_all.has_within(positions_ecef_m[at_end], within_m[:, None])
    if near is None or 2 * np.count_nonzero(near) > near.size:
        end_deg = of_all.azimuths_deg(positions_ecef_m[at_end])
        if near is not None:
            end_deg[~near] = np.nan
    else:
        row, column = np.nonzero(near)
        end_deg = np.full(near.shape, np.nan)
        end_deg[row, column] = frames.rows(sensor[row]).azimuths_deg(
            positions_ecef_m[at_end[row], column]
        )
    borders.make_room(everybody)
    starts_ns, of_first = sectors.start_ns[first], sensor[first]
    taken = borders.azimuth_deg[of_first][:, about]
    taken[borders.t_utc_ns[of_first] != starts_ns] = np.nan
    unknown = np.isnan(taken)
    if unknown.any():
        row, column = np.nonzero(unknown & ~np.isnan(end_deg[first]))
        if len(row):
            positions_ecef_m, at_start = _positions_at(starts_ns, trajectories)
            taken[row, column] = frames.rows(of_first[row]).azimuths_deg(
                positions_ecef_m[at_start[row], about[column]]
            )
    if len(sectors) == 1:
        return about, taken, end_deg
    start_deg = np.empty_like(end_deg)
    start_deg[1:] = end_deg[:-1]
    start_deg[first] = taken
    return about, start_deg, end_deg


def _positions_at(t_utc_ns: Ints, trajectories: Trajectories) -> tuple[Floats, Ints]:
    """ECEF positions of all drones at different times, (k, drones, 3), and which is each, (m,)."""
    if len(t_utc_ns) == 1 or (t_utc_ns == t_utc_ns[0]).all():
        return trajectories.positions_at(t_utc_ns[:1]), np.zeros(len(t_utc_ns), np.int64)
    different_ns, which = np.unique(t_utc_ns, return_inverse=True)
    return trajectories.positions_at(different_ns), which


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


def draw_azimuths(
    cells: float, pfa: float, cover: AzimuthCover, sector: Sector, rng: np.random.Generator
) -> Floats:
    """Azimuths of the false alarms of a sector, degrees, uniform over what it has of the cover.

    Over a scan their mean number is cells times Pfa exactly.
    """
    whole, pfa_each = whole_cells(cells, pfa)
    found = []
    for start, end in cover.shares_in(sector):
        if n := draw_count(cells_between(whole, start, end), pfa_each, rng):
            found.append(rng.uniform(start, end, n))  # eqs 10, 11
    if not found:
        return np.zeros(0)
    return wrap_360(cover.min_deg + np.concatenate(found) * cover.span_deg)
