"""A rotating beam over moving drones: when its scans begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from plotfeed.models.beam.scan import (
    Sector,
    Sectors,
    ahead_of_beam_deg,
    beam_meets,
    next_sector,
    passes_between,
    sector_at,
    sector_within,
    time_after_share_ns,
)
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import LocalFrame
from plotfeed.models.state import NS, Floats, TruthState, rows_where
from plotfeed.models.truth import Trajectories

MOST_SIGMAS = 4.0


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

    def sector_at(self, t_utc_ns: int) -> Sector:
        """The sector under way at a time."""
        if self._chance is None:
            return sector_at(t_utc_ns, self.period_ns, self.sectors)
        scan = t_utc_ns // self.period_ns
        scan += (self._start_ns(scan + 1) <= t_utc_ns) - (self._start_ns(scan) > t_utc_ns)
        start_ns, end_ns = self._start_ns(scan), self._start_ns(scan + 1)
        index = (t_utc_ns - start_ns) * self.sectors // (end_ns - start_ns)
        return sector_within(start_ns, end_ns, scan, index, self.sectors)

    def next_sector(self, sector: Sector) -> Sector:
        """The one after it."""
        if self._chance is None:
            return next_sector(sector, self.period_ns, self.sectors)
        carry, index = divmod(sector.index + 1, self.sectors)
        scan = sector.scan + carry
        return sector_within(
            self._start_ns(scan), self._start_ns(scan + 1), scan, index, self.sectors
        )

    def turn(self, scan: int) -> Sector:
        """A whole scan of a rotating sensor, as if it were one sector."""
        start_ns, end_ns = self._start_ns(scan), self._start_ns(scan + 1)
        return Sector(scan, 0, start_ns, end_ns, 0.0, 360.0)

    def _drawn_start_ns(self, scan: int) -> int:
        if self._chance is None:
            return scan * self.period_ns
        off = float(self._chance.rng(Purpose.SCAN_TIMES, scan).standard_normal())
        off = min(max(off, -MOST_SIGMAS), MOST_SIGMAS)
        return scan * self.period_ns + round(off * self._jitter_ns)


CULLED_FROM = 32
"""Drones, of which those out of reach are left out before anything is computed of them."""
FASTEST_M_S = 1000.0
"""No drone comes nearer faster than that between one border and the next."""


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
    """At the end of each sector."""


def meetings(
    sectors: Sequence[Sector],
    frame: LocalFrame,
    trajectories: Trajectories,
    before: Border | None = None,
    reach_m: float = np.inf,
) -> Meetings:
    """Of sectors that follow each other; `before` is the border that the first begins with.

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
        t_utc_ns = time_after_share_ns(of_each, share)
        return frame.azimuths_deg(trajectories.position_at(t_utc_ns, drones))

    met_share = beam_meets(of_each, share[passed], azimuth_at)
    met = ~np.isnan(met_share)
    t_utc_ns = time_after_share_ns(of_each.rows(met), met_share[met])
    state = trajectories.state_at(t_utc_ns, drones[met])
    return Meetings(state.rows(np.argsort(state.t_utc_ns, kind="stable")), borders)
