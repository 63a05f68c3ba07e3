"""A tracker's reports beside the flights of a run: its score, and its figures."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from plotfeed.feeds.lab.flights import Truths
from plotfeed.feeds.recording.recorded_tracks import UNKNOWN_NS, TracksRead, is_place
from plotfeed.feeds.scene.fields import SceneTable
from plotfeed.models.frames import LocalFrame, distance_m, ecef_to_geodetic, geodetic_to_ecef
from plotfeed.models.state import Bools, Floats, Ints
from plotfeed.models.track_figures import ReportErrors, report_figures, set_figures
from plotfeed.models.track_metrics import (
    GROUND,
    NOBODY,
    SPACE,
    Assigned,
    Grid,
    GridRows,
    Level,
    Segments,
    TrackReports,
    TrueStates,
    Walked,
    along_enu,
    covered_at,
    followed,
    nees,
    on_grid,
    rates,
    rates_by_differences,
    segments_of,
    stays_of,
    stretches,
    survival_quantile,
    true_states,
    walk,
)
from plotfeed.models.verdicts import FigureSamples
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

Pair = Annotated[tuple[float, float], Field(strict=False)]


class ScoreSettings(SceneTable):
    """How tracks are scored, and which of them; raises `ValidationError` for what cannot be."""

    cutoff_m: Annotated[float, Field(ge=0.1, le=1e5)] = 50.0
    """Further from a drone than this, a track is none of it: c of GOSPA and OSPA, and the gate."""
    order: Annotated[float, Field(ge=1, le=8)] = 2.0
    """p of GOSPA and OSPA."""
    switch_m: Annotated[float, Field(ge=0, le=1e5)] = 25.0
    """What a switch of tracks costs in T-GOSPA."""
    step_s: Annotated[float, Field(ge=0.05, le=3600)] = 1.0
    """Of the grid on which sets are compared."""
    stale_s: Annotated[float, Field(ge=0.05, le=3600)] = 5.0
    """A track whose last report is older than this is not there."""
    dimensions: Annotated[int, Field(ge=2, le=3)] = 2
    """2 for distances over the ground, 3 for those in space, of reports that tell a height."""
    window_steps: Annotated[int, Field(ge=0, le=100)] = 10
    """Over which whole tracks are compared by OSPA(2) and T-GOSPA; 0 for neither."""
    confirm_steps: Annotated[int, Field(ge=1, le=100)] = 2
    """A track is a drone's from so many steps on at which that one was nearest."""
    end_steps: Annotated[int, Field(ge=1, le=100)] = 3
    """And until it has been beyond the cut-off, or nearer to another, for so many."""
    future_s: Annotated[float, Field(ge=0, le=3600)] = 1.0
    """A report may be of a time so much later than it was received, for clocks differ."""
    max_speed_m_s: Annotated[float, Field(ge=1, le=1e4)] = 150.0
    """Between two reports of a track nothing flies faster."""
    counts_tentative: bool = False
    """Whether tracks count that the tracker does not hold to be confirmed."""
    protected_deg: Pair | None = None
    """Latitude and longitude of what is protected; without it the scene's site is."""
    from_s: Annotated[float, Field(ge=0)] = 0.0
    """Scored is what is from so many seconds after the first place of a drone on..."""
    until_s: Annotated[float, Field(gt=0)] | None = None
    """... until so many."""
    sector_deg: Pair | None = None
    """Scored is what lies between these azimuths, clockwise, from what is protected..."""
    within_m: Annotated[float, Field(gt=0)] | None = None
    """... and at most so far from it."""
    leave_out: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Drones that do not count, nor do tracks of theirs."""

    @model_validator(mode="after")
    def _is_on_earth(self) -> Self:
        latitude_deg, longitude_deg = self.protected_deg or (0.0, 0.0)
        if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
            raise ValueError("protected_deg: expected a latitude and a longitude in degrees")
        return self

    @property
    def leaves_out(self) -> bool:
        """Whether there is anything that does not count."""
        return self != self.model_copy(
            update={"from_s": 0.0, "until_s": None, "sector_deg": None, "within_m": None,
                    "leave_out": ()}
        )  # fmt: skip

    def place(self, truths: Truths) -> LocalFrame | None:
        """Where what is protected is."""
        return truths.site if self.protected_deg is None else LocalFrame(*self.protected_deg, 0.0)

    def counts(self, truths: Truths, t_utc_ns: Ints, ecef_m: Floats) -> Bools:
        """Whether what is at a time at a place, (n,) and (n, 3), lies within what is scored."""
        since_s = (t_utc_ns - truths.start_utc_ns) / NS
        found: Bools = (since_s >= self.from_s) & ~(since_s > (self.until_s or np.inf))
        if self.sector_deg is None and self.within_m is None:
            return found
        centre = self.place(truths)
        if centre is None:
            raise PlotfeedError("sector_deg and within_m need protected_deg: nobody says the site")
        east_m, north_m, _ = centre.from_ecef(ecef_m).T
        first, last = self.sector_deg or (0.0, 360.0)
        azimuth_deg = (np.degrees(np.arctan2(east_m, north_m)) - first) % 360.0
        found &= azimuth_deg <= ((last - first) % 360.0 or 360.0)
        within: Bools = ~(np.hypot(east_m, north_m) > (self.within_m or np.inf))
        return found & within


FORGOTTEN_S = 60.0  # A number that is silent for so long is another track's when it comes again
FASTEST_M_S = 1e4  # Velocities beyond this are not taken for any
KEPT_S = 10.0  # Over which a velocity that is not told is taken from two reports


@dataclass(frozen=True, kw_only=True)
class UsableReports(TrackReports):
    """Reports that can be scored, (n,), by track and time."""

    velocity_enu_m_s: Floats
    covariance_m2: Floats
    leaps: Bools  # Nothing flies there from the one before: the number is in two places

    @property
    def has_height(self) -> Bools:
        """Which reports tell one, (n,)."""
        return np.isfinite(self.point[:, GROUND])

    @property
    def latency_s(self) -> Floats:
        """Seconds from the time of a report to when it was received; NaN if unknown, (n,)."""
        late_s = (self.known_utc_ns - self.t_utc_ns) / NS
        return np.where(self.known_utc_ns == UNKNOWN_NS, np.nan, late_s)


class UsableTracks(NamedTuple):
    """What of a tracker can be scored."""

    reports: UsableReports
    # Of tracks. A number that was ended, or silent for a minute, is another track's after that.
    names: Sequence[str]
    counts: Counter[str]  # Reports that were left out, or are odd, by the reason

    def only(self, which: Bools, reason: str) -> UsableTracks:
        """Usable tracks with these reports alone; others are counted by the reason."""
        others = Counter({reason: int(np.count_nonzero(~which))})
        return self._replace(reports=self.reports.rows(which), counts=self.counts + others)


def usable_tracks(
    tracks: TracksRead, span_utc_ns: tuple[int, int], level: Level, how: ScoreSettings
) -> UsableTracks:
    """Sort reports, and sort out those that cannot be: of a run from the first time to the last.

    Of several with one number and time the last one counts. Reports of a time later than that at
    which they were received are of the future.
    """
    told, counts = tracks.reports, Counter(tracks.unreadable)
    future_ns = round(how.future_s * NS)
    early = told.t_utc_ns - future_ns > told.received_utc_ns
    kept = np.ones(len(told), np.bool_)
    for reason, wrong in (
        ("without a time", told.t_utc_ns == UNKNOWN_NS),
        ("not a place on Earth", ~is_place(told)),
        ("of the future", early & (told.received_utc_ns != UNKNOWN_NS)),
        ("after the run", told.t_utc_ns - future_ns > span_utc_ns[1]),
        ("before the run", told.t_utc_ns + future_ns < span_utc_ns[0]),
        ("tentative", told.tentative & (not how.counts_tentative)),
    ):
        counts[reason] += int(np.count_nonzero(kept & wrong))
        kept &= ~wrong
    came = np.flatnonzero(kept)
    came = came[np.argsort(told.received_utc_ns[came], kind="stable")]
    came_by_track = came[np.argsort(told.track[came], kind="stable")]
    late = np.diff(told.t_utc_ns[came_by_track]) < 0  # than a later one of their track
    late &= np.diff(told.track[came_by_track]) == 0
    counts["out of order"] += int(np.count_nonzero(late))
    order = came[np.lexsort((np.arange(len(came)), told.t_utc_ns[came], told.track[came]))]
    same = (np.diff(told.track[order]) == 0) & (np.diff(told.t_utc_ns[order]) == 0)
    counts["repeated, of which the last counts"] += int(np.count_nonzero(same))
    rows = told.rows(order[np.append(~same, True)] if len(order) else order)
    place = (rows.latitude_deg, rows.longitude_deg)
    with np.errstate(invalid="ignore"):
        is_velocity = np.abs(rows.velocity_enu_m_s) <= FASTEST_M_S
    velocity = np.where(is_velocity, rows.velocity_enu_m_s, np.nan)
    point = level.points(*place, rows.height_m)
    span_s = np.diff(rows.t_utc_ns) / NS
    begins = np.ones(len(rows), np.bool_)  # Tracks are numbered anew
    begins[1:] = (np.diff(rows.track) != 0) | rows.ended[:-1] | (span_s > FORGOTTEN_S)
    track = np.cumsum(begins) - 1
    apart_m = np.sqrt((np.diff(point[:, :GROUND], axis=0) ** 2).sum(axis=1))
    leaps = np.zeros(len(rows), np.bool_)
    leaps[1:] = ~begins[1:] & (apart_m > how.max_speed_m_s * span_s)
    counts["in two places at once"] += int(np.count_nonzero(leaps))
    seen: Counter[str] = Counter()
    names = []
    for name in (tracks.names[i] for i in rows.track[begins].tolist()):
        seen[name] += 1
        names.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    reports = UsableReports(
        t_utc_ns=rows.t_utc_ns,
        known_utc_ns=rows.received_utc_ns,
        track=track,
        point=point,
        rate=rates_by_differences(track, rows.t_utc_ns, point, rates(*place, velocity), KEPT_S),
        ended=rows.ended,
        velocity_enu_m_s=velocity,
        covariance_m2=rows.covariance_m2,
        leaps=leaps,
    )
    return UsableTracks(reports, names, +counts)


def report_errors(
    field: _Field, reports: UsableReports, walked: Walked, dimensions: int
) -> ReportErrors:
    """Errors of the reports of assigned tracks; a number in two places at once counts for none."""
    of, sensors_at = walked.assigned, field.truths.sensors_at
    drone = np.where(reports.leaps, NOBODY, field.beside_reports(reports, of, of.drone))
    true = truth_beside(field.truths, drone, reports.t_utc_ns, field.level)
    there = np.flatnonzero((drone != NOBODY) & np.isfinite(true.point[:, 0]))
    place = (true.latitude_deg[there], true.longitude_deg[there])
    error_m = along_enu(reports.point[there] - true.point[there], *place)
    covariance_m2 = reports.covariance_m2[there]
    seen_m = np.full((len(there), 2), np.nan)
    if sensors_at is not None:
        seen_m = sensors_at.from_ecef(geodetic_to_ecef(*place, sensors_at.height_m))[:, :2]
    return ReportErrors(
        t_utc_ns=reports.t_utc_ns[there],
        track=reports.track[there],
        drone=drone[there],
        report=there,
        error_enu_m=error_m,
        distance_m=np.sqrt((error_m[:, :dimensions] ** 2).sum(axis=1)),
        velocity_error_enu_m_s=reports.velocity_enu_m_s[there] - true.velocity_enu_m_s[there],
        true_velocity_enu_m_s=true.velocity_enu_m_s[there],
        covariance_m2=covariance_m2,
        nees=nees(error_m[:, :dimensions], covariance_m2[:, :dimensions, :dimensions]),
        latency_s=reports.latency_s[there],
        from_sensors_m=seen_m,
    )


def truth_beside(truths: Truths, drone: Ints, t_utc_ns: Ints, level: Level) -> TrueStates:
    """Where each row's drone was at each row's time, (n,)."""
    place_m, velocity_m_s = np.full((len(drone), 3), np.nan), np.full((len(drone), 3), np.nan)
    order = np.argsort(drone, kind="stable")
    ends = np.searchsorted(drone[order], np.arange(len(truths.drones) + 1)).tolist()
    for path, a, b in zip(truths.paths, ends[:-1], ends[1:], strict=True):
        which = order[a:b]
        place_m[which], velocity_m_s[which] = path.states_at(t_utc_ns[which])
    found = true_states(place_m, velocity_m_s, level)
    if not truths.has_height:
        found.point[:, GROUND] = np.nan
    return found


def nearest_drones(
    truths: Truths, t_utc_ns: Ints, point: Floats, level: Level
) -> tuple[Floats, Ints]:
    """How far over the ground points (n, 4) are from the nearest drone then, and which it is, (n,).

    Infinite, and nobody, where no drone was there.
    """
    least, drone = np.full(len(point), np.inf), np.full(len(point), NOBODY)
    for number in range(len(truths.paths)):
        true = truth_beside(truths, np.full(len(point), number), t_utc_ns, level)
        apart_m = distance_m(point[:, :3] - true.point[:, :3])
        nearer = apart_m < least
        least[nearer], drone[nearer] = apart_m[nearer], number
    return least, drone


class Figures(dict[str, float]):
    """Figures by their names, also as attributes; NaN for what is not known."""

    def __missing__(self, name: str) -> float:
        return math.nan

    def __getattr__(self, name: str) -> float:
        if name not in FIGURES:
            raise AttributeError(name)
        return self[name]


# Of sets of tracks beside the drones: names, titles and forms; % for shares. Those of order p are
# means of that order over time: for p = 2 the squares of GOSPA's parts add up to its own.
SETS: Mapping[str, tuple[str, str]] = {
    "gospa_m": ("GOSPA, m", ".2f"),
    "gospa_localisation_m": ("  by localisation, m", ".2f"),
    "gospa_missed_m": ("  by drones without a track, m", ".2f"),
    "gospa_false_m": ("  by tracks of no drone, m", ".2f"),
    "ospa_m": ("OSPA, m", ".2f"),
    "ospa2_m": ("OSPA(2), m", ".2f"),
    "t_gospa_m": ("T-GOSPA, m", ".2f"),
    "t_gospa_switching_m": ("  by switches, m", ".2f"),
    "completeness": ("completeness, %", "%"),
    "ambiguity": ("ambiguity, tracks a drone", ".3f"),
    "spuriousness": ("spuriousness, %", "%"),
    "id_correctness": ("drones under their first number, %", "%"),
    "id_ambiguity": ("  under that and another, %", "%"),
    "position_accuracy_m": ("mean error of position, m", ".2f"),
    "velocity_accuracy_m_s": ("mean error of velocity, m/s", ".2f"),
    "longest_segment": ("longest segment, %", "%"),
    "number_changes_per_h": ("changes of number, 1/h", ".2f"),
    "breaks": ("breaks", ".0f"),
    "swaps": ("swaps", ".0f"),
}
# Likewise of reports that are of a drone, each at its own time.
REPORTS: Mapping[str, tuple[str, str]] = {
    "reports": ("", ""),
    "position_mean_m": ("position, mean, m", ".2f"),
    "position_rms_m": ("position, rms, m", ".2f"),
    "position_p50_m": ("position, 50 %, m", ".2f"),
    "position_p95_m": ("position, 95 %, m", ".2f"),
    "position_max_m": ("position, most, m", ".2f"),
    "bias_east_m": ("mean error east, m", "+.2f"),
    "bias_north_m": ("mean error north, m", "+.2f"),
    "bias_up_m": ("mean error up, m", "+.2f"),
    "along_rms_m": ("along the way, rms, m", ".2f"),
    "across_rms_m": ("across the way, rms, m", ".2f"),
    "height_rms_m": ("height, rms, m", ".2f"),
    "velocity_rms_m_s": ("velocity, rms, m/s", ".2f"),
    "nees": ("NEES over its freedom (1)", ".3f"),
    "nees_low": ("  in 95 of 100 such runs from", ".3f"),
    "nees_high": ("  to", ".3f"),
    "lag_s": ("lag along the way, s", "+.3f"),
    "lag_se_s": ("  standard error, s", ".3f"),
    "latency_p50_s": ("latency, 50 %, s", ".3f"),
    "latency_p95_s": ("latency, 95 %, s", ".3f"),
    "latency_p99_s": ("latency, 99 %, s", ".3f"),
    "latency_max_s": ("latency, most, s", ".3f"),
    "update_p50_s": ("between reports, 50 %, s", ".3f"),
    "update_p95_s": ("between reports, 95 %, s", ".3f"),
}
FIGURES = {**SETS, **REPORTS}
# Figures that are counts of what seldom happens in a run.
COUNTS = frozenset({"breaks", "swaps", "false_tracks", "never_tracked"})


# As `Score.figures` has them.
FIGURE_NAMES = (
    *SETS,
    *(f"known_{name}" for name in SETS),
    *REPORTS,
    *(f"space_{name}" for name in FIGURES),
    *("initiation_median_s", "alert_median_m", "drones", "never_tracked", "tracks"),
    *("false_tracks", "left_out", "silent_s"),
)


class DroneScore:
    """One drone, by its number, while sensors looked at it."""

    def __init__(
        self, field: _Field, number: int, segments: Segments, errors: ReportErrors, tracked: Bools
    ) -> None:
        truths, step_s, of = field.truths, field.grid.step_ns / NS, errors.drone == number
        path, protected = truths.paths[number], field.how.place(truths)
        steps = np.flatnonzero(field.there[:, number])
        following = followed(segments.rows(segments.drone == number), steps)
        covered = int(np.count_nonzero(tracked[steps, number]))
        apart_m, stamped_ns = errors.distance_m[of], errors.t_utc_ns[of]
        known_ns = errors.known_utc_ns[of]
        self.drone = truths.drones[number]
        self.cover_s = len(steps) * step_s
        self.completeness = covered / len(steps) if len(steps) else math.nan
        self.tracks, self.breaks = following.tracks, following.breaks
        self.number_changes = following.number_changes
        self.longest_s = following.longest_steps * step_s
        # From when it came into cover to when its first report was received; NaN if it never was.
        self.initiation_s = math.nan
        self.alert_m = math.nan  # How far it was then, over the ground, from what is protected
        self.closest_m = math.nan  # As near as it came to what is protected
        if protected is not None and len(path.t_utc_ns):
            self.closest_m = float(_over_ground_m(path.position_ecef_m, protected).min())
        if len(known_ns):
            first = int(np.argmin(known_ns))
            self.initiation_s = max((int(known_ns[first]) - int(path.t_utc_ns[0])) / NS, 0.0)
            if protected is not None:  # where it was then, or else when it was seen
                place_m, _ = path.states_at(np.array([known_ns[first], stamped_ns[first]]))
                then_m, seen_m = _over_ground_m(place_m, protected).tolist()
                self.alert_m = then_m if math.isfinite(then_m) else seen_m
        self.position_rms_m, self.position_p95_m = _rms(apart_m), _p95(apart_m)


class SensorScore:
    """Drones while one sensor, by its number, looked at them, whoever saw them."""

    def __init__(self, field: _Field, number: int, errors: ReportErrors, tracked: Bools) -> None:
        truths, step_s = field.truths, field.grid.step_ns / NS
        inside = np.zeros_like(field.there)
        of_errors = np.zeros(len(errors), np.bool_)
        for drone, path in enumerate(truths.paths):
            looks_ns = truths.looks_utc_ns.get((drone, number))
            if looks_ns is None:
                continue
            covered = covered_at(looks_ns, field.grid.t_utc_ns, path.gap_ns)
            inside[:, drone] = covered & field.there[:, drone]
            own = np.flatnonzero(errors.drone == drone)
            of_errors[own] = covered_at(looks_ns, errors.t_utc_ns[own], path.gap_ns)
        apart_m, cover = errors.distance_m[of_errors], int(inside.sum())
        begins, ends = stretches(inside & ~tracked)
        self.sensor = truths.sensors[number]
        self.drones = int(np.count_nonzero(inside.any(axis=0)))
        self.cover_s = cover * step_s
        self.completeness = int((inside & tracked).sum()) / cover if cover else math.nan
        self.position_rms_m, self.position_p95_m = _rms(apart_m), _p95(apart_m)
        # The longest time for which a drone in its cover had no track.
        self.longest_gap_s = int((ends - begins).max(initial=0)) * step_s


def _over_ground_m(place_m: Floats, protected: LocalFrame) -> Floats:
    latitude_deg, longitude_deg, _ = ecef_to_geodetic(place_m)
    level_m = geodetic_to_ecef(latitude_deg, longitude_deg, 0.0)
    to_m = geodetic_to_ecef(protected.latitude_deg, protected.longitude_deg, 0.0)
    return distance_m(level_m - to_m)


def _p95(values: Floats) -> float:
    return float(np.quantile(values, 0.95)) if len(values) else math.nan


MOST_CELLS = 50_000_000  # Steps times drones
# A tracker of which nothing comes for so long, and for so many times as long as it is usual from
# one report to the next (95 %), has ended.
SILENT_S, SILENT_TIMES = 10.0, 5.0


class NoFlightError(PlotfeedError):
    """No drone was in cover, or is scored."""


class Score:
    """The score of a tracker for one run.

    Whatever the tracker did, there is a score: what of its reports cannot be used is counted.
    """

    def __init__(
        self, truths: Truths, tracks: TracksRead, settings: ScoreSettings | None = None
    ) -> None:
        """Raises `NoFlightError`, or `PlotfeedError` for a run too long."""
        self.settings = how = settings or ScoreSettings()
        whole, truths = truths, scored_part(truths, how)
        field = _Field(truths, how)
        usable = usable_tracks(tracks, field.span_utc_ns, field.level, how)
        if how.leaves_out:
            usable = usable.only(_are_scored(whole, field, usable.reports), "not scored")
        if how.dimensions == 3:
            if not truths.has_height:
                raise PlotfeedError("dimensions = 3: the truth tells no heights")
            usable = usable.only(usable.reports.has_height, "without a height")
        used, beside = usable.reports, _Beside(field, usable, how.dimensions)
        walked, errors = beside.walked, beside.errors
        self.scene, self.source = truths.scene, tracks.source  # And where tracks were found
        self.start_utc_ns, self.end_utc_ns = field.span_utc_ns
        self.as_stamped = beside.sets  # Each report counts from the time it is of, whenever it came
        # Reports count from when they were received; None where that is not known.
        self.as_known: Figures | None = None
        self.reports, self.errors = beside.reports, errors
        self.in_space = Figures()  # Of sets, as stamped, and of reports that tell a height
        # What figures are of, by the names that `figures` has; none of those of this run alone.
        self.samples = dict(beside.samples)
        self.notes = [*truths.notes]
        self.left_out = usable.counts  # Reports that were left out or are odd, by the reason
        unknown = int(np.count_nonzero(used.known_utc_ns == UNKNOWN_NS))
        if not unknown:
            later = field.walked(usable, how.dimensions, as_known=True)
            self.as_known, of_known, _ = _set_figures(field, used, *later)
            self.samples |= {f"known_{name}": each for name, each in of_known.items()}
        if used.has_height.any() and truths.has_height:
            high = usable._replace(reports=used.rows(used.has_height))
            space = beside if how.dimensions == 3 else _Beside(field, high, 3)
            self.in_space = Figures({**space.sets, **space.reports})
            self.samples |= {f"space_{name}": each for name, each in space.samples.items()}
            if lack := len(used) - len(high.reports):
                of = f"{lack} of {len(used)} reports"
                self.notes.append(f"{of} tell no height: not in space")
        if unknown:
            of = f"{unknown} of {len(used)} reports have no time of receipt"
            self.notes.append(f"{of}: latency is of the others, and nothing is told as known")
        # Of each step of the grid: its time, what there was, which drones were there, and which of
        # them had a track, (steps, drones).
        self.t_utc_ns, self.steps, self.there = field.grid.t_utc_ns, walked.steps, field.there
        self.tracked = tracked = np.zeros_like(field.there)
        tracked[walked.assigned.step, walked.assigned.drone] = True
        self.drones = [
            DroneScore(field, number, beside.segments, errors, tracked)
            for number in range(len(truths.drones))
        ]
        self.sensors = [SensorScore(field, n, errors, tracked) for n in range(len(truths.sensors))]
        self._begin(truths)
        self.tracks = len(usable.names)
        self.false_tracks = self.tracks - len(np.unique(beside.segments.track))  # Of no drone ever
        last_ns = int(used.t_utc_ns.max(initial=self.start_utc_ns))
        # From the last report to the end.
        self.silent_s = max((self.end_utc_ns - last_ns) / NS, 0.0)
        self.failure = _failure(tracks, used, self.silent_s)  # How the tracker failed; else empty
        self._place(field, used, beside)

    def _place(self, field: _Field, used: UsableReports, beside: _Beside) -> None:
        """Say where there was what, for charts, and how far from drones reports were."""
        truths, there = field.truths, field.states.point
        # From each usable report to the drone that was nearest, over the ground; NaN for none.
        nearest = field.beside_reports(used, beside.rows, beside.walked.nearest)
        near = truth_beside(truths, nearest, used.t_utc_ns, field.level)
        self.nearest_m = distance_m(used.point[:, :3] - near.point[:, :3])
        is_false = np.ones(len(beside.rows), np.bool_)
        is_false[beside.walked.assigned.row] = False
        # East and north of the site, or else of the middle, (n, 2).
        self.places = {
            name: (truths.site or truths.middle).from_ecef(points[:, :3])[:, :2]
            for name, points in (
                ("drones with a track", there[self.tracked]),
                ("drones without a track", there[field.there & ~self.tracked]),
                ("tracks of no drone", beside.rows.point[is_false]),
            )
        }

    def _begin(self, truths: Truths) -> None:
        """Say when drones were there, and first seen; those never seen are in the medians."""
        # Of each drone: from when to when it was there.
        self.stays_utc_ns = [stays_of(p.t_utc_ns, p.gap_ns) for p in truths.paths]
        # Those that do not count were nowhere.
        told = [each for each, p in zip(self.drones, truths.paths, strict=True) if len(p.t_utc_ns)]
        self.counted = len(told)  # Of the drones: those that count, and were anywhere
        seen = np.array([np.isfinite(each.initiation_s) for each in told], np.bool_)
        self.never_tracked = int(np.count_nonzero(~seen))
        waited_s = np.where(seen, [d.initiation_s for d in told], [d.cover_s for d in told])
        # By Kaplan and Meier: drones that never had a track are in it; infinite if most had none.
        self.initiation_median_s = survival_quantile(waited_s, seen)
        # Those that were never seen would have been nearer than they ever came.
        nearness_m = -np.where(seen, [d.alert_m for d in told], [d.closest_m for d in told])
        self.alert_median_m = max(-survival_quantile(nearness_m, seen), 0.0)  # 0 if most were not

    @property
    def since_s(self) -> Floats:
        """Times of the steps, (steps,), from the beginning on."""
        return (self.t_utc_ns - self.start_utc_ns) / NS

    @property
    def distances(self) -> str:
        """Which distances are meant throughout, in words."""
        return "over the ground" if self.settings.dimensions == 2 else "in space"

    def figures(self) -> dict[str, float]:
        """All figures by their names, NaN for what is not known: the same names for every run.

        Those of what was known at the time begin with `known_`, and those in space with `space_`.
        """
        known, sets = self.as_known or Figures(), {name: self.as_stamped[name] for name in SETS}
        counts = self.counted, self.never_tracked, self.tracks, self.false_tracks
        values = (
            *(*sets.values(), *(known[name] for name in SETS)),
            *(*(self.reports[name] for name in REPORTS), *(self.in_space[n] for n in FIGURES)),
            *(self.initiation_median_s, self.alert_median_m, *map(float, counts)),
            *(float(sum(self.left_out.values())), self.silent_s),
        )
        return dict(zip(FIGURE_NAMES, values, strict=True))


def scored_part(truths: Truths, how: ScoreSettings) -> Truths:
    """The flights as far as they count; raises `PlotfeedError` for drones that nobody knows."""
    if not how.leaves_out:
        return truths
    if unknown := set(how.leave_out) - set(truths.drones):
        there = ", ".join(truths.drones[:12])
        raise PlotfeedError(f"leave_out: no drone {min(unknown)!r}: expected of {there}")
    paths = [
        path.rows(
            how.counts(truths, path.t_utc_ns, path.position_ecef_m) & (name not in how.leave_out)
        )
        for name, path in zip(truths.drones, truths.paths, strict=True)
    ]
    return replace(truths, paths=paths)


def _are_scored(whole: Truths, field: _Field, reports: UsableReports) -> Bools:
    """Which reports count: of drones that do, or of none, where and when that would count."""
    how, t_ns, point = field.how, reports.t_utc_ns, reports.point
    of_scored, _ = nearest_drones(field.truths, t_ns, point, field.level)
    of_any, _ = nearest_drones(whole, t_ns, point, field.level)
    of_others = of_any < np.minimum(of_scored, how.cutoff_m)
    found: Bools = ~of_others & (how.counts(whole, t_ns, point[:, :3]) | (of_scored < how.cutoff_m))
    return found


class _Field:
    """The flights on the grid, from the first place of any drone to the last."""

    def __init__(self, truths: Truths, how: ScoreSettings) -> None:
        self.truths, self.how = truths, how
        times = [path.t_utc_ns for path in truths.paths if len(path.t_utc_ns) > 1]
        if not times:
            raise NoFlightError("no flight to score against: no drone was looked at, or is scored")
        first_ns, last_ns = min(int(t[0]) for t in times), max(int(t[-1]) for t in times)
        self.span_utc_ns = first_ns, last_ns
        step_ns, many = round(how.step_s * NS), len(truths.paths)
        first = -(-first_ns // step_ns)
        steps = max(last_ns // step_ns - first + 1, 1)
        if steps * many > MOST_CELLS:
            raise PlotfeedError(
                f"{steps} steps of {how.step_s:g} s for {many} drones are too many: "
                "step_s can be longer, or the recording cut"
            )
        self.grid = Grid(start_utc_ns=first * step_ns, step_ns=step_ns, steps=steps)
        found = [path.states_at(self.grid.t_utc_ns) for path in truths.paths]
        place_m, velocity_m_s = (np.concatenate(part) for part in zip(*found, strict=True))
        heights_m = true_states(place_m, velocity_m_s, Level(0.0)).point[:, 3]
        known_m = heights_m[np.isfinite(heights_m)]
        self.level = Level(float(np.mean(known_m)) if len(known_m) else 0.0)
        states = true_states(place_m, velocity_m_s, self.level)
        self.states = TrueStates(  # (steps, drones, ...)
            point=states.point.reshape(many, steps, 4).swapaxes(0, 1),
            velocity_enu_m_s=states.velocity_enu_m_s.reshape(many, steps, 3).swapaxes(0, 1),
            latitude_deg=states.latitude_deg.reshape(many, steps).T,
            longitude_deg=states.longitude_deg.reshape(many, steps).T,
        )
        self.there: Bools = np.isfinite(self.states.point[:, :, 0])

    def walked(
        self, usable: UsableTracks, dimensions: int, *, as_known: bool
    ) -> tuple[GridRows, Walked]:
        """Tracks at steps, and what they came to."""
        how = self.how
        rows = on_grid(usable.reports, self.grid, how.stale_s, as_known=as_known)
        columns = GROUND if dimensions == 2 else SPACE
        states, count = self.states.point, len(usable.names)
        return rows, walk(states, self.there, rows, count, columns, how)

    def beside_reports(self, reports: TrackReports, of: Assigned | GridRows, values: Ints) -> Ints:
        """What stands beside each report's track at the first step not before it, (n,)."""
        count = int(reports.track.max(initial=0)) + 1
        keys, step = of.step * count + of.track, self.grid.at_or_after(reports.t_utc_ns)
        wanted = step * count + reports.track
        found = np.full(len(wanted), NOBODY)
        if len(keys):
            at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            good = (keys[at] == wanted) & (step >= 0) & (step < self.grid.steps)
            found[good] = values[at[good]]
        return found


class _Beside:
    """Tracks beside the flights in some dimensions, as stamped."""

    def __init__(self, field: _Field, usable: UsableTracks, dimensions: int) -> None:
        self.rows, self.walked = field.walked(usable, dimensions, as_known=False)
        of = _set_figures(field, usable.reports, self.rows, self.walked)
        self.sets, of_sets, self.segments = of
        self.errors = report_errors(field, usable.reports, self.walked, dimensions)
        found, of_reports = report_figures(self.errors, dimensions)
        self.reports, self.samples = Figures(found), of_sets | of_reports


def _set_figures(
    field: _Field, reports: UsableReports, rows: GridRows, walked: Walked
) -> tuple[Figures, dict[str, FigureSamples], Segments]:
    """Figures of sets, what they are of, and over which steps tracks are of drones."""
    of, how = walked.assigned, field.how
    segments = segments_of(of.track, of.drone, of.step, how.end_steps)
    velocity = reports.velocity_enu_m_s[rows.report[of.row]]
    error_m_s = velocity - field.states.velocity_enu_m_s[of.step, of.drone]
    of_all = how.order, field.grid.step_ns
    found, samples = set_figures(walked, segments, field.there, error_m_s, *of_all)
    return Figures(found), samples, segments


def _rms(values: Floats) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else math.nan


def _failure(tracks: TracksRead, usable: UsableReports, silent_s: float) -> str:
    if tracks.crashed:
        return tracks.crashed
    if not len(tracks.reports):
        return "the tracker reported no tracks"
    if not len(usable):
        return "none of the tracker's reports can be used"
    times_s = np.unique(usable.t_utc_ns) / NS
    usual_s = float(np.quantile(np.diff(times_s), 0.95)) if len(times_s) > 1 else 0.0
    if silent_s > max(SILENT_S, SILENT_TIMES * usual_s):
        return f"the tracker's last report is {silent_s:.1f} s before the end"
    return ""
