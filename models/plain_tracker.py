"""A plain tracker of one sensor's plots: it knows no truth, so it misses, swaps and is deceived.

Kalman's filter of constant velocity, one plot a track by the least sum of statistical distances
within a gate (global nearest neighbour: Blackman and Popoli, Design and Analysis of Modern Tracking
Systems, section 6.4), tracks that begin with M plots in N looks and end with misses in a row.

A state is position and velocity, (n, 6), metres and m/s along three fixed axes, with its covariance
(n, 6, 6). Acceleration is white noise of a density q, m2/s3: Bar-Shalom, Li and Kirubarajan,
Estimation with Applications to Tracking and Navigation, section 6.2.2. Each track has a density of
its own, which falls while plots lie nearer than the track says of its errors, as those of a target
that flies straight do, and rises when they do not (section 11.2.2, continuous adjustment).
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np

from plotfeed.models.numerics import root
from plotfeed.models.state import FALSE_ALARM, NS, Bools, Columns, Floats, Ints
from plotfeed.models.tracks import TrackNumbers, TrackRule, TrackStates

AXES = 3
# With a plot, the density of a track changes by exp(ADJUSTMENT (d2 - 1)), where d2 is the plot's
# squared statistical distance over its freedoms, counted up to MOST_D2; it is at least LEAST_SHARE
# of the highest.
ADJUSTMENT, MOST_D2, LEAST_SHARE = 0.3, 4.0, 3e-3


def predicted(
    states: Floats, covariances: Floats, after_s: Floats, density_m2_s3: float | Floats
) -> tuple[Floats, Floats]:
    """States and covariances after times (n,), which may be negative; of one density, or (n, 1)."""
    n = len(states)
    moved = states.copy()
    moved[:, :AXES] += after_s[:, None] * states[:, AXES:]
    transition = np.zeros((n, 6, 6))
    transition[:] = np.eye(6)
    noise = np.zeros((n, 6, 6))
    axes = np.arange(AXES)
    transition[:, axes, axes + AXES] = after_s[:, None]
    lasting_s = np.abs(after_s)
    noise[:, axes, axes] = density_m2_s3 * lasting_s[:, None] ** 3 / 3
    across = density_m2_s3 * (after_s * lasting_s)[:, None] / 2
    noise[:, axes, axes + AXES] = noise[:, axes + AXES, axes] = across
    noise[:, axes + AXES, axes + AXES] = density_m2_s3 * lasting_s[:, None]
    spread = transition @ covariances @ transition.transpose(0, 2, 1) + noise
    return moved, spread


def distances2(
    states: Floats, covariances: Floats, measured_m: Floats, errors_m2: Floats
) -> Floats:
    """Squared statistical distances of measured positions (n, 3), of errors (n, 3, 3); (n,)."""
    residuals = measured_m - states[:, :AXES]
    spread = covariances[:, :AXES, :AXES] + errors_m2
    solved = np.linalg.solve(spread, residuals[:, :, None])[:, :, 0]
    found: Floats = (residuals * solved).sum(axis=1)
    return found


def updated(
    states: Floats, covariances: Floats, measured_m: Floats, errors_m2: Floats
) -> tuple[Floats, Floats]:
    """States and covariances with a measured position each, (n, 3), of errors (n, 3, 3).

    By Joseph's form, which keeps covariances symmetric and positive.
    """
    residuals = measured_m - states[:, :AXES]
    spread = covariances[:, :AXES, :AXES] + errors_m2
    gain = np.linalg.solve(spread, covariances[:, :AXES, :]).transpose(0, 2, 1)
    better = states + (gain @ residuals[:, :, None])[:, :, 0]
    kept = np.broadcast_to(np.eye(6), covariances.shape).copy()
    kept[:, :, :AXES] -= gain
    narrowed = kept @ covariances @ kept.transpose(0, 2, 1)
    narrowed += gain @ errors_m2 @ gain.transpose(0, 2, 1)
    return better, narrowed


@dataclass(frozen=True, kw_only=True)
class LocatedPlots(Columns):
    """Plots as places with their errors, along three fixed axes: (n,), (n, 3) and (n, 3, 3).

    All are finite, and errors positive definite. `channel` is that of plots.
    """

    t_utc_ns: Ints
    channel: Ints
    position_enu_m: Floats
    covariance_m2: Floats
    has_height: Bools


@dataclass(frozen=True, slots=True, kw_only=True)
class PlainMotion:
    """What the filter takes for granted of targets, and how far off a plot of theirs may lie."""

    density_m2_s3: float  # Of white acceleration, at most
    initial_speed_m_s: float  # Standard deviation of a new track's velocity along each axis
    gate_probability: float  # That the right plot lies within the gate


@dataclass(frozen=True, kw_only=True)
class _Tracks(Columns):
    """All tracks, begun (`track` above 0) or not: each is as of its last plot."""

    track: Ints
    t_ns: Ints
    states: Floats
    covariances: Floats
    density_m2_s3: Floats
    looked_ns: Ints
    looks: Ints
    hits: Ints
    misses: Ints
    is_hit: Bools  # In the sector at hand
    channel: Ints  # By which it was hit last
    has_height: Bools


class PlainTracker:
    """The tracks of one sensor, fed with its plots sector by sector."""

    def __init__(self, rule: TrackRule, motion: PlainMotion, *, turns: bool) -> None:
        """`turns` says that a target is in one of several sectors, and not in each."""
        self._rule, self._motion, self._turns = rule, motion, turns
        self._numbers = TrackNumbers(rule.first_number, rule.last_number)
        self._gates = {n: _chi_square_quantile(n, motion.gate_probability) for n in (2, 3)}
        self._end_ns: int | None = None
        self._tracks = self._begun(_NO_PLOTS, 0)

    def __len__(self) -> int:
        """How many tracks there are, with those that have no number yet."""
        return len(self._tracks)

    def end(self) -> None:
        """End all tracks, of which nothing more is told; later ones have other numbers."""
        self._tracks = self._begun(_NO_PLOTS, 0)

    def take(self, plots: LocatedPlots, *, start_ns: int, end_ns: int) -> TrackStates:
        """The tracks to report at the end of a sector: those that had a plot in it, or missed one.

        Time between this sector and the one before it is not counted: nobody looked.
        """
        tracks = self._tracks
        if self._end_ns is not None and start_ns > self._end_ns:
            tracks = tracks.but(looked_ns=tracks.looked_ns + (start_ns - self._end_ns))
        self._end_ns = end_ns
        self._tracks = tracks.but(is_hit=np.zeros(len(tracks), np.bool_))
        for channel in np.unique(plots.channel).tolist():
            self._associate(plots.rows(plots.channel == channel), end_ns)
        missed = self._count_misses(end_ns)
        first = self._confirm()
        reported = (self._tracks.is_hit | missed) & (self._tracks.track > 0)
        told = self._told(np.flatnonzero(reported), first, end_ns)
        # Tracks end that have too many misses, and those that cannot begin any more.
        tracks, rule = self._tracks, self._rule
        left = rule.confirm_window - tracks.looks
        may_begin = (left > 0) & (tracks.hits + left >= rule.confirm_hits)
        goes_on = tracks.misses < rule.drop_misses
        self._tracks = tracks.rows(np.flatnonzero(np.where(tracks.track > 0, goes_on, may_begin)))
        return told

    def _associate(self, plots: LocatedPlots, end_ns: int) -> None:
        """Give plots of a channel to tracks, first to those that have begun, and begin the rest."""
        free = np.ones(len(plots), np.bool_)
        n = len(self._tracks)
        for has_begun in (True, False):
            among = np.flatnonzero((self._tracks.track[:n] > 0) == has_begun)
            left = np.flatnonzero(free)
            row, plot, far2 = self._pairs(among, plots.rows(left))
            self._hit(row, plots.rows(left[plot]), far2, end_ns)
            free[left[plot]] = False
        if free.any():
            anew = self._begun(plots.rows(free), end_ns)
            self._tracks = _Tracks.joined([self._tracks, anew])

    def _pairs(self, among: Ints, plots: LocatedPlots) -> tuple[Ints, Ints, Floats]:
        """Rows of tracks and of plots that belong together, and how far, squared; (k,) each."""
        row, plot = self._near(among, plots)
        tracks = self._tracks
        since_ns = plots.t_utc_ns[plot] - tracks.t_ns[row]
        # In one turn a beam meets a target once; other transmitters show it again in the same.
        again = tracks.is_hit[row] & (tracks.channel[row] != plots.channel[plot])
        open_to = again | ~tracks.is_hit[row]
        if self._turns:
            open_to &= again | (since_ns >= self._rule.period_ns // 2)
        row, plot, since_ns = row[open_to], plot[open_to], since_ns[open_to]
        states, spread = self._at(row, since_ns)
        errors_m2 = plots.covariance_m2[plot]
        far2 = distances2(states, spread, plots.position_enu_m[plot], errors_m2)
        gate2 = np.where(plots.has_height[plot], self._gates[3], self._gates[2])
        within = far2 <= gate2
        chosen = least_sum(row[within], plot[within], (far2 - gate2)[within])
        return row[within][chosen], plot[within][chosen], far2[within][chosen]

    def _near(self, among: Ints, plots: LocatedPlots) -> tuple[Ints, Ints]:
        """Pairs of tracks and plots that may lie within a gate of each other, and some more."""
        if not len(among) or not len(plots):
            return _NONE, _NONE
        around_ns = int(np.median(plots.t_utc_ns))
        off_s = float(np.abs(plots.t_utc_ns - around_ns).max()) / NS
        states, spread = self._at(among, around_ns - self._tracks.t_ns[among])
        later, later_spread = self._at(
            among, around_ns + round(off_s * NS) - self._tracks.t_ns[among]
        )
        errors_m2 = np.trace(plots.covariance_m2, axis1=1, axis2=2).max()
        own_m2 = (np.trace(m2[:, :AXES, :AXES], axis1=1, axis2=2) for m2 in (spread, later_spread))
        widest_m2 = np.maximum(*own_m2) + errors_m2
        moved_m = np.linalg.norm(later[:, :AXES] - states[:, :AXES], axis=1)
        reach_m = np.sqrt(self._gates[3] * widest_m2) + moved_m
        at_m = states[:, :AXES]
        if len(among) * len(plots) <= FEW_PAIRS:
            apart_m = np.linalg.norm(at_m[:, None] - plots.position_enu_m, axis=2)
            track, plot = np.nonzero(apart_m <= reach_m[:, None])
            return among[track], plot
        from scipy.spatial import cKDTree  # as long to load as NumPy

        found = cKDTree(plots.position_enu_m).query_ball_point(at_m, reach_m)
        flat = [plot for each in found for plot in sorted(each)]
        return np.repeat(among, [len(each) for each in found]), np.array(flat, np.int64)

    def _at(self, row: Ints, after_ns: Ints) -> tuple[Floats, Floats]:
        """Tracks so long after their last plots."""
        tracks = self._tracks
        density_m2_s3 = tracks.density_m2_s3[row, None]
        return predicted(tracks.states[row], tracks.covariances[row], after_ns / NS, density_m2_s3)

    def _hit(self, row: Ints, plots: LocatedPlots, far2: Floats, end_ns: int) -> None:
        """Take in the plots of tracks."""
        tracks = self._tracks
        states, spread = self._at(row, plots.t_utc_ns - tracks.t_ns[row])
        better = updated(states, spread, plots.position_enu_m, plots.covariance_m2)
        d2, most = far2 / np.where(plots.has_height, 3, 2), self._motion.density_m2_s3
        density = tracks.density_m2_s3[row] * np.exp(ADJUSTMENT * (np.minimum(d2, MOST_D2) - 1))
        tracks.density_m2_s3[row] = np.clip(density, LEAST_SHARE * most, most)
        is_new = ~tracks.is_hit[row]
        tracks.states[row], tracks.covariances[row] = better
        tracks.t_ns[row] = plots.t_utc_ns
        tracks.looked_ns[row] = plots.t_utc_ns if self._turns else end_ns
        tracks.looks[row] += is_new
        tracks.hits[row] += is_new
        tracks.misses[row] = 0
        tracks.is_hit[row] = True
        tracks.channel[row] = plots.channel
        tracks.has_height[row] |= plots.has_height

    def _begun(self, plots: LocatedPlots, end_ns: int) -> _Tracks:
        """A track of each plot, which has no number yet."""
        n = len(plots)
        spread = np.zeros((n, 6, 6))
        spread[:, :AXES, :AXES] = plots.covariance_m2
        spread[:, AXES:, AXES:] = self._motion.initial_speed_m_s**2 * np.eye(AXES)
        none, one = np.zeros(n, np.int64), np.ones(n, np.int64)
        looked_ns = plots.t_utc_ns.copy() if self._turns else np.full(n, end_ns)
        return _Tracks(
            track=none,
            t_ns=plots.t_utc_ns.copy(),
            states=np.concatenate([plots.position_enu_m, np.zeros((n, AXES))], axis=1),
            covariances=spread,
            density_m2_s3=np.full(n, self._motion.density_m2_s3),
            looked_ns=looked_ns,
            looks=one,
            hits=one.copy(),
            misses=none.copy(),
            is_hit=np.ones(n, np.bool_),
            channel=plots.channel.copy(),
            has_height=plots.has_height.copy(),
        )

    def _count_misses(self, end_ns: int) -> Bools:
        """Count a miss of tracks that are overdue: half a period late where a beam turns."""
        tracks, period_ns = self._tracks, self._rule.period_ns
        late_ns = period_ns // 2 if self._turns else -(period_ns // 2)
        missed: Bools = ~tracks.is_hit & (tracks.looked_ns + period_ns + late_ns <= end_ns)
        tracks.looked_ns[missed] += period_ns
        if not self._turns:
            tracks.looked_ns[missed] = end_ns
        tracks.looks[missed] += 1
        tracks.misses[missed] += 1
        return missed

    def _confirm(self) -> Bools:
        """Number the tracks that have had plots enough; which began."""
        tracks, rule = self._tracks, self._rule
        often = (tracks.hits >= rule.confirm_hits) & (tracks.looks <= rule.confirm_window)
        new = np.flatnonzero(often & (tracks.track == 0))
        numbers = self._numbers.given(len(new), tracks.track[tracks.track > 0])
        tracks.track[new[: len(numbers)]] = numbers
        first = np.zeros(len(tracks), np.bool_)
        first[new[: len(numbers)]] = True
        return first

    def _told(self, row: Ints, first: Bools, end_ns: int) -> TrackStates:
        tracks = self._tracks.rows(row)
        states, spread = self._at(row, end_ns - tracks.t_ns)
        sigma = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
        return TrackStates(
            drone=np.full(len(row), FALSE_ALARM, np.int64),
            track=tracks.track,
            misses=tracks.misses,
            age_s=(end_ns - tracks.t_ns) / NS,
            first=first[row],
            last=tracks.misses >= self._rule.drop_misses,
            position_enu_m=states[:, :AXES],
            velocity_enu_m_s=states[:, AXES:],
            sigma_position_m=sigma[:, :AXES],
            sigma_velocity_m_s=sigma[:, AXES:],
            has_height=tracks.has_height,
        )


def least_sum(row: Ints, column: Ints, cost: Floats) -> Ints:
    """Pairs of the least sum of costs, all below 0, no row or column twice; indices, (k,).

    Pairs are (n,), each once; rows and columns are numbers from 0 on. One row after the other has
    the shortest augmenting path (Crouse, On implementing 2D rectangular assignment algorithms,
    2016) among the pairs that there are; a row may be left without, at no cost.
    """
    pairs: dict[int, list[tuple[int, float, int]]] = {}
    for i, (r, c, each) in enumerate(
        zip(row.tolist(), column.tolist(), cost.tolist(), strict=True)
    ):
        pairs.setdefault(r, [(-1 - r, 0.0, -1)]).append((c, each, i))
    owner: dict[int, tuple[int, int]] = {}  # of a column: its row, and the pair
    has: dict[int, int] = {}  # a row's column
    of_row: dict[int, float] = defaultdict(float)  # dual variables
    of_column: dict[int, float] = defaultdict(float)
    for first in pairs:
        at, far = first, 0.0
        came: dict[int, tuple[float, int, int]] = {}  # to a column: how far, by which row and pair
        waiting: list[tuple[float, int]] = []
        reached: dict[int, float] = {}
        while True:
            for c, each, i in pairs[at]:
                there = far + each - of_row[at] - of_column[c]
                if c not in reached and (c not in came or there < came[c][0]):
                    came[c] = there, at, i
                    heappush(waiting, (there, c))
            while (end := waiting[0][1]) in reached:
                heappop(waiting)
            far = reached[end] = waiting[0][0]
            if end not in owner:
                break
            at = owner[end][0]
        of_row[first] += far
        for c, there in reached.items():
            of_column[c] -= far - there
            if c in owner:
                of_row[owner[c][0]] += far - there
        at = -1
        while at != first:
            _, at, i = came[end]
            owner[end] = at, i
            has[at], end = end, has.get(at, end)
    return np.array(sorted(i for _, i in owner.values() if i >= 0), np.int64)


def _chi_square_quantile(freedoms: int, probability: float) -> float:
    """The square below which two or three standard normal variables lie with a probability."""
    if freedoms == 2:
        return -2 * math.log1p(-probability)
    return root(
        lambda x2: (
            math.erf(math.sqrt(x2 / 2))
            - math.sqrt(2 * x2 / math.pi) * math.exp(-x2 / 2)
            - probability
        ),
        0.0,
        1000.0,
    )


# Tracks times plots up to which all pairs are looked at.
FEW_PAIRS = 1 << 16
_NONE: Ints = np.zeros(0, np.int64)
_NO_PLOTS = LocatedPlots(
    t_utc_ns=_NONE,
    channel=_NONE,
    position_enu_m=np.zeros((0, AXES)),
    covariance_m2=np.zeros((0, AXES, AXES)),
    has_height=np.zeros(0, np.bool_),
)
