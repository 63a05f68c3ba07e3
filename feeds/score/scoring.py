"""A tracker's reports beside the flights of a run: `score_run`.

    truths = read_truths(Path("run.mcap"))                      # flights_told
    tracks = read_tracks(Path("tracks.csv"), scene)             # track_files
    score = score_run(truths, tracks, ScoreSettings(cutoff_m=50.0))
    score.figures()["gospa_m"]

Whoever follows a session takes entries of its ledger into a `FlightsTally` and messages of the
tracker into a `TrackTable` by `take_message`, and asks for `truths()` and `read()` when they like.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plotfeed.feeds.score.drone_scores import drone_scores, sensor_scores
from plotfeed.feeds.score.flights_told import Truths
from plotfeed.feeds.score.report_errors import (
    Located,
    ReportErrors,
    TrueStates,
    distances_to_nearest_m,
    report_errors,
    true_states,
)
from plotfeed.feeds.score.score_figures import OverTime, ReportFigures, Score, SetFigures
from plotfeed.feeds.score.score_settings import ScoreSettings
from plotfeed.feeds.score.track_table import TracksRead
from plotfeed.feeds.score.usable_tracks import UsableTracks, usable_tracks
from plotfeed.models.scoring.associations import Segments, followed, segments_of, swaps_of
from plotfeed.models.scoring.consistency import (
    independent_samples,
    lag_of,
    nees_interval,
    survival_quantile,
)
from plotfeed.models.scoring.flight_paths import stays_of
from plotfeed.models.scoring.grid_walk import Walked, WalkSettings, walk
from plotfeed.models.scoring.ground import GROUND, SPACE, Level
from plotfeed.models.scoring.track_grid import Grid, GridRows, on_grid
from plotfeed.models.state import Bools, Floats
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

MOST_CELLS = 50_000_000
"""Steps times drones."""
SILENT_S, SILENT_TIMES = 10.0, 5.0
"""A tracker of which nothing comes for so long, and for so many times as long as it is usual from
one report to the next (95 %), has ended."""
LEAST_SPEED_M_S = 1.0
"""Below it a drone has no way along which to err."""


def score_run(truths: Truths, tracks: TracksRead, settings: ScoreSettings | None = None) -> Score:
    """Score a tracker; raises `PlotfeedError` if no drone was looked at, or for a run too long.

    Whatever the tracker did, there is a score: what of its reports cannot be used is counted.
    """
    how = settings or ScoreSettings()
    field = _field(truths, how)
    usable = usable_tracks(
        tracks,
        field.span_utc_ns,
        field.level,
        future_s=how.future_s,
        max_speed_m_s=how.max_speed_m_s,
        counts_tentative=how.counts_tentative,
    )
    dimensions = how.dimensions or (3 if usable.has_heights else 2)
    rows, walked = _walked(field, usable, how, dimensions, as_known=False)
    segments = _segments(walked, how)
    stamped = _set_figures(field, usable, rows=rows, walked=walked, how=how)
    known = None
    if usable.has_received:
        other_rows, other = _walked(field, usable, how, dimensions, as_known=True)
        known = _set_figures(field, usable, rows=other_rows, walked=other, how=how)
    located = Located(truths, usable, field.grid, field.level)
    errors = report_errors(located, walked.assigned, dimensions)
    tracked = _tracked(field, walked)
    drones = drone_scores(
        truths,
        usable=usable,
        grid=field.grid,
        rows=rows,
        there=field.there,
        tracked=tracked,
        segments=segments,
        errors=errors,
        how=how,
    )
    silent_s = _silent_s(field, usable)
    seen = np.array([np.isfinite(each.initiation_s) for each in drones], np.bool_)
    waited_s = np.where(seen, [d.initiation_s for d in drones], [d.cover_s for d in drones])
    # Those that were never seen would have been nearer than they ever came.
    nearness_m = -np.where(seen, [d.alert_m for d in drones], [d.closest_m for d in drones])
    return Score(
        scene=truths.scene,
        source=tracks.source,
        start_utc_ns=field.span_utc_ns[0],
        end_utc_ns=field.span_utc_ns[1],
        settings=how,
        dimensions=dimensions,
        as_stamped=stamped,
        as_known=known,
        reports=report_figures(errors, dimensions),
        drones=drones,
        sensors=sensor_scores(truths, field.grid, field.there, tracked, errors),
        tracks=len(usable.names),
        false_tracks=len(usable.names) - len(np.unique(segments.track)),
        initiation_median_s=survival_quantile(waited_s, seen),
        alert_median_m=_nearer(survival_quantile(nearness_m, seen)),
        never_tracked=int(np.count_nonzero(~seen)),
        silent_s=silent_s,
        left_out=usable.counts,
        failure=_failure(tracks, usable, silent_s),
        notes=truths.notes,
        errors=errors,
        over_time=OverTime(
            t_utc_ns=field.grid.t_utc_ns,
            steps=walked.steps,
            there=field.there,
            tracked=tracked,
            stays_utc_ns=[stays_of(p.t_utc_ns, p.gap_ns) for p in truths.paths],
        ),
        nearest_m=distances_to_nearest_m(located, rows, walked.nearest),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Field:
    """The flights on the grid."""

    grid: Grid
    span_utc_ns: tuple[int, int]
    level: Level
    states: TrueStates
    """(steps, drones, ...)."""
    there: Bools


def _field(truths: Truths, how: ScoreSettings) -> _Field:
    times = [path.t_utc_ns for path in truths.paths if len(path.t_utc_ns) > 1]
    if not times:
        raise PlotfeedError("no flight to score against: the ledger tells of no look at a drone")
    span = min(int(t[0]) for t in times), max(int(t[-1]) for t in times)
    step_ns = round(how.step_s * NS)
    first = -(-span[0] // step_ns)
    steps = max(span[1] // step_ns - first + 1, 1)
    if steps * len(truths.drones) > MOST_CELLS:
        raise PlotfeedError(
            f"{steps} steps of {how.step_s:g} s for {len(truths.drones)} drones are too many: "
            "step_s can be longer, or the recording cut"
        )
    grid = Grid(start_utc_ns=first * step_ns, step_ns=step_ns, steps=steps)
    found = [path.states_at(grid.t_utc_ns) for path in truths.paths]
    place_m, velocity_m_s = (np.concatenate(part) for part in zip(*found, strict=True))
    heights_m = true_states(place_m, velocity_m_s, Level(0.0)).point[:, 3]
    known_m = heights_m[np.isfinite(heights_m)]
    level = Level(float(np.mean(known_m)) if len(known_m) else 0.0)
    states, many = true_states(place_m, velocity_m_s, level), len(truths.paths)
    by_step = TrueStates(
        point=states.point.reshape(many, steps, 4).swapaxes(0, 1),
        velocity_enu_m_s=states.velocity_enu_m_s.reshape(many, steps, 3).swapaxes(0, 1),
        latitude_deg=states.latitude_deg.reshape(many, steps).T,
        longitude_deg=states.longitude_deg.reshape(many, steps).T,
    )
    there = np.isfinite(by_step.point[:, :, 0])
    return _Field(grid=grid, span_utc_ns=span, level=level, states=by_step, there=there)


def _walked(
    field: _Field, usable: UsableTracks, how: ScoreSettings, dimensions: int, *, as_known: bool
) -> tuple[GridRows, Walked]:
    rows = on_grid(usable.reports, field.grid, how.stale_s, as_known=as_known)
    settings = WalkSettings(
        cutoff_m=how.cutoff_m,
        order=how.order,
        switch_m=how.switch_m,
        columns=GROUND if dimensions == 2 else SPACE,
        confirm_steps=how.confirm_steps,
        end_steps=how.end_steps,
        window_steps=how.window_steps,
    )
    return rows, walk(field.states.point, field.there, rows, len(usable.names), settings)


def _segments(walked: Walked, how: ScoreSettings) -> Segments:
    assigned = walked.assigned
    return segments_of(assigned.track, assigned.drone, assigned.step, how.end_steps)


def _tracked(field: _Field, walked: Walked) -> Bools:
    tracked = np.zeros_like(field.there)
    tracked[walked.assigned.step, walked.assigned.drone] = True
    return tracked


def _set_figures(
    field: _Field,
    usable: UsableTracks,
    *,
    rows: GridRows,
    walked: Walked,
    how: ScoreSettings,
) -> SetFigures:
    steps, assigned, segments = walked.steps, walked.assigned, _segments(walked, how)
    some = (steps.drones > 0) | (steps.tracks > 0)
    count, power = max(int(np.count_nonzero(some)), 1), 1.0 / how.order

    def mean(values: Floats) -> float:
        return float((values.sum() / count) ** power)

    parts = (steps.localisation, steps.missed, steps.false)
    windows = walked.window_parts
    velocity = usable.velocity_enu_m_s[rows.report[assigned.row]]
    true_velocity = field.states.velocity_enu_m_s[assigned.step, assigned.drone]
    apart_m_s = np.hypot(*(velocity - true_velocity)[:, :2].T)
    told = apart_m_s[np.isfinite(apart_m_s)]
    followings = [
        followed(segments.rows(segments.drone == drone), np.flatnonzero(field.there[:, drone]))
        for drone in range(field.there.shape[1])
    ]
    tracked_h = int(steps.tracked.sum()) * field.grid.step_ns / NS / 3600
    changes = sum(each.number_changes for each in followings)
    return SetFigures(
        gospa_m=mean(sum(parts, np.zeros(len(some)))),
        gospa_localisation_m=mean(parts[0]),
        gospa_missed_m=mean(parts[1]),
        gospa_false_m=mean(parts[2]),
        ospa_m=mean(steps.ospa_m**how.order),
        ospa2_m=_over_windows(walked.ospa2_m**how.order, len(windows), power),
        t_gospa_m=_over_windows(windows.sum(axis=1), count if len(windows) else 0, power),
        t_gospa_switching_m=_over_windows(windows[:, 3], count if len(windows) else 0, power),
        completeness=_ratio(steps.tracked.sum(), steps.drones.sum()),
        ambiguity=_ratio(steps.assigned.sum(), steps.tracked.sum()),
        spuriousness=_ratio((steps.tracks - steps.assigned).sum(), steps.tracks.sum()),
        position_accuracy_m=_ratio(assigned.distance_m.sum(), len(assigned)),
        velocity_accuracy_m_s=_ratio(told.sum(), len(told)),
        number_changes_per_h=_ratio(changes, tracked_h),
        longest_segment=_ratio(sum(e.longest_steps for e in followings), steps.drones.sum()),
        breaks=float(sum(each.breaks for each in followings)),
        swaps=float(swaps_of(segments)),
    )


def _over_windows(values: Floats, of: int, power: float) -> float:
    return float((values.sum() / of) ** power) if of else float("nan")


def _ratio(part: float, of: float) -> float:
    return float(part) / float(of) if of else float("nan")


def report_figures(errors: ReportErrors, dimensions: int) -> ReportFigures:
    """Figures of the errors of reports; of none, NaN."""
    if not len(errors):
        return ReportFigures()
    distance_m, error_m = errors.distance_m, errors.error_enu_m
    east, north = errors.true_velocity_enu_m_s[:, 0], errors.true_velocity_enu_m_s[:, 1]
    speed = np.hypot(east, north)
    moves = speed > LEAST_SPEED_M_S
    along_m = (error_m[moves, 0] * east[moves] + error_m[moves, 1] * north[moves]) / speed[moves]
    across_m = (error_m[moves, 0] * north[moves] - error_m[moves, 1] * east[moves]) / speed[moves]
    p50_m, p95_m = np.quantile(distance_m, [0.5, 0.95]).tolist()
    tested = np.isfinite(errors.nees)
    low, high = float("nan"), float("nan")
    if tested.any():
        order = np.lexsort((errors.t_utc_ns[tested], errors.track[tested]))
        samples = independent_samples(errors.nees[tested][order], errors.track[tested][order])
        low, high = (bound / dimensions for bound in nees_interval(samples, dimensions))
    has_all = len(errors) == int(np.count_nonzero(tested))
    covariance_m2 = errors.covariance_m2[:, :dimensions, :dimensions] if has_all else None
    velocity_m_s = errors.true_velocity_enu_m_s[:, :dimensions]
    lag = lag_of(error_m[:, :dimensions], velocity_m_s, covariance_m2)
    latency = errors.latency_s[np.isfinite(errors.latency_s)]
    late = np.quantile(latency, [0.5, 0.95, 0.99, 1.0]) if len(latency) else [float("nan")] * 4
    between = updates_s(errors)
    often = np.quantile(between, [0.5, 0.95]) if len(between) else [float("nan")] * 2
    up_m = error_m[np.isfinite(error_m[:, 2]), 2]
    speeds_m_s = np.hypot(*errors.velocity_error_enu_m_s[:, :2].T)
    return ReportFigures(
        reports=float(len(errors)),
        position_mean_m=float(distance_m.mean()),
        position_rms_m=_rms(distance_m),
        position_p50_m=p50_m,
        position_p95_m=p95_m,
        position_max_m=float(distance_m.max()),
        bias_east_m=float(error_m[:, 0].mean()),
        bias_north_m=float(error_m[:, 1].mean()),
        bias_up_m=float(up_m.mean()) if len(up_m) else float("nan"),
        along_rms_m=_rms(along_m),
        across_rms_m=_rms(across_m),
        height_rms_m=_rms(up_m),
        velocity_rms_m_s=_rms(speeds_m_s[np.isfinite(speeds_m_s)]),
        nees=float(errors.nees[tested].mean()) / dimensions if tested.any() else float("nan"),
        nees_low=low,
        nees_high=high,
        lag_s=lag.tau_s,
        lag_se_s=lag.se_s,
        latency_p50_s=float(late[0]),
        latency_p95_s=float(late[1]),
        latency_p99_s=float(late[2]),
        latency_max_s=float(late[3]),
        update_p50_s=float(often[0]),
        update_p95_s=float(often[1]),
    )


def updates_s(errors: ReportErrors) -> Floats:
    """Times from one report of a drone to the next of the same, seconds, by whatever track."""
    order = np.lexsort((errors.t_utc_ns, errors.drone))
    same = np.diff(errors.drone[order]) == 0
    found: Floats = np.diff(errors.t_utc_ns[order])[same] / NS
    return found


def _rms(values: Floats) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else float("nan")


def _nearer(value: float) -> float:
    """A distance of what was counted backwards; never is at no distance."""
    return max(-value, 0.0) if np.isfinite(value) else 0.0 if value > 0 else float("nan")


def _silent_s(field: _Field, usable: UsableTracks) -> float:
    """Seconds from the last report to the end of the flights."""
    if not len(usable.reports):
        return (field.span_utc_ns[1] - field.span_utc_ns[0]) / NS
    return max((field.span_utc_ns[1] - int(usable.reports.t_utc_ns.max())) / NS, 0.0)


def _failure(tracks: TracksRead, usable: UsableTracks, silent_s: float) -> str:
    if tracks.crashed:
        return tracks.crashed
    if not len(tracks.reports):
        return "the tracker reported no tracks"
    if not len(usable.reports):
        return "none of the tracker's reports can be used"
    times_s = np.unique(usable.reports.t_utc_ns) / NS
    usual_s = float(np.quantile(np.diff(times_s), 0.95)) if len(times_s) > 1 else 0.0
    if silent_s > max(SILENT_S, SILENT_TIMES * usual_s):
        return f"the tracker's last report is {silent_s:.1f} s before the end"
    return ""
