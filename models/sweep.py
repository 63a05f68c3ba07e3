"""A rotating beam over moving drones: which it meets in the sectors to come, and exactly when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plotfeed.models.frames import LocalFrame
from plotfeed.models.scan import (
    Sector,
    Sectors,
    ahead_of_beam_deg,
    beam_meets,
    passes_between,
    time_after_share_ns,
)
from plotfeed.models.state import Floats, TruthState, rows_where
from plotfeed.models.truth import NS, Trajectories

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
