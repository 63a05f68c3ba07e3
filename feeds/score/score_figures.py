"""The score of a tracker in figures: of sets over time, of drones, of sensors, of reports."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields

from plotfeed.feeds.score.report_errors import ReportErrors
from plotfeed.feeds.score.score_settings import ScoreSettings
from plotfeed.models.scoring.grid_walk import StepScores
from plotfeed.models.state import Bools, Floats, Ints

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
