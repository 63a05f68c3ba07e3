"""Metrics of tracks beside the truth: arrays in, figures out."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from operator import itemgetter
from typing import NamedTuple, Protocol, Self

import numpy as np

# SciPy takes three times as long to load as NumPy: functions that need it load it.
from numpy.typing import ArrayLike

from plotfeed.models.frames import axes_enu, ecef_to_geodetic, geodetic_to_ecef
from plotfeed.models.state import NS, Bools, Columns, Floats, Ints

GROUND, SPACE = 3, 4  # Columns of points by which a distance is over the ground, or in space


@dataclass(frozen=True, slots=True)
class Level:
    """The height at which all points are, metres above the ellipsoid: that of the flights."""

    height_m: float

    def points(self, latitude_deg: ArrayLike, longitude_deg: ArrayLike, height_m: Floats) -> Floats:
        """Points of places in degrees and metres above WGS-84; (..., 4)."""
        level = geodetic_to_ecef(latitude_deg, longitude_deg, self.height_m)
        return np.concatenate([level, np.asarray(height_m)[..., None]], axis=-1)


def rates(latitude_deg: Floats, longitude_deg: Floats, velocity_enu_m_s: Floats) -> Floats:
    """Velocities east, north and up (n, 3) as those of points; (n, 4).

    An unknown climb is none; NaN for a velocity over the ground that is not known.
    """
    east, north, _ = np.moveaxis(axes_enu(latitude_deg, longitude_deg), 2, 1)
    level = velocity_enu_m_s[:, :1] * east + velocity_enu_m_s[:, 1:2] * north
    climb = np.nan_to_num(velocity_enu_m_s[:, 2:])
    return np.concatenate([level, climb], axis=-1)


def along_enu(differences: Floats, latitude_deg: Floats, longitude_deg: Floats) -> Floats:
    """Differences of points (n, 4), or of their rates, as east, north, up at places; (n, 3)."""
    east, north, _ = np.moveaxis(axes_enu(latitude_deg, longitude_deg), 2, 1)
    level = differences[:, :3]
    return np.stack(
        [(level * east).sum(axis=1), (level * north).sum(axis=1), differences[:, 3]], axis=-1
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueStates:
    """Where drones were: points (..., 4), velocities east, north, up (..., 3); NaN if not there."""

    point: Floats
    velocity_enu_m_s: Floats
    latitude_deg: Floats
    longitude_deg: Floats


def true_states(ecef_m: Floats, velocity_ecef_m_s: Floats, level: Level) -> TrueStates:
    """True states of places and velocities in ECEF, (n, 3)."""
    latitude_deg, longitude_deg, height_m = ecef_to_geodetic(ecef_m)
    axes = axes_enu(latitude_deg, longitude_deg)
    return TrueStates(
        point=level.points(latitude_deg, longitude_deg, height_m),
        velocity_enu_m_s=np.einsum("axn,nx->na", axes, velocity_ecef_m_s),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
    )


# Places of a flight are kept at most so close to each other: closer ones say nothing more.
APART_NS = 20_000_000


@dataclass(frozen=True, slots=True)
class FlightPath:
    """One drone: times (n,), ascending, with its true places in ECEF, (n, 3), metres.

    Between places that are at most `gap_ns` apart it flies by the cubic of Hermite, with the
    velocity at each place that a parabola through it and its neighbours has. Elsewhere it is not
    there.
    """

    t_utc_ns: Ints
    position_ecef_m: Floats
    velocity_ecef_m_s: Floats
    gap_ns: int

    @classmethod
    def of(cls, t_utc_ns: Ints, position_ecef_m: Floats, gap_ns: int) -> Self:
        """Take places in any order, some perhaps told by several sensors."""
        order = np.argsort(t_utc_ns, kind="stable")
        t_ns, place_m = t_utc_ns[order], position_ecef_m[order]
        _, kept = np.unique(t_ns // APART_NS, return_index=True)
        t_ns, place_m = t_ns[kept], place_m[kept]
        return cls(t_ns, place_m, _velocities(t_ns, place_m, gap_ns), gap_ns)

    def rows(self, which: Bools) -> Self:
        """The places that are chosen, with the velocities that they have."""
        place_m, velocity_m_s = self.position_ecef_m[which], self.velocity_ecef_m_s[which]
        return type(self)(self.t_utc_ns[which], place_m, velocity_m_s, self.gap_ns)

    def states_at(self, t_utc_ns: Ints) -> tuple[Floats, Floats]:
        """Places and velocities in ECEF at times (m,), each (m, 3); NaN where it is not there."""
        last = len(self.t_utc_ns) - 1
        if last < 1:
            nowhere = np.full((len(t_utc_ns), 3), np.nan)
            return nowhere, nowhere
        i = np.clip(np.searchsorted(self.t_utc_ns, t_utc_ns, side="right") - 1, 0, last - 1)
        begin_ns, span_ns = self.t_utc_ns[i], self.t_utc_ns[i + 1] - self.t_utc_ns[i]
        since_ns = t_utc_ns - begin_ns
        there = (since_ns >= 0) & (since_ns <= span_ns) & (span_ns <= self.gap_ns)
        span_s = np.where(there, span_ns / NS, np.nan)[:, None]
        u = np.where(there, since_ns / span_ns, np.nan)[:, None]
        p, q = self.position_ecef_m[i], self.position_ecef_m[i + 1]
        v, w = self.velocity_ecef_m_s[i] * span_s, self.velocity_ecef_m_s[i + 1] * span_s
        way = q - p
        # Hermite's cubic, counted from the first place so that no digits of ECEF are lost.
        a, b = v + w - 2 * way, 3 * way - 2 * v - w
        return p + u * (v + u * (b + u * a)), (v + u * (2 * b + 3 * u * a)) / span_s


def _velocities(t_utc_ns: Ints, position_ecef_m: Floats, gap_ns: int) -> Floats:
    """Velocities at places; what lies beyond a gap has no part in them."""
    n = len(t_utc_ns)
    if n < 2:
        return np.zeros((n, 3))
    span_ns = np.diff(t_utc_ns)
    slopes = np.diff(position_ecef_m, axis=0) / (span_ns / NS)[:, None]
    near = span_ns <= gap_ns
    # That of the parabola weighs each side by the length of the other.
    before, after = np.zeros(n), np.zeros(n)
    before[1:] = np.where(near, 1.0, 0.0)
    after[:-1] = np.where(near, 1.0, 0.0)
    lengths = np.concatenate([span_ns[:1], span_ns, span_ns[-1:]]) / NS
    two = (before > 0) & (after > 0)
    weight_before = np.where(two, lengths[1:], before)
    weight_after = np.where(two, lengths[:-1], after)
    total = np.maximum(weight_before + weight_after, 1e-300)
    padded = np.concatenate([np.zeros((1, 3)), slopes, np.zeros((1, 3))])
    found: Floats = (
        weight_before[:, None] * padded[:-1] + weight_after[:, None] * padded[1:]
    ) / total[:, None]
    return found


def covered_at(looks_utc_ns: Ints, t_utc_ns: Ints, gap_ns: int) -> Bools:
    """Whether times (m,) lie between two looks, ascending, that are at most `gap_ns` apart."""
    if len(looks_utc_ns) < 2:
        return np.zeros(len(t_utc_ns), np.bool_)
    i = np.searchsorted(looks_utc_ns, t_utc_ns, side="right")
    inside = (i > 0) & (i < len(looks_utc_ns))
    i = np.clip(i, 1, len(looks_utc_ns) - 1)
    found: Bools = inside & (looks_utc_ns[i] - looks_utc_ns[i - 1] <= gap_ns)
    return found | np.isin(t_utc_ns, looks_utc_ns)


def stays_of(times: Ints, gap: int) -> list[tuple[int, int]]:
    """Stretches of ascending times, first and last, within which no gap is larger."""
    if not len(times):
        return []
    ends = np.flatnonzero(np.diff(times) > gap)
    firsts = times[np.concatenate([[0], ends + 1])]
    lasts = times[np.append(ends, len(times) - 1)]
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))


def stretches(flags: Bools) -> tuple[Ints, Ints]:
    """Where flags (n, k) begin to hold and where they do not any more, column by column; (m,)."""
    edges = np.diff(np.pad(flags.astype(np.int8), ((1, 1), (0, 0))), axis=0).T
    return np.nonzero(edges == 1)[1], np.nonzero(edges == -1)[1]


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Steps of equal length: the first is at `start_utc_ns`."""

    start_utc_ns: int
    step_ns: int
    steps: int

    @property
    def t_utc_ns(self) -> Ints:
        """Times of all steps, (steps,)."""
        return self.start_utc_ns + self.step_ns * np.arange(self.steps, dtype=np.int64)

    def at_or_after(self, t_utc_ns: Ints) -> Ints:
        """The first steps that are not before times."""
        return -((self.start_utc_ns - t_utc_ns) // self.step_ns)


@dataclass(frozen=True, kw_only=True)
class TrackReports(Columns):
    """What a tracker reported, a row a report, (n,), by track and time.

    Points and rates (n, 4) are those of `ground`; a rate is NaN where no velocity was told.
    """

    t_utc_ns: Ints  # For which it holds
    known_utc_ns: Ints  # When it was received; the time for which it holds where that is not known
    track: Ints  # From 0
    point: Floats
    rate: Floats
    ended: Bools  # The track ends with it


@dataclass(frozen=True, kw_only=True)
class GridRows(Columns):
    """Tracks at steps: which report says so, (n,), and where they are by it; by step."""

    step: Ints
    track: Ints
    report: Ints
    point: Floats
    age_s: Floats


def on_grid(reports: TrackReports, grid: Grid, stale_s: float, *, as_known: bool) -> GridRows:
    """Every track at every step at which its last report is not older than `stale_s`.

    `as_known` asks for what was known at the step's own time: a report counts from when it was
    received, and one that a later one has overtaken never counts. Else it counts from the time
    that it is of. Reports are by track, and by time within it.
    """
    rows = np.arange(len(reports))
    begin_ns = reports.known_utc_ns if as_known else reports.t_utc_ns
    if as_known:
        order = np.lexsort((reports.t_utc_ns, begin_ns, reports.track))
        rows = order[~overtaken(reports.track[order], reports.t_utc_ns[order])]
        begin_ns = begin_ns[rows]
    track, t_ns = reports.track[rows], reports.t_utc_ns[rows]
    first = np.maximum(grid.at_or_after(begin_ns), 0)
    following = np.full(len(rows), grid.steps)
    if len(rows):
        following[:-1] = np.where(track[1:] == track[:-1], first[1:], grid.steps)
    oldest = (t_ns + round(stale_s * NS) - grid.start_utc_ns) // grid.step_ns + 1
    last = np.where(reports.ended[rows], first, np.minimum(following, oldest))
    many = np.clip(np.minimum(last, grid.steps) - first, 0, None)
    which = np.repeat(np.arange(len(rows)), many)
    starts = np.concatenate([[0], np.cumsum(many)[:-1]]) if len(many) else many
    step = first[which] + np.arange(len(which)) - starts[which]
    by_step = np.lexsort((track[which], step))
    which, step = which[by_step], step[by_step]
    report = rows[which]
    age_s = (grid.start_utc_ns + step * grid.step_ns - t_ns[which]) / NS
    moved = np.nan_to_num(reports.rate[report]) * age_s[:, None]
    return GridRows(
        step=step,
        track=track[which],
        report=report,
        point=reports.point[report] + moved,
        age_s=age_s,
    )


def overtaken(track: Ints, t_utc_ns: Ints) -> Bools:
    """Which rows, by track and then by when they came, are of a time before an earlier one's."""
    if not len(track):
        return np.zeros(0, np.bool_)
    # Times are made to rise from track to track, so that one running maximum serves them all.
    span = int(np.ptp(t_utc_ns)) + 1
    number = np.zeros(len(track), np.int64)
    number[1:] = np.cumsum(np.diff(track) != 0)
    raised = (t_utc_ns - t_utc_ns.min()).astype(np.float64) + number * float(span)
    latest = np.maximum.accumulate(raised)
    found = np.zeros(len(track), np.bool_)
    found[1:] = np.less(raised[1:], latest[:-1])
    return found


def rates_by_differences(
    track: Ints, t_utc_ns: Ints, point: Floats, rate: Floats, longest_s: float
) -> Floats:
    """Rates (n, 4), with those between a track's last two reports where none was told.

    Rows are by track and time; of the first, and after `longest_s` without any, it stays unknown.
    """
    missing: Bools = np.asarray(np.isnan(rate).any(axis=1))
    if not missing.any() or len(track) < 2:
        return rate
    span_s = np.diff(t_utc_ns) / NS
    good = (track[1:] == track[:-1]) & (span_s > 0) & (span_s <= longest_s)
    slopes = np.diff(point, axis=0) / np.where(good, span_s, np.nan)[:, None]
    found = rate.copy()
    found[1:][missing[1:]] = slopes[missing[1:]]
    return found


NOBODY = -1


class TrackHolder:
    """Takes what there is step by step, and says which tracks are of which drones."""

    def __init__(
        self, drones: int, tracks: int, gate_m: float, *, confirm_steps: int, end_steps: int
    ) -> None:
        self._gate_m = gate_m
        self._confirm = confirm_steps
        self._end = end_steps
        # Of drones among those that are there; the last one is nobody.
        self._place = np.full(drones + 1, NOBODY)
        self._held = np.full(tracks, NOBODY)
        # Step at which a track was last within the gate of whom it is held to be of.
        self._within = np.zeros(tracks, np.int64)
        self._wanted = np.full(tracks, NOBODY)
        self._since = np.zeros(tracks, np.int64)
        self._until = np.full(tracks, -2)  # The step up to which the same one was nearest

    def step(
        self, k: int, drones: Ints, tracks: Ints, distances_m: Floats
    ) -> tuple[Ints, Ints, Ints]:
        """Tracks, the drones that they are of, and since which step, new ones from earlier on.

        `distances_m` (m, n) are those from the drones (m,) to the tracks (n,) of this step.
        """
        none = np.zeros(0, np.int64)
        if not len(tracks):
            return none, none, none
        held = self._held[tracks]
        if not len(drones):
            self._end_old(k, tracks, held)
            return none, none, none
        every = np.arange(len(tracks))
        self._place[drones] = np.arange(len(drones))
        place = self._place[held]
        self._place[drones] = NOBODY
        near = (held != NOBODY) & (place != NOBODY)
        near[near] = distances_m[place[near], every[near]] < self._gate_m
        self._within[tracks[near]] = k
        held = self._end_old(k, tracks, held)
        nearest = np.argmin(distances_m, axis=0)
        least_m = distances_m[nearest, every]
        is_free = (held == NOBODY) & (least_m < self._gate_m)
        # Another drone that is less than half as far: the track may have passed to it.
        rival = near.copy()
        rival[near] = 2 * least_m[near] < distances_m[place[near], every[near]]
        asks = is_free | rival
        asking, wanted = tracks[asks], drones[nearest[asks]]
        goes_on = (self._wanted[asking] == wanted) & (self._until[asking] == k - 1)
        since = np.where(goes_on, self._since[asking], k)
        self._wanted[asking], self._since[asking], self._until[asking] = wanted, since, k
        is_new = k - since >= np.where(rival[asks], self._end, self._confirm) - 1
        new = asking[is_new]
        self._held[new], self._within[new] = wanted[is_new], k
        near[np.flatnonzero(asks)[is_new]] = False
        old = tracks[near]
        return (
            np.concatenate([old, new]),
            np.concatenate([self._held[old], wanted[is_new]]),
            np.concatenate([np.full(len(old), k), since[is_new]]),
        )

    def _end_old(self, k: int, tracks: Ints, held: Ints) -> Ints:
        """Whom tracks are held to be of, once those are forgotten that were out for long."""
        gone = (held != NOBODY) & (k - self._within[tracks] >= self._end)
        if not gone.any():
            return held
        self._held[tracks[gone]] = NOBODY
        return np.where(gone, NOBODY, held)


@dataclass(frozen=True, kw_only=True)
class Segments(Columns):
    """Stretches of steps, (n,), over which a track is of one drone, by track and time."""

    track: Ints
    drone: Ints
    first: Ints
    last: Ints


def segments_of(track: Ints, drone: Ints, step: Ints, end_steps: int) -> Segments:
    """Stretches of what is assigned, row by row, (n,); fewer missing steps do not part them."""
    order = np.lexsort((step, drone, track))
    track, drone, step = track[order], drone[order], step[order]
    parts = np.ones(len(step), np.bool_)
    parts[1:] = (np.diff(track) != 0) | (np.diff(drone) != 0) | (np.diff(step) > end_steps)
    first = np.flatnonzero(parts)
    last = np.append(first[1:], len(step))[: len(first)] - 1
    found = Segments(track=track[first], drone=drone[first], first=step[first], last=step[last])
    return found.rows(np.lexsort((found.first, found.track)))


def right_identities(track: Ints, drone: Ints, step: Ints) -> tuple[Bools, Bools]:
    """Which drones at steps, (m,), have only tracks that were theirs at first, and which both.

    Both are tracks that were, and that were not. Rows (n,) are of tracks that are of a drone.
    """
    order = np.lexsort((step, track))
    begins = np.flatnonzero(np.diff(track[order], prepend=-1))
    first = drone[order][np.repeat(begins, np.diff(begins, append=len(order)))]
    right = np.empty(len(order), np.bool_)
    right[order] = drone[order] == first
    _, which = np.unique(np.stack([step, drone]), axis=1, return_inverse=True)
    which = which.ravel()
    has_right, has_wrong = (np.bincount(which, weights=w) > 0 for w in (right, ~right))
    return has_right & ~has_wrong, has_right & has_wrong


def swaps_of(segments: Segments) -> int:
    """How often a track passes from one drone to another."""
    same = np.diff(segments.track) == 0
    return int(np.count_nonzero(same & (np.diff(segments.drone) != 0)))


@dataclass(frozen=True, slots=True)
class Followed:
    """How tracks follow one drone: the fewest of them that tell as much of it as all do."""

    number_changes: int  # How often the next of these tracks has another number
    breaks: int  # How often no track was of the drone between two that were, while it was there
    longest_steps: int
    first_step: int  # -1 if it never had any
    tracks: int


def followed(segments: Segments, there: Ints) -> Followed:
    """How a drone that is there at these steps, in order, is followed by its own segments."""
    columns = (segments.first.tolist(), segments.last.tolist(), segments.track.tolist())
    rows = sorted(zip(*columns, strict=True))
    chosen: list[int] = []
    breaks, reached, i = 0, -1, 0
    while i < len(rows):
        start = max(rows[i][0], reached + 1)
        best = rows[i]
        while i < len(rows) and rows[i][0] <= start:
            best = max(best, rows[i], key=itemgetter(1))
            i += 1
        if best[1] <= reached:
            continue
        hole = np.searchsorted(there, [reached + 1, start])
        breaks += bool(chosen and hole[1] > hole[0])
        chosen.append(best[2])
        reached = best[1]
    return Followed(
        number_changes=sum(a != b for a, b in pairwise(chosen)),
        breaks=breaks,
        longest_steps=max((last - first + 1 for first, last, _ in rows), default=0),
        first_step=rows[0][0] if rows else -1,
        tracks=len({track for *_, track in rows}),
    )


_NONE = np.zeros(0, np.int64)


class SetScore(NamedTuple):
    """The score of one instant: parts of GOSPA as sums of p-th powers, and OSPA."""

    localisation: float
    missed: float
    false: float
    ospa_m: float
    rows: Ints
    """Truths that are paired within the cut-off, and `columns`, the tracks that they have."""
    columns: Ints

    def gospa_m(self, order: float = 2.0) -> float:
        """GOSPA, metres, of the order for which the parts are."""
        return float((self.localisation + self.missed + self.false) ** (1.0 / order))


def set_score(distances_m: Floats, cutoff_m: float, order: float = 2.0) -> SetScore:
    """Score tracks by their distances from truths, (m, n); NaN stands for what is too far.

    A pair at the cut-off or beyond is one missed truth and one false track, so that the pairs with
    the least sum of min(d, c)^p are those of GOSPA, and of OSPA too.
    """
    m, n = distances_m.shape
    limit = cutoff_m**order
    if not m or not n:
        ospa_m = cutoff_m if m or n else 0.0
        return SetScore(0.0, limit / 2 * m, limit / 2 * n, ospa_m, _NONE, _NONE)
    costs = np.fmin(distances_m, cutoff_m) ** order
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(costs)
    paired = costs[rows, columns]
    near = paired < limit
    pairs = int(np.count_nonzero(near))
    spread = (paired.sum() + limit * abs(m - n)) / max(m, n)
    return SetScore(
        float(paired[near].sum()),
        limit / 2 * (m - pairs),
        limit / 2 * (n - pairs),
        float(spread ** (1.0 / order)),
        rows[near],
        columns[near],
    )


def ospa2_m(
    distances_m: Floats, truth_there: Bools, track_there: Bools, cutoff_m: float, order: float = 2.0
) -> float:
    """OSPA between flights and tracks, metres.

    The distance of two is the mean of min(d, c), over the instants at which either is there, where
    an instant of one alone counts as c.
    """
    flights, tracks = truth_there.any(axis=0), track_there.any(axis=0)
    truth_there, track_there = truth_there[:, flights], track_there[:, tracks]
    distances_m = distances_m[:, flights][:, :, tracks]
    both = truth_there[:, :, None] & track_there[:, None, :]
    either = truth_there[:, :, None] | track_there[:, None, :]
    each_m = np.where(both, np.fmin(distances_m, cutoff_m), cutoff_m) * either
    base_m = each_m.sum(axis=0) / np.maximum(either.sum(axis=0), 1)
    return set_score(base_m, cutoff_m, order).ospa_m


class TrajectoryScore(NamedTuple):
    """Parts of T-GOSPA over a window, as sums of p-th powers."""

    localisation: float
    missed: float
    false: float
    switching: float


def t_gospa(
    distances_m: Floats,
    truth_there: Bools,
    track_there: Bools,
    *,
    cutoff_m: float,
    order: float,
    switch_m: float,
    weights: Floats | None = None,
) -> TrajectoryScore:
    """T-GOSPA, by its linear programme.

    A switch of tracks costs s^p, a pairing that is lost or gained half of it. Pairs that are never
    within the cut-off save nothing and are left out; a flight and a track that have nobody else
    near are a pair throughout, which costs no switch. Instants may count by `weights` (w,): those
    that windows share by a half.
    """
    weigh = np.ones(len(truth_there)) if weights is None else weights
    limit, change = cutoff_m**order, switch_m**order / 2
    both = truth_there[:, :, None] & track_there[:, None, :]
    costs = np.where(both, np.fmin(distances_m, cutoff_m) ** order, limit)
    rows, columns = np.nonzero((costs < limit).any(axis=0))
    costs = costs[:, rows, columns]
    alone = (np.bincount(rows)[rows] == 1) & (np.bincount(columns)[columns] == 1)
    saved = (costs - limit) * weigh[:, None]
    chosen = np.ones_like(costs)
    if not alone.all():
        others = ~alone
        chosen[:, others] = _together(saved[:, others], rows[others], columns[others], change)
    near = chosen * (costs < limit)
    paired = near.sum(axis=1)
    return TrajectoryScore(
        float(weigh @ (near * costs).sum(axis=1)),
        limit / 2 * float(weigh @ (truth_there.sum(axis=1) - paired)),
        limit / 2 * float(weigh @ (track_there.sum(axis=1) - paired)),
        change * float(np.abs(np.diff(chosen, axis=0)).sum()),
    )


def _together(saved: Floats, rows: Ints, columns: Ints, change: float) -> Floats:
    """Weights of pairs, (w, k), that share flights or tracks: least cost, each used once."""
    from scipy.optimize import linprog
    from scipy.sparse import coo_array, vstack

    steps, pairs = saved.shape
    size, moves = steps * pairs, (steps - 1) * pairs
    cells = np.arange(size).reshape(steps, pairs)
    used = []
    for whose in (rows, columns):
        _, numbers = np.unique(whose, return_inverse=True)
        count = int(numbers.max()) + 1
        at = (np.arange(steps)[:, None] * count + numbers).ravel()
        shape = (steps * count, size + moves)
        used.append(coo_array((np.ones(size), (at, cells.ravel())), shape=shape))
    ones, each = np.ones(moves), np.arange(moves)
    before, after = cells[:-1].ravel(), cells[1:].ravel()
    spans = [
        coo_array(
            (
                np.concatenate([sign * ones, -sign * ones, -ones]),
                (np.tile(each, 3), np.concatenate([after, before, size + each])),
            ),
            shape=(moves, size + moves),
        )
        for sign in (1.0, -1.0)
    ]
    limits = np.concatenate([np.ones(sum(part.shape[0] for part in used)), np.zeros(2 * moves)])
    found = linprog(
        np.concatenate([saved.ravel(), np.full(moves, change)]),
        A_ub=vstack([*used, *spans]).tocsr(),
        b_ub=limits,
        bounds=(0.0, None),
        method="highs",
    )
    weights: Floats = np.asarray(found.x[:size]).reshape(steps, pairs)
    return weights


class WalkSettings(Protocol):
    """How sets are compared."""

    cutoff_m: float
    order: float
    switch_m: float
    confirm_steps: int
    end_steps: int
    window_steps: int  # Of OSPA(2) and T-GOSPA; 0 for neither


@dataclass(frozen=True, kw_only=True)
class StepScores(Columns):
    """Every step, (steps,): counts, and parts of GOSPA as sums of p-th powers."""

    drones: Ints
    tracks: Ints
    tracked: Ints  # Drones that have a track
    assigned: Ints  # Tracks that are of a drone
    localisation: Floats
    missed: Floats
    false: Floats
    ospa_m: Floats


@dataclass(frozen=True, kw_only=True)
class Assigned(Columns):
    """Tracks that are of a drone at a step, (n,), by step; `row` is that of the grid's rows."""

    step: Ints
    drone: Ints
    track: Ints
    row: Ints
    distance_m: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Walked:
    """What all steps came to."""

    steps: StepScores
    assigned: Assigned
    nearest: Ints
    """Of each of the grid's rows: the drone that was nearest then, -1 where none was there."""
    ospa2_m: Floats  # Of each window
    window_parts: Floats
    """Localisation, missed, false and switching of T-GOSPA in each window, (windows, 4)."""


Held = tuple[Ints, Ints, Floats]  # Drones, tracks and their distances at one step


def walk(  # noqa: PLR0917
    truth: Floats, there: Bools, rows: GridRows, tracks: int, columns: int, how: WalkSettings
) -> Walked:
    """Go through a grid. Points of drones are (steps, drones, 4), whether they are there is beside.

    `rows` has tracks of numbers below `tracks`; `columns` of points count, `GROUND` or `SPACE`.
    """
    from scipy.spatial.distance import cdist

    steps, drones = there.shape
    by = np.searchsorted(rows.step, np.arange(steps + 1)).tolist()
    holder = TrackHolder(
        drones, tracks, how.cutoff_m, confirm_steps=how.confirm_steps, end_steps=how.end_steps
    )
    parts = np.zeros((steps, 4))
    nearest = np.full(len(rows), NOBODY)
    found: list[tuple[Ints, Ints, Ints, Ints]] = []
    window: list[Held] = []
    ospa2: list[float] = []
    windows: list[tuple[float, ...]] = []
    for k in range(steps):
        a, b = by[k], by[k + 1]
        here, now = np.flatnonzero(there[k]), rows.track[a:b]
        distances_m = cdist(truth[k, here, :columns], rows.point[a:b, :columns])
        score = set_score(distances_m, how.cutoff_m, how.order)
        parts[k] = score.localisation, score.missed, score.false, score.ospa_m
        if len(here) and b > a:
            nearest[a:b] = here[np.argmin(distances_m, axis=0)]
        of, whose, since = holder.step(k, here, now, distances_m)
        if len(of):
            found.append((of, whose, since, np.full(len(of), k)))
        if how.window_steps:
            window.append((here, now, distances_m))
            if len(window) > how.window_steps or k == steps - 1:
                # Windows share the steps at their ends, so that no switch is between two of them.
                weights = np.ones(len(window))
                weights[0] -= 0.5 * (k >= len(window))
                weights[-1] -= 0.5 * (k < steps - 1)
                _judge(window, weights, how, ospa2, windows)
                window = window[-1:]
    assigned = _assigned(found, truth, rows, tracks, columns)
    pairs = np.unique(assigned.step * max(drones, 1) + assigned.drone)
    return Walked(
        steps=StepScores(
            drones=there.sum(axis=1),
            tracks=np.diff(by),
            tracked=np.bincount(pairs // max(drones, 1), minlength=steps),
            assigned=np.bincount(assigned.step, minlength=steps),
            localisation=parts[:, 0],
            missed=parts[:, 1],
            false=parts[:, 2],
            ospa_m=parts[:, 3],
        ),
        assigned=assigned,
        nearest=nearest,
        ospa2_m=np.array(ospa2),
        window_parts=np.array(windows).reshape(-1, 4),
    )


def _judge(
    window: list[Held],
    weights: Floats,
    how: WalkSettings,
    ospa2: list[float],
    windows: list[tuple[float, ...]],
) -> None:
    """Judge whole tracks over a window; one in which there is nothing is passed over."""
    drones = np.unique(np.concatenate([held[0] for held in window]))
    tracks = np.unique(np.concatenate([held[1] for held in window]))
    if not len(drones) and not len(tracks):
        return
    distances_m = np.full((len(window), len(drones), len(tracks)), np.inf)
    truth_there = np.zeros((len(window), len(drones)), np.bool_)
    track_there = np.zeros((len(window), len(tracks)), np.bool_)
    for k, (here, now, each_m) in enumerate(window):
        i, j = np.searchsorted(drones, here), np.searchsorted(tracks, now)
        truth_there[k, i] = track_there[k, j] = True
        distances_m[k, i[:, None], j] = each_m
    ospa2.append(ospa2_m(distances_m, truth_there, track_there, how.cutoff_m, how.order))
    windows.append(
        t_gospa(
            distances_m,
            truth_there,
            track_there,
            cutoff_m=how.cutoff_m,
            order=how.order,
            switch_m=how.switch_m,
            weights=weights,
        )
    )


def _assigned(
    found: list[tuple[Ints, Ints, Ints, Ints]],
    truth: Floats,
    rows: GridRows,
    tracks: int,
    columns: int,
) -> Assigned:
    """What was held, a row a step, the steps before it was confirmed among them."""
    none = np.zeros(0, np.int64)
    parts = zip(*found, strict=True) if found else ([none],) * 4
    of, whose, since, until = (np.concatenate(part) for part in parts)
    many = until - since + 1
    which = np.repeat(np.arange(len(of)), many)
    step = since[which] + np.arange(len(which)) - np.repeat(np.cumsum(many) - many, many)
    track, drone = of[which], whose[which]
    row = np.searchsorted(rows.step * tracks + rows.track, step * tracks + track)
    # Of a track that has passed to another drone, what was found last counts.
    row, last = np.unique(row[::-1], return_index=True)
    step, drone, track = step[::-1][last], drone[::-1][last], track[::-1][last]
    apart = truth[step, drone, :columns] - rows.point[row, :columns]
    return Assigned(
        step=step, drone=drone, track=track, row=row, distance_m=np.sqrt((apart**2).sum(axis=1))
    )


def nees(errors_m: Floats, covariances_m2: Floats) -> Floats:
    """Normalised estimation error squared, e' P^-1 e, of errors (n, d) and (n, d, d); (n,).

    NaN where a covariance is not positive definite.
    """
    dimensions = errors_m.shape[1]
    found = np.full(len(errors_m), np.nan)
    finite = np.isfinite(errors_m).all(axis=1) & np.isfinite(covariances_m2).all(axis=(1, 2))
    usable = np.flatnonzero(finite)
    least = np.linalg.eigvalsh(covariances_m2[usable])[:, 0] if len(usable) else np.zeros(0)
    usable = usable[least > 0]
    if len(usable) and dimensions:
        solved = np.linalg.solve(covariances_m2[usable], errors_m[usable, :, None])[:, :, 0]
        found[usable] = (errors_m[usable] * solved).sum(axis=1)
    return found


def lag_parts(
    errors_m: Floats,
    velocities_m_s: Floats,
    covariances_m2: Floats | None = None,
    others: Floats | None = None,
) -> tuple[Floats, Floats]:
    """What lag is a ratio of, (n,) each: an error is -tau v, what others explain, and noise.

    tau = -sum(e' R^-1 u) / sum(v' R^-1 u), of errors and true velocities (n, d), and stated
    covariances R (n, d, d), without which all weigh alike; u is what of v the `others`, (n, d, k)
    by a unit of each, do not explain as well. NaN where nothing moves, or all may be theirs.
    """
    weigh = np.eye(errors_m.shape[1]) if covariances_m2 is None else np.linalg.inv(covariances_m2)
    left = velocities_m_s
    if others is not None and len(errors_m):
        weighed = weigh @ others
        normal = np.einsum("ndk,ndl->kl", others, weighed)
        right = np.einsum("ndk,nd->k", weighed, velocities_m_s)
        left = velocities_m_s - others @ (np.linalg.pinv(normal) @ right)
    along = (weigh @ left[:, :, None])[:, :, 0]
    parts, wholes = -(errors_m * along).sum(axis=1), (velocities_m_s * along).sum(axis=1)
    power = float((velocities_m_s * (weigh @ velocities_m_s[:, :, None])[:, :, 0]).sum())
    told = float(wholes.sum()) > TOLD * power and float((velocities_m_s**2).sum()) > 1e-9
    return (parts, wholes) if told else (np.full(len(parts), np.nan), np.zeros(len(parts)))


# Of what tells of lag, the share that must be left by errors of azimuth and range.
TOLD = 0.02


def survival_quantile(values: Floats, seen: Bools, share: float = 0.5) -> float:
    """The value by which that share has come about, where some never did while they were watched.

    `seen` (n,) says which values are such, and which are only as long as was watched (censored).
    Kaplan and Meier's estimate; infinite where fewer than that share came about.
    """
    if not len(values):
        return float("nan")
    order = np.lexsort((~seen, values))
    at_risk, left = len(values), 1.0
    for value, came in zip(values[order].tolist(), seen[order].tolist(), strict=True):
        if came:
            left *= 1 - 1 / at_risk
            if left <= 1 - share + 1e-12:
                return float(value)
        at_risk -= 1
    return float("inf")
