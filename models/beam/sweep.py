"""A rotating beam over moving drones: the instants at which it meets them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from plotfeed.models.beam.scan import Sector, time_after_share_ns
from plotfeed.models.frames import LocalFrame, wrap_180
from plotfeed.models.state import NS, Bools, Floats, Ints, TruthState, rows_where
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


@dataclass(frozen=True, slots=True)
class Sectors:
    """Several sectors, columns (m,), wherever one could stand."""

    start_ns: Ints
    end_ns: Ints
    start_deg: Floats
    end_deg: Floats

    @classmethod
    def of(cls, sectors: Sequence[Sector]) -> Self:
        """Columns of those sectors."""
        return cls(
            np.array([s.start_ns for s in sectors], np.int64),
            np.array([s.end_ns for s in sectors], np.int64),
            np.array([s.start_deg for s in sectors]),
            np.array([s.end_deg for s in sectors]),
        )

    def rows(self, which: Ints) -> Sectors:
        """Sectors at those indices, which may recur; (m,)."""
        return Sectors(
            self.start_ns[which], self.end_ns[which], self.start_deg[which], self.end_deg[which]
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
