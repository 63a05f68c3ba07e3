"""Errors of a tracker's reports, each against where the drone was at the report's own time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from plotfeed.feeds.score.flights_told import Truths
from plotfeed.feeds.score.usable_tracks import UsableTracks
from plotfeed.models.frames import axes_enu, distance_m, ecef_to_geodetic
from plotfeed.models.scoring.associations import NOBODY
from plotfeed.models.scoring.consistency import nees
from plotfeed.models.scoring.grid_walk import Assigned
from plotfeed.models.scoring.ground import Level, along_enu
from plotfeed.models.scoring.track_grid import Grid, GridRows
from plotfeed.models.state import Columns, Floats, Ints


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


@dataclass(frozen=True, kw_only=True)
class ReportErrors(Columns):
    """Reports beside the drone that their track is of, (n,): those that are of one.

    Errors are east, north, up at the drone, (n, 3), with NaN for what the report does not tell.
    """

    t_utc_ns: Ints
    track: Ints
    drone: Ints
    report: Ints
    """Row among the usable reports."""
    error_enu_m: Floats
    distance_m: Floats
    """Over the ground, or in space where heights are scored."""
    velocity_error_enu_m_s: Floats
    true_velocity_enu_m_s: Floats
    covariance_m2: Floats
    nees: Floats
    latency_s: Floats


class Located(NamedTuple):
    """Flights and reports, with the grid and the level that both are on."""

    truths: Truths
    tracks: UsableTracks
    grid: Grid
    level: Level

    def beside(self, of: Assigned | GridRows, values: Ints) -> Ints:
        """What stands beside each report's track at the first step not before it, (n,)."""
        reports, count = self.tracks.reports, max(len(self.tracks.names), 1)
        keys, step = of.step * count + of.track, self.grid.at_or_after(reports.t_utc_ns)
        wanted = step * count + reports.track
        found = np.full(len(wanted), NOBODY)
        if len(keys):
            at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            good = (keys[at] == wanted) & (step >= 0) & (step < self.grid.steps)
            found[good] = values[at[good]]
        return found


def report_errors(located: Located, assigned: Assigned, dimensions: int) -> ReportErrors:
    """Errors of the reports of assigned tracks; a number in two places at once counts for none."""
    truths, tracks, _, level = located
    reports = tracks.reports
    drone = np.where(tracks.leaps, NOBODY, located.beside(assigned, assigned.drone))
    true = truth_beside(truths, drone, reports.t_utc_ns, level)
    there = np.flatnonzero((drone != NOBODY) & np.isfinite(true.point[:, 0]))
    error_m = along_enu(
        reports.point[there] - true.point[there],
        true.latitude_deg[there],
        true.longitude_deg[there],
    )
    covariance_m2 = tracks.covariance_m2[there]
    return ReportErrors(
        t_utc_ns=reports.t_utc_ns[there],
        track=reports.track[there],
        drone=drone[there],
        report=there,
        error_enu_m=error_m,
        distance_m=np.sqrt((error_m[:, :dimensions] ** 2).sum(axis=1)),
        velocity_error_enu_m_s=tracks.velocity_enu_m_s[there] - true.velocity_enu_m_s[there],
        true_velocity_enu_m_s=true.velocity_enu_m_s[there],
        covariance_m2=covariance_m2,
        nees=nees(error_m[:, :dimensions], covariance_m2[:, :dimensions, :dimensions]),
        latency_s=tracks.latency_s[there],
    )


def distances_to_nearest_m(located: Located, rows: GridRows, nearest: Ints) -> Floats:
    """How far over the ground each usable report is from the drone nearest to its track, (n,).

    `nearest` says which that is, for each of the grid's rows. NaN where no drone was there.
    """
    reports = located.tracks.reports
    drone = located.beside(rows, nearest)
    true = truth_beside(located.truths, drone, reports.t_utc_ns, located.level)
    return distance_m(reports.point[:, :3] - true.point[:, :3])


def truth_beside(truths: Truths, drone: Ints, t_utc_ns: Ints, level: Level) -> TrueStates:
    """Where each row's drone was at each row's time, (n,)."""
    place_m, velocity_m_s = np.full((len(drone), 3), np.nan), np.full((len(drone), 3), np.nan)
    order = np.argsort(drone, kind="stable")
    ends = np.searchsorted(drone[order], np.arange(len(truths.drones) + 1)).tolist()
    for path, a, b in zip(truths.paths, ends[:-1], ends[1:], strict=True):
        which = order[a:b]
        place_m[which], velocity_m_s[which] = path.states_at(t_utc_ns[which])
    return true_states(place_m, velocity_m_s, level)
