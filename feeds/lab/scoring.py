"""A tracker's reports beside the flights of a run: `score_run`, and its figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from plotfeed.feeds.lab.flights import Truths
from plotfeed.feeds.lab.track_reports import TracksRead, UsableTracks, usable_tracks
from plotfeed.models.frames import (
    LocalFrame,
    axes_enu,
    distance_m,
    ecef_to_geodetic,
    geodetic_to_ecef,
)
from plotfeed.models.state import Bools, Columns, Floats, Ints
from plotfeed.models.track_metrics import (
    GROUND,
    NOBODY,
    SPACE,
    Assigned,
    FlightPath,
    Grid,
    GridRows,
    Level,
    Segments,
    StepScores,
    Walked,
    WalkSettings,
    along_enu,
    covered_at,
    followed,
    independent_samples,
    lag_of,
    nees,
    nees_interval,
    on_grid,
    segments_of,
    stays_of,
    survival_quantile,
    swaps_of,
    walk,
)
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreSettings:
    """How tracks are scored; raises `PlotfeedError` for what cannot be."""

    cutoff_m: float = 50.0
    """Further from a drone than this, a track is none of it: c of GOSPA and OSPA, and the gate."""
    order: float = 2.0
    """p of GOSPA and OSPA."""
    switch_m: float = 25.0
    """What a switch of tracks costs in T-GOSPA."""
    step_s: float = 1.0
    """Of the grid on which sets are compared."""
    stale_s: float = 5.0
    """A track whose last report is older than this is not there."""
    dimensions: int = 0
    """2 for distances over the ground, 3 for those in space, 0 for 3 where all reports tell a
    height."""
    window_steps: int = 10
    """Over which whole tracks are compared by OSPA(2) and T-GOSPA; 0 for neither."""
    confirm_steps: int = 2
    """A track is a drone's from so many steps on at which that one was nearest."""
    end_steps: int = 3
    """And until it has been beyond the cut-off for so many."""
    future_s: float = 1.0
    """A report may be of a time so much later than it was received, for clocks differ."""
    max_speed_m_s: float = 150.0
    """Between two reports of a track nothing flies faster."""
    counts_tentative: bool = False
    """Whether tracks count that the tracker does not hold to be confirmed."""
    protected_deg: tuple[float, float] | None = None
    """Latitude and longitude of what is protected; without it the scene's site is."""

    def __post_init__(self) -> None:
        for name, (least, most) in BOUNDS.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise PlotfeedError(f"{name}: expected {least:g} to {most:g}, not {value:g}")
        if self.dimensions == 1:
            raise PlotfeedError("dimensions: expected 2 or 3, or 0 for what is told, not 1")
        if self.protected_deg is not None:
            latitude_deg, longitude_deg = self.protected_deg
            if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
                raise PlotfeedError("protected_deg: expected a latitude and a longitude in degrees")

    @classmethod
    def of(cls, values: dict[str, Any]) -> ScoreSettings:
        """Settings by their names, as a profile has them; raises `PlotfeedError`."""
        known = {each.name: each.default for each in fields(cls)}
        for name, value in values.items():
            if name not in known:
                raise PlotfeedError(f"{name}: expected one of {', '.join(known)}")
            usual = known[name]
            if name == "protected_deg":
                is_pair = isinstance(value, list | tuple) and len(value) == 2
                good = is_pair and all(_is_number(part) for part in value)
            elif isinstance(usual, bool):
                good = isinstance(value, bool)
            elif isinstance(usual, int):
                good = isinstance(value, int) and not isinstance(value, bool)
            else:
                good = _is_number(value)
            if not good:
                raise PlotfeedError(f"{name}: {str(value)[:40]!r} is not what is expected there")
        given: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in values.items()
        }
        return cls(**given)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


BOUNDS = {
    "cutoff_m": (0.1, 1e5),
    "order": (1.0, 8.0),
    "switch_m": (0.0, 1e5),
    "step_s": (0.05, 3600.0),
    "stale_s": (0.05, 3600.0),
    "dimensions": (0, 3),
    "window_steps": (0, 100),
    "confirm_steps": (1, 100),
    "end_steps": (1, 100),
    "future_s": (0.0, 3600.0),
    "max_speed_m_s": (1.0, 1e4),
}
"""Of numbers, least and most."""


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


NAN = math.nan


@dataclass(frozen=True, slots=True, kw_only=True)
class SetFigures:
    """Sets of tracks beside the drones, over all steps at which there was any of either.

    GOSPA, its parts, OSPA and T-GOSPA are means of order p over time: for p = 2 the squares of the
    parts add up to that of GOSPA.
    """

    gospa_m: float = NAN
    gospa_localisation_m: float = NAN
    gospa_missed_m: float = NAN
    gospa_false_m: float = NAN
    ospa_m: float = NAN
    ospa2_m: float = NAN
    t_gospa_m: float = NAN
    t_gospa_switching_m: float = NAN
    completeness: float = NAN
    """Of the drones that were there, the share that had a track."""
    ambiguity: float = NAN
    """Tracks for each drone that had any."""
    spuriousness: float = NAN
    """Share of tracks that were of no drone."""
    position_accuracy_m: float = NAN
    """Mean error of assigned tracks on the grid."""
    velocity_accuracy_m_s: float = NAN
    number_changes_per_h: float = NAN
    """For each hour in which a drone had a track."""
    longest_segment: float = NAN
    """Of the time of drones, the share that the longest stretch of one track of each covers."""
    breaks: float = NAN
    swaps: float = NAN


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportFigures:
    """Reports of tracks that are of a drone, each at its own time."""

    reports: float = 0.0
    position_mean_m: float = NAN
    position_rms_m: float = NAN
    position_p50_m: float = NAN
    position_p95_m: float = NAN
    position_max_m: float = NAN
    bias_east_m: float = NAN
    bias_north_m: float = NAN
    bias_up_m: float = NAN
    along_rms_m: float = NAN
    """Along the way of drones that fly faster than 1 m/s, and across it."""
    across_rms_m: float = NAN
    height_rms_m: float = NAN
    velocity_rms_m_s: float = NAN
    """Over the ground."""
    nees: float = NAN
    """Mean of NEES over its degrees of freedom: 1 for errors as large as is claimed."""
    nees_low: float = NAN
    """Between these it lies in 95 of 100 runs of an honest tracker."""
    nees_high: float = NAN
    lag_s: float = NAN
    lag_se_s: float = NAN
    latency_p50_s: float = NAN
    latency_p95_s: float = NAN
    latency_p99_s: float = NAN
    latency_max_s: float = NAN
    update_p50_s: float = NAN
    """From one report of a drone to the next."""
    update_p95_s: float = NAN


@dataclass(frozen=True, slots=True, kw_only=True)
class DroneScore:
    """One drone, while sensors looked at it."""

    drone: str
    cover_s: float
    completeness: float
    tracks: int
    breaks: int
    number_changes: int
    longest_s: float
    initiation_s: float
    """From when it came into cover to when its first report was received; NaN if it never was."""
    alert_m: float
    """How far it was then, over the ground, from what is protected; NaN likewise."""
    closest_m: float
    """As near as it came to what is protected."""
    position_rms_m: float
    position_p95_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorScore:
    """Drones while one sensor looked at them, whoever saw them."""

    sensor: str
    drones: int
    cover_s: float
    completeness: float
    position_rms_m: float
    position_p95_m: float
    longest_gap_s: float
    """The longest time for which a drone in its cover had no track."""


@dataclass(frozen=True, kw_only=True)
class OverTime:
    """What there was at each step, for charts and further figures."""

    t_utc_ns: Ints
    steps: StepScores
    there: Bools
    """Whether each drone was there, (steps, drones)."""
    tracked: Bools
    """Whether it had a track, (steps, drones)."""
    stays_utc_ns: Sequence[Sequence[tuple[int, int]]]
    """Of each drone: from when to when it was there."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """The score of a tracker for one run."""

    scene: str
    source: str
    """Where tracks were found."""
    start_utc_ns: int
    end_utc_ns: int
    settings: ScoreSettings
    dimensions: int
    """2 for distances over the ground, 3 for those in space."""
    as_stamped: SetFigures
    """Every report counts from the time that it is of, whenever it came."""
    as_known: SetFigures | None
    """Reports count from when they were received; None where that is not known."""
    reports: ReportFigures
    drones: Sequence[DroneScore]
    sensors: Sequence[SensorScore]
    tracks: int
    false_tracks: int
    """That were of no drone ever."""
    initiation_median_s: float
    """By Kaplan and Meier: drones that never had a track are in it; infinite if most had none."""
    alert_median_m: float
    """Likewise; 0 if most never were seen."""
    never_tracked: int
    silent_s: float
    """From the last report to the end, if drones were there then."""
    left_out: Mapping[str, int]
    """Reports that were left out or are odd, by the reason."""
    failure: str
    """How the tracker failed; empty if it did not."""
    notes: Sequence[str]
    errors: ReportErrors
    over_time: OverTime
    nearest_m: Floats
    """From each usable report to the drone that was nearest, over the ground; NaN for none."""

    @property
    def distances(self) -> str:
        """Which distances are meant throughout, in words."""
        return "over the ground" if self.dimensions == 2 else "in space"

    def figures(self) -> dict[str, float]:
        """All figures by their names, NaN for what is not known: the same names for every run.

        Those of what was known at the time begin with `known_`.
        """
        known = asdict(self.as_known or SetFigures())
        return {
            **asdict(self.as_stamped),
            **{f"known_{name}": value for name, value in known.items()},
            **asdict(self.reports),
            "initiation_median_s": self.initiation_median_s,
            "alert_median_m": self.alert_median_m,
            "drones": float(len(self.drones)),
            "never_tracked": float(self.never_tracked),
            "tracks": float(self.tracks),
            "false_tracks": float(self.false_tracks),
            "left_out": float(sum(self.left_out.values())),
            "silent_s": self.silent_s,
        }


FIGURE_NAMES = tuple(
    [each.name for each in fields(SetFigures)]
    + [f"known_{each.name}" for each in fields(SetFigures)]
    + [each.name for each in fields(ReportFigures)]
    + ["initiation_median_s", "alert_median_m", "drones", "never_tracked", "tracks"]
    + ["false_tracks", "left_out", "silent_s"]
)
"""As `Score.figures` has them."""


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
    protected = truths.site
    if how.protected_deg is not None:
        protected = LocalFrame(*how.protected_deg, 0.0)
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


def _p95(values: Floats) -> float:
    return float(np.quantile(values, 0.95)) if len(values) else float("nan")


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
    tracked = np.zeros_like(field.there)
    tracked[walked.assigned.step, walked.assigned.drone] = True
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
