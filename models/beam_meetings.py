"""Which drones the beams of rotating sensors meet in their sectors, and exactly when."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plotfeed.models.beam import Sector, Sectors, time_after_share_ns
from plotfeed.models.frames import Axes, frames_at, rows_about, wrap_180
from plotfeed.models.known_rows import trimmed
from plotfeed.models.state import NS, Bools, Floats, Ints, TruthState
from plotfeed.models.truth import Trajectories

ON_BEAM_DEG = 1e-7
"""How near a look's instant brings beam and target."""
LEAP_DEG = 5.0
"""A target that never comes as near as this leapt over the beam: it flew over the sensor."""
MAX_STEPS = 50
CULLED_FROM = 32
"""Drones, of which those out of reach are left out before anything is computed of them."""
FASTEST_M_S = 1000.0
"""Speed that no drone exceeds between one border and the next."""
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
        self.azimuth_deg = np.full((sensors, 0), np.nan)
        """NaN where that is not known; (sensors, drones)."""

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


@dataclass(frozen=True, slots=True)
class Meetings:
    """What beams meet in several sectors: drones by sensor, and then in the order of time."""

    truth: TruthState
    row: Ints
    """The sector of each, by its row; (n,)."""


def meetings(
    sectors: Sectors,
    frames: Axes,
    trajectories: Trajectories,
    borders: Borders | None = None,
    reach_m: float | Floats = np.inf,
) -> Meetings:
    """Whom beams meet in sectors; those of one sensor follow each other.

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
        return Meetings(NOBODY, row)
    drones = about[of_about]
    of_each = sectors.rows(row)
    frame_of_each = frames_at(frames, of_each.sensor)

    def azimuth_at(share: Floats) -> Floats:
        t_utc_ns = time_after_share_ns(of_each.start_ns, of_each.end_ns, share)
        return frame_of_each.azimuths_deg(trajectories.position_at(t_utc_ns, drones))

    met_share = beam_meets(of_each, share[passed], azimuth_at)
    met = ~np.isnan(met_share)
    if not met.all():
        of_each, met_share, row, drones = of_each.rows(met), met_share[met], row[met], drones[met]
    t_utc_ns = time_after_share_ns(of_each.start_ns, of_each.end_ns, met_share)
    order = np.lexsort((t_utc_ns, of_each.sensor))
    return Meetings(trajectories.state_at(t_utc_ns[order], drones[order]), row[order])


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
    if everybody < CULLED_FROM:
        of_all = frames_at(frames, sensor[:, None])
        end_deg = of_all.azimuths_deg(positions_ecef_m[at_end])
    else:
        between_s = (sectors.end_ns - sectors.start_ns) / NS
        within_m = (reach_m[sensor] if reach_m.ndim else reach_m) + FASTEST_M_S * between_s
        about = rows_about(frames_at(frames, sensor), positions_ecef_m, within_m)
        positions_ecef_m = positions_ecef_m[:, about]
        near = frames_at(frames, sensor[:, None]).has_within(
            positions_ecef_m[at_end], within_m[:, None]
        )
        row, column = np.nonzero(near)
        end_deg = np.full((len(sectors), len(about)), np.nan)
        end_deg[row, column] = frames_at(frames, sensor[row]).azimuths_deg(
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
            taken[row, column] = frames_at(frames, of_first[row]).azimuths_deg(
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
