"""The score by drone, and by the sensors that looked at them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plotfeed.feeds.score.flights_told import Truths
from plotfeed.feeds.score.report_errors import ReportErrors
from plotfeed.feeds.score.score_figures import DroneScore, SensorScore
from plotfeed.feeds.score.score_settings import ScoreSettings
from plotfeed.feeds.score.usable_tracks import UsableTracks
from plotfeed.models.frames import LocalFrame, distance_m, ecef_to_geodetic, geodetic_to_ecef
from plotfeed.models.scoring.associations import Segments, followed
from plotfeed.models.scoring.flight_paths import FlightPath, covered_at
from plotfeed.models.scoring.track_grid import Grid, GridRows
from plotfeed.models.state import Bools, Floats
from plotfeed.proto.utc import NS


def drone_scores(
    truths: Truths,
    *,
    usable: UsableTracks,
    grid: Grid,
    rows: GridRows,
    there: Bools,
    tracked: Bools,
    segments: Segments,
    errors: ReportErrors,
    how: ScoreSettings,
) -> list[DroneScore]:
    """Each drone's own score, in their order."""
    protected = _protected(truths, how)
    row_keys = rows.step * max(len(usable.names), 1) + rows.track
    found = []
    step_s = grid.step_ns / NS
    for number, (name, path) in enumerate(zip(truths.drones, truths.paths, strict=True)):
        steps = np.flatnonzero(there[:, number])
        own = segments.rows(segments.drone == number)
        following = followed(own, steps)
        covered = int(np.count_nonzero(tracked[steps, number]))
        initiation_s, alert_m = float("nan"), float("nan")
        if len(own):
            first = int(np.lexsort((own.track, own.first))[0])
            key = int(own.first[first]) * max(len(usable.names), 1) + int(own.track[first])
            report = int(rows.report[np.searchsorted(row_keys, key)])
            known_ns = int(usable.reports.known_utc_ns[report])
            initiation_s = max((known_ns - int(path.t_utc_ns[0])) / NS, 0.0)
            alert_m = _distance_at(path, known_ns, int(usable.reports.t_utc_ns[report]), protected)
        apart_m = errors.distance_m[errors.drone == number]
        found.append(
            DroneScore(
                drone=name,
                cover_s=len(steps) * step_s,
                completeness=covered / len(steps) if len(steps) else float("nan"),
                tracks=following.tracks,
                breaks=following.breaks,
                number_changes=following.number_changes,
                longest_s=following.longest_steps * step_s,
                initiation_s=initiation_s,
                alert_m=alert_m,
                closest_m=_closest_m(path, protected),
                position_rms_m=_rms(apart_m),
                position_p95_m=_p95(apart_m),
            )
        )
    return found


def sensor_scores(
    truths: Truths, grid: Grid, there: Bools, tracked: Bools, errors: ReportErrors
) -> list[SensorScore]:
    """Drones in the cover of each sensor, in their order; the gap is that between its looks."""
    found, step_s, t_ns = [], grid.step_ns / NS, grid.t_utc_ns
    for number, name in enumerate(truths.sensors):
        inside = np.zeros_like(there)
        of_errors = np.zeros(len(errors), np.bool_)
        for drone, path in enumerate(truths.paths):
            looks_ns = truths.looks_utc_ns.get((drone, number))
            if looks_ns is None:
                continue
            inside[:, drone] = covered_at(looks_ns, t_ns, path.gap_ns) & there[:, drone]
            own = np.flatnonzero(errors.drone == drone)
            of_errors[own] = covered_at(looks_ns, errors.t_utc_ns[own], path.gap_ns)
        apart_m, cover = errors.distance_m[of_errors], int(inside.sum())
        found.append(
            SensorScore(
                sensor=name,
                drones=int(np.count_nonzero(inside.any(axis=0))),
                cover_s=cover * step_s,
                completeness=int((inside & tracked).sum()) / cover if cover else float("nan"),
                position_rms_m=_rms(apart_m),
                position_p95_m=_p95(apart_m),
                longest_gap_s=_longest(inside & ~tracked) * step_s,
            )
        )
    return found


def _longest(missing: Bools) -> int:
    """The most steps in a row at which a drone has no track, (steps, drones)."""
    edge = np.zeros((1, missing.shape[1]), np.int8)
    edges = np.diff(np.concatenate([edge, missing.astype(np.int8), edge]), axis=0).T
    begins, ends = np.nonzero(edges == 1)[1], np.nonzero(edges == -1)[1]
    return int((ends - begins).max()) if len(begins) else 0


def _protected(truths: Truths, how: ScoreSettings) -> LocalFrame | None:
    if how.protected_deg is not None:
        return LocalFrame(*how.protected_deg, 0.0)
    return truths.site


def _distance_at(
    path: FlightPath, known_ns: int, stamped_ns: int, protected: LocalFrame | None
) -> float:
    """How far the drone was when it was known, or else when it was seen."""
    if protected is None:
        return float("nan")
    place_m, _ = path.states_at(np.array([known_ns, stamped_ns]))
    each_m = _over_ground_m(place_m, protected)
    return float(each_m[0] if np.isfinite(each_m[0]) else each_m[1])


def _closest_m(path: FlightPath, protected: LocalFrame | None) -> float:
    if protected is None or not len(path.t_utc_ns):
        return float("nan")
    return float(_over_ground_m(path.position_ecef_m, protected).min())


def _over_ground_m(place_m: Floats, protected: LocalFrame) -> Floats:
    latitude_deg, longitude_deg, _ = ecef_to_geodetic(place_m)
    level_m = geodetic_to_ecef(latitude_deg, longitude_deg, 0.0)
    to_m = geodetic_to_ecef(protected.latitude_deg, protected.longitude_deg, 0.0)
    return distance_m(level_m - to_m)


def _rms(values: Sequence[float] | Floats) -> float:
    each = np.asarray(values)
    return float(np.sqrt((each**2).mean())) if len(each) else float("nan")


def _p95(values: Floats) -> float:
    return float(np.quantile(values, 0.95)) if len(values) else float("nan")
