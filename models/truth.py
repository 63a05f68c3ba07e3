"""Samples of telemetry and scripted paths in, the state of every drone at any time out.

Between two samples a drone follows the cubic with their positions and velocities (Hermite); past
the last it keeps its velocity until it is stale, and then it is gone. Everything is in ECEF, so
that one flight can be seen from any number of sites.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from heapq import heapify, heappop
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.frames import axes_enu, geodetic_to_ecef
from plotfeed.models.known_signatures import KnownSignatures
from plotfeed.models.known_track import KnownTrack, Segment, TrackChain
from plotfeed.models.live_samples import (
    MAX_FIT_SAMPLES,
    LiveSamples,
    Stretches,
    fit_velocity,
    within_speed,
)
from plotfeed.models.numerics import as_floats
from plotfeed.models.state import (
    NS,
    OTHER,
    Floats,
    Ints,
    PlaceState,
    Signature,
    Signatures,
    TruthState,
)
from plotfeed.models.stretches_at_hand import StretchesAtHand, place, slope

S = TypeVar("S", bound=PlaceState)

NOBODY = ""
"""The name in a row that is free for another drone."""

DEFAULT_SIGMA_M = 0.5
"""Taken for the position accuracy of telemetry that states none."""


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
        self.names: list[str] = []
        """By row. Another list as soon as a name in it would change; it may grow as it is."""
        self.version = 0
        """Changes with every sample: states computed under another version may be out of date."""
        self._index: dict[str, int] = {}
        self._free: list[int] = []
        """A heap of rows below the last one in use."""
        self._no_drones = 0
        self._live = LiveSamples(
            stale_after_ns=self.stale_after_ns,
            history_ns=round(history_s * NS),
            max_speed_m_s=max_speed_m_s,
        )
        self._tracks: dict[int, TrackChain] = {}
        """By row, of drones that are not live."""
        self._at_hand = StretchesAtHand(self._looked_up)
        self._signatures = KnownSignatures(tells_echoes=tells_echoes)

    def add_samples(
        self,
        drones: Sequence[str],
        t_utc_ns: Ints,
        *,
        latitude_deg: Floats,
        longitude_deg: Floats,
        height_m: Floats,
        velocity_enu_m_s: Floats,
        sigma_m: Floats,
        signatures: Signatures,
        starts: Sequence[int] = (),
    ) -> None:
        """Add samples (n,), each later than the last of its drone; heights above the ellipsoid.

        Velocity components (n, 3) that are NaN are fitted to the latest positions; `sigma_m`, the
        positions' standard deviation, says over how many, NaN where it is not known. Samples that
        no sensor can ask for any more are forgotten. It is the same whether samples are added
        together or one after the other. To samples at indices `starts` no path leads from before,
        and no velocity is fitted across.
        """
        rows = np.array(self._rows(drones), np.int64)
        position_ecef_m = geodetic_to_ecef(latitude_deg, longitude_deg, height_m)
        numbers = self._live.add(rows, t_utc_ns, position_ecef_m, starts)
        to_fit = np.flatnonzero(np.isnan(velocity_enu_m_s).any(axis=1))
        fitted = self._live.fitted_velocity(numbers[to_fit], _or_default(sigma_m[to_fit]))
        axes = axes_enu(latitude_deg, longitude_deg)
        self._live.fly(numbers, _velocity_ecef(axes, velocity_enu_m_s, to_fit, fitted))
        self._changed(rows, signatures)

    def add_flight(
        self,
        drone: str,
        t_utc_ns: Ints,
        *,
        latitude_deg: Floats,
        longitude_deg: Floats,
        height_m: Floats,
        velocity_enu_m_s: Floats,
        sigma_m: Floats,
        signature: Signature,
        starts: Sequence[int] = (),
    ) -> KnownTrack:
        """All samples (n,) of a drone that has none yet, as `add_samples`; none is forgotten."""
        position_ecef_m = geodetic_to_ecef(latitude_deg, longitude_deg, height_m)
        to_fit = np.flatnonzero(np.isnan(velocity_enu_m_s).any(axis=1))
        fitted = np.zeros((len(to_fit), 3))
        for i, (last, sigma) in enumerate(zip(to_fit, _or_default(sigma_m[to_fit]), strict=True)):
            start = max((k for k in starts if k <= last), default=0)
            near = slice(max(start, last + 1 - MAX_FIT_SAMPLES), last + 1)
            fitted[i] = fit_velocity(t_utc_ns[near], position_ecef_m[near], float(sigma))
        fitted = within_speed(fitted, self._max_speed_m_s)
        axes = axes_enu(latitude_deg, longitude_deg)
        velocity_ecef_m_s = _velocity_ecef(axes, velocity_enu_m_s, to_fit, fitted)
        track = KnownTrack(self.stale_after_ns, self.stale_after_ns, starts=frozenset(starts))
        for sample in zip(t_utc_ns.tolist(), position_ecef_m, velocity_ecef_m_s, strict=True):
            track.append(*sample)
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
        return len(self._index) - self._no_drones

    def add_path(
        self,
        drone: str,
        t_utc_ns: Sequence[int],
        position_ecef_m: ArrayLike,
        *,
        signature: Signature,
        repeat: bool = False,
    ) -> None:
        """A scripted path: constant velocity between knots (k, 3), gone after the last one."""
        track = KnownTrack.straight(t_utc_ns, as_floats(position_ecef_m), repeat=repeat)
        self.add_track(drone, track, signature)

    def add_track(self, drone: str, track: KnownTrack, signature: Signature) -> None:
        """All of a drone that has no samples yet."""
        rows = self._rows([drone])
        self._tracks[rows[0]] = TrackChain(track)
        self._no_drones += OTHER in drone
        self._changed(np.array(rows), Signatures.of_one(signature))

    def add_other(self, name: str) -> int:
        """Row of what is no drone and is nowhere: it only has plots."""
        if name not in self._index:
            self.add_track(name, KnownTrack.straight([0, 1], np.zeros((2, 3))), Signature())
        return self._index[name]

    def divert(self, drone: str, from_utc_ns: int, track: KnownTrack) -> None:
        """Have a drone of a known path leave it then for another."""
        row = self._index[drone]
        self._tracks[row].then(from_utc_ns, track)
        self._at_hand.drop(np.array([row]))
        self.version += 1

    def segment_at(self, drone: str, t_utc_ns: int) -> Segment:
        """The stretch of a known path that holds a time."""
        return self._tracks[self._index[drone]].segment_at(t_utc_ns)

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
        return self._at(t_utc_ns, drones, TruthState)

    def places_at(self, t_utc_ns: ArrayLike, drones: Ints | None = None) -> PlaceState:
        """`state_at` for who needs no velocities."""
        return self._at(t_utc_ns, drones, PlaceState)

    def _at(self, t_utc_ns: ArrayLike, drones: Ints | None, kind: type[S]) -> S:
        rows = np.arange(len(self.names)) if drones is None else drones
        t = np.full(rows.shape, t_utc_ns, np.int64)
        there, tau_s, coefficients = self._at_hand.at(t, rows, everybody=drones is None)
        if not there.all():
            rows, t, tau_s = rows[there], t[there], tau_s[there]
            coefficients = coefficients[:, :, there]
        columns = {"drone": rows, "t_utc_ns": t, "position_ecef_m": place(coefficients, tau_s).T}
        if issubclass(kind, TruthState):
            columns["velocity_ecef_m_s"] = slope(coefficients, tau_s).T
        return kind.holding(columns)

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
                self._index[drone] = self._new_row(drone)
        self._make_room(len(self.names))
        return [self._index[drone] for drone in drones]

    def _new_row(self, drone: str) -> int:
        if self._free:
            row = heappop(self._free)
            self.names[row] = drone
            return row
        self.names.append(drone)
        self._signatures.add_row()
        return len(self.names) - 1

    def _make_room(self, rows: int) -> None:
        self._at_hand.make_room(rows)
        self._signatures.make_room(rows)

    def _changed(self, rows: Ints, signatures: Signatures) -> None:
        """Samples of rows were added: the last of each row counts."""
        self._signatures.put(rows, signatures)
        self._at_hand.drop(rows)
        self.version += 1

    def _looked_up(self, t_utc_ns: Ints, rows: Ints) -> Stretches:
        """The segments of rows (m,) that hold times (m,)."""
        if not self._tracks:
            return self._live.stretches_at(rows, t_utc_ns)
        found, live = Stretches.none(len(rows)), []
        before: tuple[int, Segment] | None = None
        for i, (row, t) in enumerate(zip(rows.tolist(), t_utc_ns.tolist(), strict=True)):
            track = self._tracks.get(row)
            if track is None:
                live.append(i)
                continue
            if before is None or before[0] != row or not before[1].start_ns <= t < before[1].end_ns:
                before = row, track.segment_at(t)
            segment = before[1]
            found.start_ns[i], found.end_ns[i] = segment.start_ns, segment.end_ns
            found.alive[i] = segment.alive
            found.coefficients[:, :, i] = segment.coefficients
        if live:
            which = np.array(live)
            found.put(which, self._live.stretches_at(rows[which], t_utc_ns[which]))
        return found


def _or_default(sigma_m: Floats) -> Floats:
    return np.where(np.isnan(sigma_m), DEFAULT_SIGMA_M, sigma_m)


def _velocity_ecef(
    axes: Floats, velocity_enu_m_s: Floats, to_fit: Ints, fitted_ecef_m_s: Floats
) -> Floats:
    """Velocities (n, 3) in ECEF, by axes (3, 3, n); what is NaN in rows `to_fit` is as fitted."""
    known = velocity_enu_m_s
    if len(to_fit):
        (x, y, z), turned = fitted_ecef_m_s.T, axes[:, :, to_fit]
        known, fitted = known.copy(), (x * turned[:, 0] + y * turned[:, 1] + z * turned[:, 2]).T
        known[to_fit] = np.where(np.isnan(known[to_fit]), fitted, known[to_fit])
    east, north, up = known.T
    velocity: Floats = (east * axes[0] + north * axes[1] + up * axes[2]).T
    return velocity
