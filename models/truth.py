"""Samples of telemetry and scripted paths in, the state of every drone at any time out.

Between two samples a drone follows the cubic with their positions and velocities (Hermite); past
the last it keeps its velocity until it is stale, and then it is gone. Everything is in ECEF, so
that one flight can be seen from any number of sites.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import UserList
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from heapq import heapify, heappop
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plotfeed.models.frames import axes_enu, geodetic_to_ecef
from plotfeed.models.state import (
    FEWEST_ROWS,
    NS,
    OTHER,
    Bools,
    Columns,
    Emitter,
    Floats,
    Ints,
    Signature,
    Signatures,
    Texts,
    TruthState,
    endless,
    trimmed,
    with_room,
)

if TYPE_CHECKING:
    from plotfeed.models.effects.target_echoes import TargetEcho, TargetEchoes


@dataclass(frozen=True, kw_only=True)
class Emissions(Columns):
    """What targets emit: `target` is a row of theirs, `channel` the emitter on that drone.

    `drone` is that of the target, `share` what of their power a sensor receives: all, as long as
    none is chosen.
    """

    target: Ints
    channel: Ints
    drone: Ints
    frequency_hz: Floats
    bandwidth_hz: Floats
    eirp_dbm: Floats
    share: Floats


class EmitterTable(UserList[tuple[Emitter, ...]]):
    """The emitters of every drone, by its index, and their columns, in which there is room."""

    def __init__(self, emitters: Iterable[tuple[Emitter, ...]] = ()) -> None:
        super().__init__(emitters)
        # By drone, and by the channel on it: numbers, and what is said when they are decoded.
        self._numbers: Floats = np.zeros((3, 0, 1))
        self._texts: NDArray[np.object_] = np.zeros((2, 0, 1), np.object_)
        self._count: Ints = np.zeros(0, np.int64)
        for drone in range(len(self.data)):
            self._put(drone)

    @classmethod
    def of(cls, emitters: Sequence[tuple[Emitter, ...]]) -> EmitterTable:
        """The table that those are, or one of them."""
        return emitters if isinstance(emitters, EmitterTable) else cls(emitters)

    def __setitem__(self, drone: Any, emitters: Any) -> None:
        if emitters != self.data[drone]:
            self.data[drone] = emitters
            self._put(drone)

    def append(self, emitters: tuple[Emitter, ...]) -> None:
        """Add a drone's."""
        self.data.append(emitters)
        self._put(len(self.data) - 1)

    def cut(self, drones: int) -> None:
        """Keep those of so many drones, the first ones, and not much room for more."""
        del self.data[drones:]
        self._count = trimmed(self._count, drones)
        rows = len(self._count)
        if rows < self._numbers.shape[1]:
            self._numbers = self._numbers[:, :rows].copy()
            self._texts = self._texts[:, :rows].copy()

    def emissions(self, drones: Ints) -> Emissions:
        """Emissions of targets that are those drones, a row an emitter, in the order of targets."""
        count = self._count[drones]
        if (count == 1).all():
            target, channel = np.arange(len(drones)), np.zeros(len(drones), int)
        else:
            target = np.repeat(np.arange(len(drones)), count)
            channel = np.arange(len(target)) - (np.cumsum(count) - count)[target]
            drones = drones[target]
        frequency_hz, bandwidth_hz, eirp_dbm = self._numbers[:, drones, channel]
        return Emissions(
            target=target,
            channel=channel,
            drone=drones,
            frequency_hz=frequency_hz,
            bandwidth_hz=bandwidth_hz,
            eirp_dbm=eirp_dbm,
            share=ALL[: len(target)],
        )

    def kinds(self, emissions: Emissions) -> Texts:
        """Kinds of emissions that are from here; (n,)."""
        return np.asarray(self._texts[0, emissions.drone, emissions.channel])

    def identities(self, emissions: Emissions) -> Texts:
        """What emissions that are from here say when they are decoded; (n,)."""
        return np.asarray(self._texts[1, emissions.drone, emissions.channel])

    def _put(self, drone: int) -> None:
        """Put a drone's emitters into the columns."""
        emitters, (_, rows, most) = self.data[drone], self._numbers.shape
        if drone >= rows or len(emitters) > most:
            self._count = with_room(self._count, len(self.data))
            room = (len(self._count), max(most, len(emitters)))
            numbers, texts = np.zeros((3, *room)), np.zeros((2, *room), np.object_)
            numbers[:, :rows, :most], texts[:, :rows, :most] = self._numbers, self._texts
            self._numbers, self._texts = numbers, texts
        for i, e in enumerate(emitters):
            self._numbers[:, drone, i] = e.frequency_hz, e.bandwidth_hz, e.eirp_dbm
            self._texts[:, drone, i] = e.kind, e.identity
        self._count[drone] = len(emitters)


ALL = endless(1.0, np.float64)
COLUMNS = ("rcs_m2", "sound_power_db", "size_m", "target_class", "model")


class KnownSignatures:
    """Columns with room for more rows than there are; what is put last of a row counts."""

    def __init__(self, *, tells_echoes: bool = False) -> None:
        """`tells_echoes` where echoes of some drone may be stated."""
        self._echoes: list[TargetEcho | None] | None = [] if tells_echoes else None
        self._echo_columns: TargetEchoes | None = None
        of_nobody = Signatures(rcs_m2=np.zeros(0), sound_power_db=np.zeros(0), emitters=())
        self._columns: dict[str, NDArray[Any]] = {n: getattr(of_nobody, n)[:0] for n in COLUMNS}
        self._emitters = EmitterTable()

    def add_row(self) -> None:
        """Know one more drone, of which nothing is known yet."""
        self._emitters.append(())
        if self._echoes is not None:
            self._echoes.append(None)

    def make_room(self, rows: int) -> None:
        """Have columns for at least so many rows."""
        for name, column in self._columns.items():
            self._columns[name] = with_room(column, rows)

    def forget(self, row: int) -> None:
        """Let a drone radiate no more: it is gone."""
        self._emitters[row] = ()

    def cut(self, rows: int) -> None:
        """Keep so many rows, the first ones, and not much room for more."""
        self._emitters.cut(rows)
        if self._echoes is not None:
            del self._echoes[rows:]
            self._echo_columns = None
        for name, column in self._columns.items():
            self._columns[name] = trimmed(column, rows)

    def put(self, rows: Ints, signatures: Signatures) -> None:
        """Put those of drones in their rows; (m,) each."""
        for name, column in self._columns.items():
            column[rows] = getattr(signatures, name)[: len(rows)]
        known, echoes = self._echoes, signatures.echoes
        for i, row in enumerate(() if known is None else rows.tolist()):
            from plotfeed.models.effects.target_echoes import NOT_STATED

            number = NOT_STATED if echoes is None else int(echoes.kind[i])
            echo = None if echoes is None or number == NOT_STATED else echoes.kinds[number]
            if known is not None and known[row] != echo:
                known[row], self._echo_columns = echo, None
        for row, emitters in zip(rows.tolist(), signatures.emitters, strict=True):
            self._emitters[row] = emitters

    @property
    def all(self) -> Signatures:
        """Signatures of every row."""
        echoes = self._echo_columns
        if self._echoes is not None and (echoes is None or len(echoes.kind) != len(self._echoes)):
            from plotfeed.models.effects.target_echoes import TargetEchoes

            echoes = self._echo_columns = TargetEchoes.of(self._echoes)
        return Signatures(**self._columns, emitters=self._emitters, echoes=echoes)


# Samples of drones that are heard of live, all in one log, and the stretches of path they make.
#
# Each sample knows the one before it of its drone, so that any number of drones is added to,
# looked up and forgotten in a few operations on whole columns.
FOREVER_NS = (1 << 63) - 1
NONE = -1  # The number of no sample

# An unknown velocity is fitted over as many samples as it takes to know it this well.
SIGMA_VELOCITY_M_S = 1.0
MAX_FIT_SAMPLES = 20
MAX_FIT_S = 6.0  # Longer than this a drone does not fly straight


@dataclass(frozen=True, slots=True)
class Stretches:
    """Stretches of time in which positions are one cubic in the time since its start; (m,)."""

    start_ns: Ints
    end_ns: Ints
    alive: Bools
    coefficients: Floats
    """(4, 3, m): metres, m/s, m/s2, m/s3."""

    @classmethod
    def none(cls, m: int) -> Self:
        """Stretches that are yet to be filled in."""
        return cls(
            start_ns=np.zeros(m, np.int64),
            end_ns=np.zeros(m, np.int64),
            alive=np.zeros(m, np.bool_),
            coefficients=np.zeros((4, 3, m)),
        )

    def put(self, which: Ints | slice, found: Stretches) -> None:
        """Fill in those."""
        self.start_ns[which], self.end_ns[which] = found.start_ns, found.end_ns
        self.alive[which] = found.alive
        self.coefficients[:, :, which] = found.coefficients

    def rows(self, which: Ints | slice) -> Stretches:
        """Some of them."""
        at = self.coefficients[:, :, which]
        return Stretches(self.start_ns[which], self.end_ns[which], self.alive[which], at)

    def with_room(self, m: int) -> Stretches:
        """Columns of their own for them and, up to so many, for others."""
        made = Stretches.none(m)
        made.put(slice(len(self.start_ns)), self)
        return made

    def places_m(self, t_utc_ns: Ints) -> Floats:
        """ECEF positions at times within them, (m,), or of one stretch at any, (k,); (..., 3)."""
        return place(self.coefficients, (t_utc_ns - self.start_ns) / NS).T

    def between(self, start_ns: ArrayLike, end_ns: ArrayLike) -> Stretches:
        """The parts of them that lie between those times."""
        from_ns = np.maximum(self.start_ns, start_ns)
        is_cut = self.alive & (from_ns > self.start_ns)
        tau_s = np.where(is_cut, from_ns - self.start_ns, 0) / NS
        _, c1, c2, c3 = self.coefficients
        moved = [place(self.coefficients, tau_s), (3 * c3 * tau_s + 2 * c2) * tau_s + c1]
        moved += [3 * c3 * tau_s + c2, c3]
        coefficients = np.where(is_cut, np.stack(moved), self.coefficients)
        return Stretches(from_ns, np.minimum(self.end_ns, end_ns), self.alive, coefficients)


def stretches_between(  # noqa: PLR0917
    t_utc_ns: Ints,
    at: Ints,
    after: Ints,
    samples: tuple[Ints, Floats, Floats, Bools],
    max_gap_ns: Ints | int,
    tail_ns: Ints | int,
) -> Stretches:
    """The stretches that hold times (m,), each between two samples by their numbers, or `NONE`.

    Of samples there are times (n,), positions and velocities (n, 3), and whether no path leads to
    them from the one before. A longer gap than `max_gap_ns` is not bridged: the drone was gone
    meanwhile. It lives on past its last sample for `tail_ns`.
    """
    times_ns, position_m, velocity_m_s, starts = samples
    start_ns, next_ns = times_ns[at], np.where(after >= 0, times_ns[after], FOREVER_NS)
    known = at >= 0
    bridged = known & (after >= 0) & (next_ns - start_ns <= max_gap_ns) & ~starts[after]
    gone_ns = np.minimum(start_ns + np.minimum(FOREVER_NS - start_ns, tail_ns), next_ns)
    alive = known & (bridged | (t_utc_ns < gone_ns))
    coefficients = np.zeros((4, 3, len(t_utc_ns)))
    coefficients[0] = np.where(alive, position_m[at].T, 0.0)
    coefficients[1] = np.where(alive, velocity_m_s[at].T, 0.0)
    if bridged.any():
        which = np.flatnonzero(bridged)
        duration_s = (next_ns[which] - start_ns[which]) / NS
        p0, v0 = coefficients[:2, :, which]
        p1, v1 = position_m[after[which]].T, velocity_m_s[after[which]].T
        mean_velocity = (p1 - p0) / duration_s
        coefficients[2, :, which] = ((3 * mean_velocity - 2 * v0 - v1) / duration_s).T
        # By Python's own power: NumPy's square differs in the last bit.
        squares_s2 = np.array([s**2 for s in duration_s.tolist()])
        coefficients[3, :, which] = ((v0 + v1 - 2 * mean_velocity) / squares_s2).T
    return Stretches(
        start_ns=np.where(alive, start_ns, np.where(known, gone_ns, -FOREVER_NS)),
        end_ns=np.where(alive & ~bridged, gone_ns, next_ns),
        alive=alive,
        coefficients=coefficients,
    )


@dataclass(frozen=True, kw_only=True)
class FlightSamples(Columns):
    """Where drones were, WGS-84 with heights above the ellipsoid, and how they flew, (n, 3), ENU.

    Components of velocities that are NaN are fitted to the latest positions; `sigma_m`, the
    positions' standard deviation, says over how many, NaN where it is not known.
    """

    t_utc_ns: Ints
    latitude_deg: Floats
    longitude_deg: Floats
    height_m: Floats
    velocity_enu_m_s: Floats
    sigma_m: Floats


class LiveSamples:
    """A log of samples, by the rows of their drones; what is too old for anybody is forgotten."""

    def __init__(
        self, *, stale_after_ns: int, history_ns: int, max_speed_m_s: float = np.inf
    ) -> None:
        """A drone is gone so long after its last sample; so long a time before it is asked for.

        No velocity is fitted that is faster than `max_speed_m_s`.
        """
        self._max_speed_m_s = max_speed_m_s
        self._stale_after_ns = stale_after_ns
        self._history_ns = history_ns
        self._number = 0
        self._drone: Ints = np.zeros(0, np.int64)
        self._t_utc_ns: Ints = np.zeros(0, np.int64)
        self._position_ecef_m: Floats = np.zeros((0, 3))
        self._velocity_ecef_m_s: Floats = np.zeros((0, 3))
        self._before: Ints = np.zeros(0, np.int64)
        # Samples to which no path leads from the one before.
        self._starts: Bools = np.zeros(0, np.bool_)
        self._any_starts = False
        # Number of the latest sample of each drone, and one more: 0 for none.
        self._latest: Ints = np.zeros(0, np.int64)

    def __len__(self) -> int:
        """How many samples are kept."""
        return self._number

    def span_ns(self, drone: int) -> tuple[int, int]:
        """The times of the first sample that is kept of a drone, and of its latest."""
        last = first = int(self._latest[drone]) - 1
        while self._before[first] >= 0:
            first = int(self._before[first])
        return int(self._t_utc_ns[first]), int(self._t_utc_ns[last])

    def add(
        self, drones: Ints, t_utc_ns: Ints, position_ecef_m: Floats, starts: Sequence[int] = ()
    ) -> Ints:
        """Add samples of drones, of each in the order of time; their numbers, (n,).

        They have no velocities yet. To those at indices `starts` no path leads from before.
        """
        n = len(drones)
        if self._number + n > len(self._t_utc_ns):
            self._forget()
        self._latest = with_room(self._latest, int(drones.max()) + 1)
        for name in _COLUMNS:
            setattr(self, name, with_room(getattr(self, name), self._number + n))
        numbers: Ints = np.arange(self._number, self._number + n)
        new = slice(self._number, self._number + n)
        self._drone[new], self._t_utc_ns[new] = drones, t_utc_ns
        self._position_ecef_m[new] = position_ecef_m
        order = np.argsort(drones, kind="stable")
        sorted_drones = drones[order]
        again = np.flatnonzero(sorted_drones[1:] == sorted_drones[:-1])
        before = self._latest[drones] - 1
        before[order[again + 1]] = numbers[order[again]]
        self._before[new] = before
        self._starts[new] = False
        if len(starts):
            self._starts[numbers[list(starts)]] = self._any_starts = True
        last = np.ones(n, np.bool_)
        last[again] = False
        self._latest[sorted_drones[last]] = numbers[order[last]] + 1
        self._number += n
        return numbers

    def fly(self, numbers: Ints, velocity_ecef_m_s: Floats) -> None:
        """Give samples their velocities; (n, 3)."""
        self._velocity_ecef_m_s[numbers] = velocity_ecef_m_s

    def path(self) -> tuple[Floats, Floats]:
        """Positions and velocities of all samples; (n, 3) each."""
        return self._position_ecef_m[: self._number], self._velocity_ecef_m_s[: self._number]

    def fitted_velocity(self, numbers: Ints, sigma_m: Floats) -> Floats:
        """Velocities of samples by `fit_velocities` over them and those before; (n, 3), ECEF."""
        if not len(numbers):
            return np.zeros((0, 3))
        chain = np.full((len(numbers), MAX_FIT_SAMPLES), NONE)
        chain[:, -1] = numbers
        for i in range(MAX_FIT_SAMPLES - 1, 0, -1):
            before = np.where(chain[:, i] >= 0, self._before[chain[:, i]], NONE)
            if self._any_starts:
                before[self._starts[chain[:, i]]] = NONE
            if (before < 0).all():
                break
            chain[:, i - 1] = before
        of_chain = self._t_utc_ns[chain], self._position_ecef_m[chain]
        fitted = fit_velocities(*of_chain, (chain >= 0).sum(axis=1), sigma_m)
        return within_speed(fitted, self._max_speed_m_s)

    def stretches_at(self, drones: Ints, t_utc_ns: Ints) -> Stretches:
        """The stretches of drones (m,), each with a sample at least, that hold times (m,)."""
        at, after = self._latest[drones] - 1, np.full(len(drones), NONE)
        later = np.flatnonzero(t_utc_ns < self._t_utc_ns[at])
        while len(later):
            after[later] = at[later]
            at[later] = self._before[at[later]]
            later = later[at[later] >= 0]
            later = later[t_utc_ns[later] < self._t_utc_ns[at[later]]]
        samples = self._t_utc_ns, self._position_ecef_m, self._velocity_ecef_m_s, self._starts
        stale_ns = self._stale_after_ns
        return stretches_between(t_utc_ns, at, after, samples, stale_ns, stale_ns)

    def forget(self, drones: Ints, rows: int) -> None:
        """Forget all samples of those drones; of others there are none beyond so many rows."""
        self._latest[drones] = 0
        self._latest = trimmed(self._latest, rows)
        self._forget()
        for name in _COLUMNS:
            setattr(self, name, trimmed(getattr(self, name), self._number))

    def _forget(self) -> None:
        """Drop samples that no state within the history of their drones needs."""
        n = self._number
        before, drone = self._before[:n], self._drone[:n]
        known = drone < len(self._latest)
        latest = np.where(known, self._latest[np.where(known, drone, 0)], 0) - 1
        needed_from_ns = self._t_utc_ns[latest] - self._history_ns
        needed_from_ns[latest < 0] = FOREVER_NS
        keep = np.arange(n) == latest
        follows = np.flatnonzero(before >= 0)
        needed = self._t_utc_ns[follows] > needed_from_ns[follows]
        keep[before[follows[needed]]] = True
        keep[follows[needed]] = True
        kept = np.flatnonzero(keep)
        if len(kept) > n - n // 4:
            return
        renumbered = np.append(np.where(keep, np.cumsum(keep) - 1, NONE), NONE)
        has_any = self._latest > 0
        self._latest[has_any] = renumbered[self._latest[has_any] - 1] + 1
        self._number = len(kept)
        self._before[: len(kept)] = renumbered[before[kept]]
        for name in _COLUMNS:
            if name != "_before":
                column = getattr(self, name)
                column[: len(kept)] = column[kept]
        self._any_starts = bool(self._starts[: len(kept)].any())


_COLUMNS = (
    "_drone", "_t_utc_ns", "_position_ecef_m", "_velocity_ecef_m_s", "_before", "_starts"
)  # fmt: skip


def within_speed(velocity_m_s: Floats, max_speed_m_s: float) -> Floats:
    """Velocities (n, 3), those that are faster than that slowed down to it."""
    speed_m_s = np.linalg.norm(velocity_m_s, axis=1)
    if not (speed_m_s > max_speed_m_s).any():
        return velocity_m_s
    share = max_speed_m_s / np.maximum(speed_m_s, max_speed_m_s)
    slowed: Floats = velocity_m_s * share[:, None]
    return slowed


def fit_velocities(t_utc_ns: Ints, position_m: Floats, counts: Ints, sigma_m: Floats) -> Floats:
    """Slopes of the straight lines through the latest positions, m/s; zero through a single one.

    Each reaches back over as many samples as bring its standard deviation, sigma/sqrt(sum (t - mean
    t)^2), under `SIGMA_VELOCITY_M_S`: two where positions are fine, many where they are coarse, so
    that the steps of a quantised position are not taken for speed. Times (m, k) and positions
    (m, k, 3) in, of which the last `counts` are known; (m, 3) out.
    """
    t_s = (t_utc_ns - t_utc_ns[:, -1:]) / NS
    slopes = np.zeros((len(t_s), position_m.shape[-1]))
    open_ = np.flatnonzero(counts >= 2)
    for n in range(2, t_s.shape[1] + 1):
        if n > 2:
            open_ = open_[(counts[open_] >= n) & (t_s[open_, -n] >= -MAX_FIT_S)]
        if not len(open_):
            break
        latest_s = t_s[open_, -n:]
        t = latest_s - latest_s.mean(axis=1)[:, None]
        spread_s2 = np.matmul(t[:, None], t[:, :, None])[:, 0, 0]
        slopes[open_] = np.matmul(t[:, None], position_m[open_, -n:])[:, 0] / spread_s2[:, None]
        open_ = open_[sigma_m[open_] > SIGMA_VELOCITY_M_S * spread_s2**0.5]
    return slopes


# Paths that are known to their end: scripted ones, recorded flights, and one after another.


# One after another of a drone that are kept: who diverts it more often loses what was first.
MAX_TRACKS = 256


@dataclass(slots=True, eq=False)
class KnownTrack:
    """Samples of a drone, (n, 3) in the order of time."""

    t_utc_ns: list[int]
    position_ecef_m: Floats
    velocity_ecef_m_s: Floats
    max_gap_ns: int
    """A longer gap between samples is not bridged: the drone was gone meanwhile."""
    tail_ns: int
    """How long the drone lives on past its last sample."""
    period_ns: int = 0
    """The path starts again after this; 0 for never."""
    starts: frozenset[int] = frozenset()
    """Indices of samples to which no path leads from the one before."""

    @classmethod
    def straight(
        cls, t_utc_ns: Sequence[int], position_ecef_m: Floats, *, repeat: bool = False
    ) -> Self:
        """A path of constant velocity between knots (k, 3), gone after the last one."""
        velocity_m_s = np.diff(position_ecef_m, axis=0) / (np.diff(t_utc_ns) / NS)[:, None]
        begins_and_ends = np.repeat(np.arange(len(t_utc_ns)), 2)[1:-1]
        return cls.smooth(
            [t_utc_ns[i] for i in begins_and_ends.tolist()],
            position_ecef_m[begins_and_ends],
            np.repeat(velocity_m_s, 2, axis=0),
            repeat=repeat,
        )

    @classmethod
    def smooth(
        cls,
        t_utc_ns: Sequence[int],
        position_ecef_m: Floats,
        velocity_ecef_m_s: Floats,
        *,
        repeat: bool = False,
    ) -> Self:
        """A path by the cubics through knots with velocities (k, 3), gone after the last one."""
        period_ns = t_utc_ns[-1] - t_utc_ns[0] if repeat else 0
        return cls([*t_utc_ns], position_ecef_m, velocity_ecef_m_s, FOREVER_NS, 0, period_ns)

    def later(self, by_ns: int) -> KnownTrack:
        """A path that is the same, so much later."""
        return replace(self, t_utc_ns=[t_utc_ns + by_ns for t_utc_ns in self.t_utc_ns])

    def span_ns(self, _drone: int) -> tuple[int, int]:
        """The times of the first and the last sample."""
        return self.t_utc_ns[0], self.t_utc_ns[-1]

    def stretch_at(self, t_utc_ns: int) -> Stretches:
        """The stretch that holds a time; (1,)."""
        return stretches_of([TrackChain(self)], [t_utc_ns])


class TrackChain:
    """Tracks of one drone, each followed from a time on in place of the one before."""

    def __init__(self, first: KnownTrack) -> None:
        """Follow that one, until there is another."""
        self._from_ns = [-FOREVER_NS]
        self._tracks = [first]

    def then(self, from_ns: int, track: KnownTrack) -> None:
        """Follow that one from then on; what was to follow from later on is followed no more."""
        while self._from_ns[-1] >= from_ns:
            del self._from_ns[-1], self._tracks[-1]
        if len(self._tracks) == MAX_TRACKS:
            del self._from_ns[1], self._tracks[0]
        self._from_ns.append(from_ns)
        self._tracks.append(track)

    def put_off(self, by_ns: int) -> None:
        """Have all of it so much later."""
        self._from_ns[1:] = [from_ns + by_ns for from_ns in self._from_ns[1:]]
        self._tracks = [track.later(by_ns) for track in self._tracks]

    def span_ns(self, drone: int) -> tuple[int, int]:
        """The times of the first sample and the last."""
        return self._tracks[0].span_ns(drone)[0], self._tracks[-1].span_ns(drone)[1]

    def track_at(self, t_utc_ns: int) -> tuple[KnownTrack, int, int]:
        """The track that is followed at a time, from when on, and until when."""
        k = bisect_right(self._from_ns, t_utc_ns)
        return self._tracks[k - 1], self._from_ns[k - 1], (*self._from_ns[k:], FOREVER_NS)[0]


def stretches_of(chains: Sequence[TrackChain], t_utc_ns: Sequence[int]) -> Stretches:
    """The stretches of chains (m,) that hold times (m,)."""
    m = len(chains)
    asked_ns, from_ns, until_ns, max_gap_ns, tail_ns = np.zeros((5, m), np.int64)
    at, after = np.full((2, m), NONE)
    # The samples before those times, and the ones after them.
    times_ns, starts = np.zeros(2 * m, np.int64), np.zeros(2 * m, np.bool_)
    position_m, velocity_m_s = np.zeros((2, 2 * m, 3))
    which: list[int] = []  # Times between the same two samples of a drone have one stretch
    i, last, begins_ns, ends_ns = -1, None, 0, 0
    for chain, t in zip(chains, t_utc_ns, strict=True):
        if chain is last and begins_ns <= t < ends_ns:
            which.append(i)
            continue
        i, last = i + 1, chain
        which.append(i)
        asked_ns[i] = t
        track, from_ns[i], until_ns[i] = chain.track_at(t)
        max_gap_ns[i], tail_ns[i] = track.max_gap_ns, track.tail_ns
        shift_ns = 0
        if track.period_ns and t >= track.t_utc_ns[0]:
            shift_ns = (t - track.t_utc_ns[0]) // track.period_ns * track.period_ns
        following = bisect_right(track.t_utc_ns, t - shift_ns)
        for number, k, row in ((at, following - 1, i), (after, following, m + i)):
            if 0 <= k < len(track.t_utc_ns):
                number[i], times_ns[row] = row, track.t_utc_ns[k] + shift_ns
                position_m[row] = track.position_ecef_m[k]
                velocity_m_s[row] = track.velocity_ecef_m_s[k]
                starts[row] = k in track.starts
        begins_ns = ends_ns = 0
        if at[i] >= 0 and after[i] >= 0 and times_ns[m + i] - times_ns[i] <= track.max_gap_ns:
            begins_ns = max(int(times_ns[i]), int(from_ns[i]))
            ends_ns = begins_ns if starts[m + i] else min(int(times_ns[m + i]), int(until_ns[i]))
    samples, n = (times_ns, position_m, velocity_m_s, starts), i + 1
    found = stretches_between(asked_ns[:n], at[:n], after[:n], samples, max_gap_ns[:n], tail_ns[:n])
    found = found.between(from_ns[:n], until_ns[:n])
    return found if n == m else found.rows(np.array(which))


# The stretch of each drone's path that was asked for last, so that most lookups are arithmetic.


class StretchesAtHand:
    """One stretch a drone, by its row; what lies outside is looked up, and is then at hand."""

    def __init__(self, looked_up: Callable[[Ints, Ints], Stretches]) -> None:
        """`looked_up` finds the stretches that hold times (m,), of rows (m,)."""
        self._looked_up = looked_up
        self._held = Stretches.none(0)

    def make_room(self, rows: int) -> None:
        """Have so many rows at least."""
        room = len(self._held.start_ns)
        if rows > room:
            self._held = self._held.with_room(max(rows, FEWEST_ROWS, 2 * room))

    def forget(self, rows: Ints, n: int) -> None:
        """Have nobody in those rows, and not much more room than for the first n."""
        held = self._held
        held.start_ns[rows], held.end_ns[rows] = -FOREVER_NS, FOREVER_NS
        held.alive[rows], held.coefficients[:, :, rows] = False, 0.0
        kept = len(trimmed(held.start_ns, n))
        if kept < len(held.start_ns):
            self._held = held.rows(np.arange(kept))

    def drop(self, rows: Ints) -> None:
        """Look those up when they are next asked for: they are others now."""
        self._held.end_ns[rows] = self._held.start_ns[rows]

    def at(
        self, t_utc_ns: Ints, rows: Ints, *, everybody: bool = False
    ) -> tuple[Bools, Floats, Floats]:
        """Who of rows (m,) is there at times (m,), how long after the start of which cubic, s.

        (m,), (m,) and coefficients (4, 3, m). With `everybody`, rows are all from 0 on.
        """
        held = self._held.rows(slice(len(rows)) if everybody else rows)
        outside = np.flatnonzero((t_utc_ns < held.start_ns) | (t_utc_ns >= held.end_ns))
        if len(outside):
            found = self._looked_up(t_utc_ns[outside], rows[outside])
            held = held.with_room(len(rows)) if everybody else held
            held.put(outside, found)
            # Of a drone asked for at several times, one stretch stays at hand, whole.
            kept, first = np.unique(rows[outside], return_index=True)
            self._held.put(kept, found.rows(first))
        return held.alive, (t_utc_ns - held.start_ns) / NS, held.coefficients

    def position_at(self, t_utc_ns: Ints, rows: Ints) -> Floats:
        """ECEF positions of rows (m,) at times (m,), metres; (m, 3), NaN for one not there."""
        there, tau_s, coefficients = self.at(t_utc_ns, rows)
        position_m = place(coefficients, tau_s).T
        position_m[~there] = np.nan
        return position_m

    def positions_at(self, t_utc_ns: Ints, n: int) -> Floats:
        """ECEF positions of the first n rows at times (k,), metres; (k, n, 3), NaN as above."""
        rows = np.arange(n)
        if len(t_utc_ns) == 1:
            return self.position_at(np.full(rows.shape, t_utc_ns[0]), rows)[None]
        self.at(np.broadcast_to(t_utc_ns[0], rows.shape), rows)
        held = self._held.rows(slice(n))
        one_piece = (t_utc_ns[0] >= held.start_ns) & (t_utc_ns[-1] < held.end_ns)
        alive, coefficients = held.alive, held.coefficients
        if not alive.all():
            coefficients = np.where(alive, coefficients, np.nan)
        tau_s = (t_utc_ns[:, None] - held.start_ns) / NS
        positions_m: Floats = np.moveaxis(place(coefficients[:, :, None], tau_s), 0, -1)
        others = np.flatnonzero(~one_piece)
        if len(others):
            times_ns, each = np.tile(t_utc_ns, len(others)), np.repeat(others, len(t_utc_ns))
            positions = self.position_at(times_ns, each).reshape(len(others), -1, 3)
            positions_m[:, others] = positions.swapaxes(0, 1)
        return positions_m


def place(coefficients: Floats, tau_s: Floats) -> Floats:
    """Positions by (4, 3, ...) coefficients, after (...) times; (3, ...), a row a component."""
    c0, c1, c2, c3 = coefficients
    position_m: Floats = c3 * tau_s
    for lower in (c2, c1):
        position_m += lower
        position_m *= tau_s
    position_m += c0
    return position_m


def slope(coefficients: Floats, tau_s: Floats) -> Floats:
    """Velocities by (4, 3, ...) coefficients, after (...) times; (3, ...)."""
    _, c1, c2, c3 = coefficients
    velocity_m_s: Floats = c3 * (1.5 * tau_s)
    velocity_m_s += c2
    velocity_m_s *= 2 * tau_s
    velocity_m_s += c1
    return velocity_m_s


NOBODY = ""  # The name in a row that is free for another drone

DEFAULT_SIGMA_M = 0.5  # Taken for the position accuracy of telemetry that states none


class Trajectories:
    """Every drone's samples. A drone has the lowest row that was free when it first appeared."""

    def __init__(
        self,
        *,
        stale_after_s: float,
        history_s: float = 60.0,
        max_speed_m_s: float = np.inf,
        tells_echoes: bool = False,
    ) -> None:
        """No velocity is fitted that is faster than `max_speed_m_s`.

        `tells_echoes` where echoes of some drone may be stated.
        """
        self.stale_after_ns = round(stale_after_s * NS)
        self._max_speed_m_s = max_speed_m_s
        # By row. Another list as soon as a name in it would change; it may grow as it is.
        self.names: list[str] = []
        # Changes with every sample: states computed under another version may be out of date.
        self.version = 0
        self._index: dict[str, int] = {}
        self._free: list[int] = []  # A heap of rows below the last one in use
        self._others: list[int] = []  # Rows of what is no drone
        self._live = LiveSamples(
            stale_after_ns=self.stale_after_ns,
            history_ns=round(history_s * NS),
            max_speed_m_s=max_speed_m_s,
        )
        self._tracks: dict[int, TrackChain] = {}  # By row, of drones that are not live
        self._at_hand = StretchesAtHand(self._looked_up)
        self._signatures = KnownSignatures(tells_echoes=tells_echoes)

    def add_samples(
        self,
        drones: Sequence[str],
        samples: FlightSamples,
        signatures: Signatures,
        starts: Sequence[int] = (),
    ) -> None:
        """Add samples (n,), each later than the last of its drone.

        Samples that no sensor can ask for any more are forgotten. It is the same whether samples
        are added together or one after the other. To samples at indices `starts` no path leads from
        before, and no velocity is fitted across.
        """
        rows = np.array(self._rows(drones), np.int64)
        _log(samples, rows, self._live, starts)
        self._changed(rows, signatures)

    def add_flight(
        self, drone: str, samples: FlightSamples, signature: Signature, starts: Sequence[int] = ()
    ) -> KnownTrack:
        """All samples (n,) of a drone that has none yet, as `add_samples`; none is forgotten."""
        n, stale_ns = len(samples), self.stale_after_ns
        flown = LiveSamples(
            stale_after_ns=stale_ns, history_ns=FOREVER_NS, max_speed_m_s=self._max_speed_m_s
        )
        _log(samples, np.zeros(n, np.int64), flown, starts)
        track = KnownTrack(
            *(samples.t_utc_ns.tolist(), *flown.path(), stale_ns, stale_ns),
            starts=frozenset(starts),
        )
        self.add_track(drone, track, signature)
        return track

    def forget(self, drones: Iterable[str]) -> None:
        """Forget drones of which samples were added; others may have their rows.

        Those that stay keep theirs, so that what is drawn for them stays as it is.
        """
        rows = [self._index.pop(drone) for drone in drones]
        if not rows:
            return
        self.names = [*self.names]
        for row in rows:
            self.names[row] = NOBODY
            self._signatures.forget(row)
        while self.names and self.names[-1] == NOBODY:
            self.names.pop()
        n = len(self.names)
        self._free = [row for row in (*self._free, *rows) if row < n]
        heapify(self._free)
        self._live.forget(np.array(rows), n)
        self._at_hand.forget(np.array(rows), n)
        self._signatures.cut(n)
        self.version += 1

    def __len__(self) -> int:
        """How many drones are known."""
        return len(self._index) - len(self._others)

    def add_track(self, drone: str, track: KnownTrack, signature: Signature) -> None:
        """All of a drone that has no samples yet."""
        rows = self._rows([drone])
        self._tracks[rows[0]] = TrackChain(track)
        self._others += rows if OTHER in drone else []
        self._changed(np.array(rows), Signatures.of_one(signature))

    def add_other(self, name: str) -> int:
        """Row of what is no drone and is nowhere: it only has plots."""
        if name not in self._index:
            self.add_track(name, KnownTrack.straight([0, 1], np.zeros((2, 3))), Signature())
        return self._index[name]

    @property
    def has_others(self) -> bool:
        """Whether there is anything that is no drone."""
        return bool(self._others)

    def are_others(self, drones: Ints) -> Bools:
        """Which of those rows are of no drone, (n,)."""
        return np.isin(drones, self._others)

    def divert(self, drone: str, from_utc_ns: int, track: KnownTrack) -> None:
        """Have a drone of a known path leave it then for another."""
        row = self._index[drone]
        self._tracks[row].then(from_utc_ns, track)
        self._at_hand.drop(np.array([row]))
        self.version += 1

    def stretch_at(self, drone: str, t_utc_ns: int) -> Stretches:
        """The stretch of a known path that holds a time; (1,)."""
        return stretches_of([self._tracks[self._index[drone]]], [t_utc_ns])

    def put_off(self, by_ns: int) -> None:
        """Have all known paths begin so much later."""
        for track in self._tracks.values():
            track.put_off(by_ns)
        self._at_hand.drop(np.array(list(self._tracks), np.int64))
        self.version += 1

    @property
    def signatures(self) -> Signatures:
        """What there is to sense of every drone, by its index."""
        return self._signatures.all

    @property
    def spans_ns(self) -> Ints:
        """Times of every drone's first and last sample, by its row, 0 for nobody; (n, 2)."""
        spans = [
            self._tracks.get(row, self._live).span_ns(row) if name != NOBODY else (0, 0)
            for row, name in enumerate(self.names)
        ]
        return np.array(spans, np.int64).reshape(-1, 2)

    def state_at(self, t_utc_ns: ArrayLike, drones: Ints | None = None) -> TruthState:
        """The drones that are there at a time, or of `drones` (m,) those there at times (m,)."""
        rows = np.arange(len(self.names)) if drones is None else drones
        t = np.full(rows.shape, t_utc_ns, np.int64)
        there, tau_s, coefficients = self._at_hand.at(t, rows, everybody=drones is None)
        if not there.all():
            rows, t, tau_s = rows[there], t[there], tau_s[there]
            coefficients = coefficients[:, :, there]
        position_ecef_m, velocity_ecef_m_s = (of(coefficients, tau_s).T for of in (place, slope))
        columns = {"drone": rows, "t_utc_ns": t, "position_ecef_m": position_ecef_m}
        return TruthState.holding({**columns, "velocity_ecef_m_s": velocity_ecef_m_s})

    def position_at(self, t_utc_ns: Ints, drones: Ints) -> Floats:
        """ECEF positions of drones (m,) at times (m,), metres; (m, 3), NaN for one not there."""
        return self._at_hand.position_at(t_utc_ns, drones)

    def positions_at(self, t_utc_ns: Ints) -> Floats:
        """ECEF positions of all drones at times (k,), metres; (k, n, 3), NaN for one not there."""
        return self._at_hand.positions_at(t_utc_ns, len(self.names))

    def _rows(self, drones: Sequence[str]) -> list[int]:
        """The rows of drones; one that is new gets the lowest that is free."""
        rows = [self._index.get(drone, -1) for drone in drones]
        if -1 not in rows:
            return rows
        if self._free:
            self.names = [*self.names]
        for drone in drones:
            if drone not in self._index:
                if self._free:
                    row = heappop(self._free)
                    self.names[row] = drone
                else:
                    row = len(self.names)
                    self.names.append(drone)
                    self._signatures.add_row()
                self._index[drone] = row
        self._at_hand.make_room(len(self.names))
        self._signatures.make_room(len(self.names))
        return [self._index[drone] for drone in drones]

    def _changed(self, rows: Ints, signatures: Signatures) -> None:
        """Samples of rows were added: the last of each row counts."""
        self._signatures.put(rows, signatures)
        self._at_hand.drop(rows)
        self.version += 1

    def _looked_up(self, t_utc_ns: Ints, rows: Ints) -> Stretches:
        """The stretches of rows (m,) that hold times (m,)."""
        if not self._tracks:
            return self._live.stretches_at(rows, t_utc_ns)
        chains = [self._tracks.get(row) for row in rows.tolist()]
        is_live = np.array([chain is None for chain in chains])
        found, live, others = (
            Stretches.none(len(rows)),
            *(np.flatnonzero(which) for which in (is_live, ~is_live)),
        )
        if len(live):
            found.put(live, self._live.stretches_at(rows[live], t_utc_ns[live]))
        if len(others):
            tracks = [chain for chain in chains if chain is not None]
            found.put(others, stretches_of(tracks, t_utc_ns[others].tolist()))
        return found


def _log(samples: FlightSamples, drones: Ints, into: LiveSamples, starts: Sequence[int]) -> None:
    """Log samples of drones, with the velocities that they tell, or that are fitted."""
    place = samples.latitude_deg, samples.longitude_deg
    position_ecef_m = geodetic_to_ecef(*place, samples.height_m)
    numbers = into.add(drones, samples.t_utc_ns, position_ecef_m, starts)
    known, axes = samples.velocity_enu_m_s, axes_enu(*place)
    to_fit = np.flatnonzero(np.isnan(known).any(axis=1))
    if len(to_fit):
        sigma_m = np.where(np.isnan(samples.sigma_m), DEFAULT_SIGMA_M, samples.sigma_m)
        x, y, z = into.fitted_velocity(numbers[to_fit], sigma_m[to_fit]).T
        turned, known = axes[:, :, to_fit], known.copy()
        fitted = (x * turned[:, 0] + y * turned[:, 1] + z * turned[:, 2]).T
        known[to_fit] = np.where(np.isnan(known[to_fit]), fitted, known[to_fit])
    east, north, up = known.T
    into.fly(numbers, (east * axes[0] + north * axes[1] + up * axes[2]).T)
