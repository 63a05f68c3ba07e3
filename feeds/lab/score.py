"""`plotfeed score`: a score as text, JSON, HTML and JUnit's XML, and a profile's limits on it."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from html import escape
from importlib.resources import files
from io import BufferedWriter
from pathlib import Path
from typing import Annotated, Any, Literal, Self
from xml.etree.ElementTree import Element, SubElement, tostring  # nosec B405

import numpy as np
from pydantic import Field, ValidationError, model_validator

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.printed import finite, printable, say
from plotfeed.feeds.console.process import new_file, refuse_if_there
from plotfeed.feeds.lab.feed_checks import as_json, as_text, check_feed
from plotfeed.feeds.lab.flights import read_truths, scene_of
from plotfeed.feeds.lab.lab_settings import ScoreOptions
from plotfeed.feeds.lab.pictures import figure_of, finish, plain_text, svg_of
from plotfeed.feeds.lab.scoring import FIGURE_NAMES, Score, ScoreSettings, SetFigures, score_run
from plotfeed.feeds.lab.tables import Table, TextColumn, number, of_cells, percent
from plotfeed.feeds.lab.track_reports import read_tracks
from plotfeed.feeds.scene.fields import SceneTable
from plotfeed.feeds.scene.problems import in_a_line, problems_of
from plotfeed.models.state import Floats
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import DAY_NS, NS, iso_utc

SUFFIX = ".toml"
MAX_OCTETS = 1 << 20
Seconds = Annotated[float, Field(gt=0, le=86_400)]
Metres = Annotated[float, Field(gt=0, le=1e7)]


class ScoreLimit(SceneTable):
    """One figure, and what it must not pass."""

    figure: str
    """Which, as `plotfeed score --json` names it, or update_share, long_gap_share, far_share."""
    at_most: float | None = None
    at_least: float | None = None
    period_s: Seconds | None = None
    """Of update_share: the share of such periods in which a drone in cover was reported."""
    longer_than_s: Seconds | None = None
    """Of long_gap_share: the share of drones' time in cover that lies in longer gaps."""
    beyond_m: Metres | None = None
    """Of far_share: the share of reports that are further from any drone."""
    name: Annotated[str, Field(max_length=200)] = ""
    """What the limit is called; without it, by its figure."""

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if (self.at_most is None) == (self.at_least is None):
            raise ValueError("expected at_most or at_least")
        needed = PARAMETERS.get(self.figure)
        if needed is None and self.figure not in FIGURE_NAMES:
            raise ValueError(
                f"figure: expected one of {', '.join(PARAMETERS)}, or of the figures of a score"
            )
        for parameter in PARAMETERS.values():
            is_there = getattr(self, parameter) is not None
            if is_there != (parameter == needed):
                verb = "is not of" if is_there else "is needed by"
                raise ValueError(f"{parameter}: {verb} {self.figure}")
        return self

    @property
    def title(self) -> str:
        """The name, or the figure and its bound."""
        return self.name or f"{self.figure} {self.asked}"

    @property
    def asked(self) -> str:
        """What is asked, in words."""
        if self.at_most is not None:
            return f"at most {self.at_most:g}"
        return f"at least {self.at_least:g}"


class ProfileHead(SceneTable):
    """What a profile is."""

    title: Annotated[str, Field(max_length=200)]
    note: Annotated[str, Field(max_length=2000)] = ""


class ScoreProfile(SceneTable):
    """A file of limits."""

    profile: ProfileHead
    settings: dict[str, Any] = Field(default_factory=dict)
    limit: Annotated[list[ScoreLimit], Field(min_length=1, max_length=1000)]

    def score_settings(self) -> ScoreSettings:
        """How tracks are scored for it; raises `PlotfeedError`."""
        return ScoreSettings.of(self.settings)


PARAMETERS = {
    "update_share": "period_s",
    "long_gap_share": "longer_than_s",
    "far_share": "beyond_m",
}
"""Figures that need one more number."""


def shipped_profiles() -> list[str]:
    """The names of the profiles that come with plotfeed."""
    folder = files(__package__) / "profiles"
    names = (entry.name for entry in folder.iterdir())
    return sorted(name.removesuffix(SUFFIX) for name in names if name.endswith(SUFFIX))


def load_profile(name: str) -> ScoreProfile:
    """The profile in a file, or one that comes with plotfeed; raises `PlotfeedError`, `OSError`."""
    path = Path(name)
    if path.suffix == SUFFIX or path.is_file():
        if path.stat().st_size > MAX_OCTETS:
            raise PlotfeedError(f"{name}: expected a profile, of at most {MAX_OCTETS} octets")
        data = path.read_bytes()
    elif name in shipped_profiles():
        data = (files(__package__) / "profiles" / f"{name}{SUFFIX}").read_bytes()
    else:
        raise PlotfeedError(
            f"{name}: expected a file that ends in {SUFFIX}, or one of "
            f"{', '.join(shipped_profiles())}"
        )
    try:
        tree = tomllib.loads(data.decode("utf-8-sig"))
        found = ScoreProfile.model_validate(tree)
        found.score_settings()
    except ValidationError as error:
        raise PlotfeedError(f"{name}: {in_a_line(problems_of(error, tree))}") from None
    except (ValueError, RecursionError) as error:
        raise PlotfeedError(f"{name}: no TOML: {error}") from None
    except PlotfeedError as error:
        raise PlotfeedError(f"{name}: settings.{error}") from None
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitVerdict:
    """A limit, and whether a score keeps it."""

    name: str
    figure: str
    asked: str
    value: float
    status: Literal["passed", "failed", "not testable"]
    of: int
    """How many reports, periods or drones the figure is of; 0 where that says nothing."""

    @property
    def told(self) -> str:
        """The figure beside what is asked."""
        value = f"{self.value:.6g}" if math.isfinite(self.value) else "not known"
        many = f" (of {self.of})" if self.of else ""
        return f"{self.figure} {value}{many}, asked {self.asked}"


def verdicts_of(score: Score, profile: ScoreProfile) -> list[LimitVerdict]:
    """Every limit of a profile, in its order."""
    return [_verdict(score, limit) for limit in profile.limit]


def _verdict(score: Score, limit: ScoreLimit) -> LimitVerdict:
    worked_out = _WORKED_OUT.get(limit.figure)
    if worked_out is None:
        value, of = score.figures()[limit.figure], 0
    else:
        value, of = worked_out(score, getattr(limit, PARAMETERS[limit.figure]))
    status: Literal["passed", "failed", "not testable"] = "not testable"
    if not math.isnan(value):
        most = math.inf if limit.at_most is None else limit.at_most
        least = -math.inf if limit.at_least is None else limit.at_least
        status = "passed" if least <= value <= most else "failed"
    return LimitVerdict(
        name=limit.title,
        figure=limit.figure,
        asked=limit.asked,
        value=value,
        status=status,
        of=of,
    )


def update_share(score: Score, period_s: float) -> tuple[float, int]:
    """The share of whole periods in cover in which a drone was reported, and how many they are."""
    period_ns, reported, periods = round(period_s * NS), 0, 0
    for drone, stays in enumerate(score.over_time.stays_utc_ns):
        cells = score.errors.t_utc_ns[score.errors.drone == drone] // period_ns
        for begin_ns, end_ns in stays:
            first, end = -(-begin_ns // period_ns), end_ns // period_ns
            if end > first:
                periods += end - first
                reported += len(np.unique(cells[(cells >= first) & (cells < end)]))
    return (reported / periods if periods else math.nan), periods


def long_gap_share(score: Score, longer_than_s: float) -> tuple[float, int]:
    """The share of the time of drones in cover that lies in gaps longer than that.

    A gap is from one report of the drone to the next, from when it comes to its first, and from
    its last to when it goes. Beside it stands how many gaps there are.
    """
    longest_ns, long_ns, whole_ns, gaps = round(longer_than_s * NS), 0, 0, 0
    for drone, stays in enumerate(score.over_time.stays_utc_ns):
        times = np.sort(score.errors.t_utc_ns[score.errors.drone == drone])
        for begin_ns, end_ns in stays:
            inside = times[(times >= begin_ns) & (times <= end_ns)]
            between = np.diff(np.concatenate([[begin_ns], inside, [end_ns]]))
            gaps += len(between)
            long_ns += int(between[between > longest_ns].sum())
            whole_ns += end_ns - begin_ns
    return (long_ns / whole_ns if whole_ns else math.nan), gaps


def far_share(score: Score, beyond_m: float) -> tuple[float, int]:
    """The share of reports that are further over the ground from any drone, and of how many."""
    known: Floats = score.nearest_m[np.isfinite(score.nearest_m)]
    far = int(np.count_nonzero(known > beyond_m))
    return (far / len(known) if len(known) else math.nan), len(known)


_WORKED_OUT: dict[str, Callable[[Score, float], tuple[float, int]]] = {
    "update_share": update_share,
    "long_gap_share": long_gap_share,
    "far_share": far_share,
}


def is_kept(verdicts: Sequence[LimitVerdict], failure: str) -> bool:
    """Whether no limit is broken, and the tracker did not fail."""
    return not failure and all(each.status != "failed" for each in verdicts)


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
    "position_accuracy_m": ("mean error of position, m", ".2f"),
    "velocity_accuracy_m_s": ("mean error of velocity, m/s", ".2f"),
    "longest_segment": ("longest segment, %", "%"),
    "number_changes_per_h": ("changes of number, 1/h", ".2f"),
    "breaks": ("breaks", ".0f"),
    "swaps": ("swaps", ".0f"),
}
"""Names and forms of figures of sets; % for shares."""
REPORTS: Mapping[str, tuple[str, str]] = {
    "position_rms_m": ("position, rms, m", ".2f"),
    "position_p50_m": ("position, 50 %, m", ".2f"),
    "position_p95_m": ("position, 95 %, m", ".2f"),
    "bias_east_m": ("mean error east, m", "+.2f"),
    "bias_north_m": ("mean error north, m", "+.2f"),
    "bias_up_m": ("mean error up, m", "+.2f"),
    "along_rms_m": ("along the way, rms, m", ".2f"),
    "across_rms_m": ("across the way, rms, m", ".2f"),
    "velocity_rms_m_s": ("velocity, rms, m/s", ".2f"),
    "nees": ("NEES over its freedom (1)", ".3f"),
    "nees_low": ("  of an honest tracker from", ".3f"),
    "nees_high": ("  to, in 95 of 100 runs", ".3f"),
    "lag_s": ("lag along the way, s", "+.3f"),
    "lag_se_s": ("  standard error, s", ".3f"),
    "latency_p50_s": ("latency, 50 %, s", ".3f"),
    "latency_p95_s": ("latency, 95 %, s", ".3f"),
    "latency_max_s": ("latency, most, s", ".3f"),
    "update_p50_s": ("between reports, 50 %, s", ".3f"),
    "update_p95_s": ("between reports, 95 %, s", ".3f"),
}
"""Likewise of reports."""
DRONES_TOLD = 50
"""In text; JSON has all."""


def lines(score: Score, profile: str, verdicts: Sequence[LimitVerdict]) -> Iterator[str]:
    """All lines of a score."""
    lasted_s = (score.end_utc_ns - score.start_utc_ns) / NS
    of_scene = f"scene {printable(score.scene)}, " if score.scene else ""
    yield (
        f"{printable(score.source)}: {of_scene}{len(score.drones)} drone(s), {score.tracks} "
        f"track(s), {lasted_s:.1f} s from {iso_utc(score.start_utc_ns)}"
    )
    yield (
        f"  distances {score.distances}; beyond {score.settings.cutoff_m:g} m a track is of no "
        f"drone, older than {score.settings.stale_s:g} s it is not there"
    )
    for note in notes_of(score):
        yield f"  note: {printable(note)}"
    yield from set_table(score).lines()
    for shown in tables_of(score):
        yield from shown.lines(DRONES_TOLD)
    if verdicts:
        yield from verdict_table(profile, verdicts).lines()
    yield ""
    yield closing(score, verdicts)


def notes_of(score: Score) -> Iterator[str]:
    """What of the tracker was left out, and how it failed."""
    yield from score.notes
    for reason, many in score.left_out.items():
        yield f"{many} reports: {reason}"
    if score.failure:
        yield score.failure


def set_table(score: Score) -> Table:
    """Figures of sets, as stamped and as known."""
    known = SetFigures() if score.as_known is None else score.as_known
    rows = [
        (text, _told(getattr(score.as_stamped, name), form), _told(getattr(known, name), form))
        for name, (text, form) in SETS.items()
    ]
    heads = ("", "as stamped", "as known")
    return Table("Tracks beside drones, over time", of_cells(heads, "<>>"), rows)


def tables_of(score: Score) -> Iterator[Table]:
    """All other tables."""
    told = [(text, _told(getattr(score.reports, n), form)) for n, (text, form) in REPORTS.items()]
    title = f"Reports, {score.reports.reports:.0f}, each at its own time"
    yield Table(title, of_cells(("error", ""), "<>"), told)
    many = len(score.drones) - score.never_tracked
    beginnings = [
        ("drones that had a track", f"{many} of {len(score.drones)}"),
        ("from cover to the first report, median, s", number(score.initiation_median_s, ".2f")),
        ("distance at the first report, median, m", number(score.alert_median_m, ".0f")),
        ("tracks of no drone ever", f"{score.false_tracks} of {score.tracks}"),
    ]
    title = "Beginnings; drones that never had a track are in the medians"
    yield Table(title, of_cells(("first report", ""), "<>"), beginnings)
    yield Table("Drones", DRONES, score.drones)
    title = "Drones in the cover of each sensor, whoever saw them"
    yield Table(title, SENSORS, score.sensors)


DRONES = (
    TextColumn("drone", "drone"),
    TextColumn("cover s", "cover_s", ".1f"),
    TextColumn("tracked %", "completeness", "%"),
    TextColumn("tracks", "tracks", "d"),
    TextColumn("breaks", "breaks", "d"),
    TextColumn("longest s", "longest_s", ".1f"),
    TextColumn("first s", "initiation_s", ".2f"),
    TextColumn("at m", "alert_m", ".0f"),
    TextColumn("rms m", "position_rms_m", ".2f"),
    TextColumn("95 % m", "position_p95_m", ".2f"),
)
SENSORS = (
    TextColumn("sensor", "sensor"),
    TextColumn("drones", "drones", "d"),
    TextColumn("cover s", "cover_s", ".1f"),
    TextColumn("tracked %", "completeness", "%"),
    TextColumn("rms m", "position_rms_m", ".2f"),
    TextColumn("95 % m", "position_p95_m", ".2f"),
    TextColumn("longest gap s", "longest_gap_s", ".1f"),
)
LIMITS = (
    TextColumn("", "status"),
    TextColumn("", "name"),
    TextColumn("is", "value", ".6g"),
    TextColumn("asked", "asked"),
    TextColumn("of", lambda limit: str(limit.of or ""), "s"),
)


def verdict_table(profile: str, verdicts: Sequence[LimitVerdict]) -> Table:
    """Limits of a profile."""
    return Table(printable(profile), LIMITS, verdicts)


def closing(score: Score, verdicts: Sequence[LimitVerdict]) -> str:
    """The last line: the verdict."""
    if score.failure:
        return f"The tracker failed: {printable(score.failure)}."
    if not verdicts:
        return "No profile: nothing is judged. --profile asks for limits."
    counts = {s: sum(v.status == s for v in verdicts) for s in ("failed", "not testable")}
    kept = len(verdicts) - sum(counts.values())
    told = [f"{kept} of {len(verdicts)} limits kept"]
    told += [f"{n} {status}" for status, n in counts.items() if n]
    return ", ".join(told) + "."


def as_values(score: Score, profile: str, verdicts: Sequence[LimitVerdict]) -> dict[str, Any]:
    """The score for JSON; null for what is not known."""
    values: dict[str, Any] = finite(
        {
            "scene": score.scene,
            "source": score.source,
            "start_utc": iso_utc(score.start_utc_ns),
            "end_utc": iso_utc(score.end_utc_ns),
            "dimensions": score.dimensions,
            "settings": asdict(score.settings),
            "figures": score.figures(),
            "drones": [asdict(each) for each in score.drones],
            "sensors": [asdict(each) for each in score.sensors],
            "left_out": dict(score.left_out),
            "failure": score.failure,
            "notes": list(score.notes),
            "profile": profile,
            "limits": [asdict(each) for each in verdicts],
        }
    )
    return values


def _told(value: float, form: str) -> str:
    return percent(value) if form == "%" else number(value, form)


INCHES = (11.0, 3.0)
MOST_POINTS = 1200
"""Of a line: more are drawn as means."""
MOST_DRONES = 60
"""In the chart of drones: the first ones."""
BLUE, ORANGE, RED, GREY, GREEN = "#1d4ed8", "#c2410c", "#be123c", "#94a3b8", "#15803d"
BINS = 60
NAME = 16


def charts(score: Score) -> dict[str, str]:
    """Charts by their titles, each as an SVG element; needs matplotlib."""
    drawn: dict[str, Callable[[Any, Score], None]] = {
        "GOSPA over time, and its parts": _gospa,
        "Drones and tracks over time": _counts,
        "When each drone had a track": _drones,
        "Errors of reports over time": _errors,
        "How large errors are": _spread,
    }
    if np.isfinite(score.errors.nees).any():
        drawn["NEES over its degrees of freedom: 1 for an honest tracker"] = _nees
    if np.isfinite(score.errors.latency_s).any():
        drawn["Latency of reports"] = _latency
    return {title: _svg(draw, score) for title, draw in drawn.items()}


def _svg(draw: Callable[[Any, Score], None], score: Score) -> str:
    settings: Any = {"svg.fonttype": "none", "font.size": 9.0}
    with figure_of(INCHES, **settings) as figure:
        axes = figure.subplots()
        draw(axes, score)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8.5)
        return svg_of(figure)


def _since_s(score: Score) -> Floats:
    return (score.over_time.t_utc_ns - score.start_utc_ns) / NS


def _thinned(x: Floats, *columns: Floats) -> list[Floats]:
    """Columns, or means of neighbours where there are too many to be drawn."""
    every = -(-len(x) // MOST_POINTS)
    if every <= 1:
        return [x, *columns]
    whole = len(x) // every * every
    return [column[:whole].reshape(-1, every).mean(axis=1) for column in (x, *columns)]


def _gospa(axes: Any, score: Score) -> None:
    steps, power = score.over_time.steps, 1.0 / score.settings.order
    total = (steps.localisation + steps.missed + steps.false) ** power
    x, total, location, missed, false = _thinned(
        _since_s(score),
        total,
        steps.localisation**power,
        steps.missed**power,
        steps.false**power,
    )
    axes.plot(x, missed, color=RED, lw=0.9, label="drones without a track")
    axes.plot(x, false, color=ORANGE, lw=0.9, label="tracks of no drone")
    axes.plot(x, location, color=GREEN, lw=0.9, label="localisation")
    axes.plot(x, total, color=BLUE, lw=1.4, label="GOSPA")
    finish(axes, "", "s", "m")


def _counts(axes: Any, score: Score) -> None:
    steps = score.over_time.steps
    x, drones, tracks, tracked = _thinned(
        _since_s(score),
        steps.drones.astype(np.float64),
        steps.tracks.astype(np.float64),
        steps.tracked.astype(np.float64),
    )
    axes.plot(x, drones, color=GREY, lw=2.4, label="drones")
    axes.plot(x, tracks, color=ORANGE, lw=0.9, label="tracks")
    axes.plot(x, tracked, color=BLUE, lw=1.1, label="drones that have one")
    finish(axes, "", "s", "")


def _drones(axes: Any, score: Score) -> None:
    shown, step_s = min(len(score.drones), MOST_DRONES), score.settings.step_s
    since_s = _since_s(score)
    for n in range(shown):
        for there, colour, height in (
            (score.over_time.there[:, n], GREY, 0.7),
            (score.over_time.tracked[:, n], BLUE, 0.4),
        ):
            edges = np.diff(np.concatenate([[0], there.astype(np.int8), [0]]))
            begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
            stretches = [
                (float(since_s[a]), float((b - a) * step_s))
                for a, b in zip(begins, ends, strict=True)
            ]
            axes.broken_barh(stretches, (n - height / 2, height), color=colour, lw=0)
    if shown <= 25:
        names = [plain_text(each.drone[:NAME]) for each in score.drones[:shown]]
        axes.set_yticks(range(shown), names)
    axes.set_ylim(max(shown, 1) - 0.5, -0.5)
    rest = len(score.drones) - shown
    more = f"; {rest} more are not drawn" if rest else ""
    axes.set_xlabel(f"s; grey: in cover, blue: with a track{more}")


def _errors(axes: Any, score: Score) -> None:
    errors = score.errors
    if not len(errors):
        finish(axes, "", "", "", drawn=False, nothing="no track was of a drone")
        return
    every = -(-len(errors) // MOST_POINTS)
    order = np.argsort(errors.t_utc_ns, kind="stable")[::every]
    since_s = (errors.t_utc_ns[order] - score.start_utc_ns) / NS
    axes.plot(since_s, errors.distance_m[order], ".", color=BLUE, ms=2.0, label="one report")
    axes.axhline(score.reports.position_rms_m, color=ORANGE, lw=1.2, label="rms")
    axes.axhline(score.reports.position_p95_m, color=RED, lw=1.2, label="95 %")
    axes.set_ylim(bottom=0)
    finish(axes, "", "s", f"m {score.distances}")


def _spread(axes: Any, score: Score) -> None:
    errors = score.errors
    if not len(errors):
        finish(axes, "", "", "", drawn=False, nothing="no track was of a drone")
        return
    for column, name, colour in ((0, "east", BLUE), (1, "north", ORANGE), (2, "up", GREEN)):
        each_m = errors.error_enu_m[:, column]
        each_m = each_m[np.isfinite(each_m)]
        if len(each_m):
            counts, edges = np.histogram(each_m, BINS)
            axes.stairs(counts, edges, color=colour, lw=1.1, label=name)
    finish(axes, "", "m", "reports")


def _nees(axes: Any, score: Score) -> None:
    errors = score.errors
    tested = np.isfinite(errors.nees)
    order = np.argsort(errors.t_utc_ns[tested], kind="stable")
    since_s = (errors.t_utc_ns[tested][order] - score.start_utc_ns) / NS
    each = errors.nees[tested][order] / score.dimensions
    bins = np.linspace(0, max(float(since_s[-1]), 1e-9), min(BINS, max(len(each) // 5, 1)) + 1)
    which = np.clip(np.digitize(since_s, bins) - 1, 0, len(bins) - 2)
    many = np.bincount(which, minlength=len(bins) - 1)
    means = np.bincount(which, each, len(bins) - 1) / np.where(many, many, np.nan)
    axes.plot((bins[:-1] + bins[1:]) / 2, means, color=BLUE, lw=1.1, marker=".", label="mean")
    axes.axhline(1.0, color=GREY, lw=1.2, label="as claimed")
    axes.set_yscale("log")
    finish(axes, "", "s", "")


def _latency(axes: Any, score: Score) -> None:
    late_s = score.errors.latency_s[np.isfinite(score.errors.latency_s)]
    counts, edges = np.histogram(late_s, BINS)
    axes.stairs(counts, edges, color=BLUE, lw=1.1, fill=True, alpha=0.4)
    axes.axvline(score.reports.latency_p95_s, color=RED, lw=1.2, label="95 %")
    finish(axes, "", "s from the time of a report to when it was received", "reports")


STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 72em; padding: 0 1em;
  color: #1e293b; background: #fff; }
h1 { font-size: 1.5em; } h2 { font-size: 1.1em; margin: 2em 0 .4em; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .15em .8em .15em 0; text-align: right; border-bottom: 1px solid #e2e8f0; }
.l { text-align: left; white-space: pre-wrap; }
.verdict { font-size: 1.15em; font-weight: 600; padding: .5em .8em; background: #f1f5f9;
  border-left: 6px solid #64748b; }
.verdict.kept { border-color: #15803d; } .verdict.broken { border-color: #be123c; }
svg { max-width: 100%; height: auto; } .wide { overflow-x: auto; }
"""


def html_of(score: Score, profile: str, note: str, verdicts: Sequence[LimitVerdict]) -> str:
    """The page; needs matplotlib."""
    return "".join(_pieces(score, profile, note, verdicts))


def _pieces(
    score: Score, profile: str, note: str, verdicts: Sequence[LimitVerdict]
) -> Iterator[str]:
    title = escape(printable(f"Score: {score.scene or score.source}"))
    yield '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<title>{title}</title><style>{STYLE}</style></head><body>\n<h1>{title}</h1>\n"
    lasted_s = (score.end_utc_ns - score.start_utc_ns) / NS
    yield f"<p>{escape(printable(score.source))}: {len(score.drones)} drones, "
    yield f"{score.tracks} tracks, {lasted_s:.1f} s from {iso_utc(score.start_utc_ns)}. "
    yield f"Distances {score.distances}; beyond {score.settings.cutoff_m:g} m a track is of no "
    yield f"drone, older than {score.settings.stale_s:g} s it is not there.</p>\n"
    yield f'<p class="verdict{_mark(score, verdicts)}">{escape(closing(score, verdicts))}</p>\n'
    notes = [escape(printable(each)) for each in notes_of(score)]
    if notes:
        yield "<ul>" + "".join(f"<li>{each}</li>" for each in notes) + "</ul>\n"
    if verdicts:
        yield verdict_table(profile, verdicts).html()
        yield f"<p>{escape(printable(note))}</p>\n" if note else ""
    yield set_table(score).html()
    for name, svg in charts(score).items():
        yield f"<h2>{escape(name)}</h2>\n{svg}\n"
    for shown in tables_of(score):
        yield shown.html()
    yield "</body></html>\n"


def _mark(score: Score, verdicts: Sequence[LimitVerdict]) -> str:
    if score.failure or any(each.status == "failed" for each in verdicts):
        return " broken"
    return " kept" if verdicts else ""


FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""What no XML 1.0 document may hold, escaped or not."""


def junit_of(score: Score, profile: str, verdicts: Sequence[LimitVerdict]) -> bytes:
    """A suite with a case for the tracker and one for each limit.

    A limit that is broken is a failure, a tracker that failed an error, and what cannot be tested
    is skipped. Its time is that of the run.
    """
    failed = sum(each.status == "failed" for each in verdicts)
    skipped = sum(each.status == "not testable" for each in verdicts)
    counts = {
        "tests": str(len(verdicts) + 1),
        "failures": str(failed),
        "errors": str(int(bool(score.failure))),
        "skipped": str(skipped),
        "time": f"{(score.end_utc_ns - score.start_utc_ns) / NS:.3f}",
    }
    suites = Element("testsuites", counts)
    suite = SubElement(suites, "testsuite", {"name": clean(f"plotfeed score {profile}"), **counts})
    place = clean(f"plotfeed.score.{profile}")
    tracker = SubElement(suite, "testcase", classname=place, name="tracker", time="0")
    if score.failure:
        SubElement(tracker, "error", message=clean(score.failure), type="tracker")
    for each in verdicts:
        case = SubElement(suite, "testcase", classname=place, name=clean(each.name), time="0")
        if each.status == "failed":
            SubElement(case, "failure", message=clean(each.told), type="limit")
        elif each.status == "not testable":
            SubElement(case, "skipped", message=clean(each.told))
    text: bytes = tostring(suites, "utf-8")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + text + b"\n"


def clean(text: str) -> str:
    """Text without what XML may not hold."""
    return FORBIDDEN.sub("", text)


KEPT, BROKEN = 0, 1
"""Exit codes."""
NO_PROFILE = "no profile"


def score_recording(recording: Path, options: ScoreOptions) -> int:
    """Score a tracker and print what it came to; the exit code.

    That is 1 where the tracker failed or a limit of the profile is broken, or the feed is not as
    claimed. Raises `PlotfeedError` and `OSError`.
    """
    if options.feed:
        return _check_feed(recording, options)
    for path in (options.out, options.junit):
        if path is not None:
            refuse_if_there(path, force=options.force)  # before anything is read in vain
    if options.out is not None:
        need_extra("matplotlib.figure", "a chart", "charts")
    profile = None if options.profile is None else load_profile(options.profile)
    settings = settings_of(profile, options)
    scene = scene_of(recording)
    truths = read_truths(recording, scene)
    file = recording if options.tracks is None else options.tracks
    first_ns = min((int(p.t_utc_ns[0]) for p in truths.paths if len(p.t_utc_ns)), default=0)
    tracks = read_tracks(file, scene, options.topics, date_utc_ns=first_ns // DAY_NS * DAY_NS)
    score = score_run(truths, tracks, settings)
    verdicts = [] if profile is None else verdicts_of(score, profile)
    publish(score, profile, verdicts, options)
    return KEPT if is_kept(verdicts, score.failure) else BROKEN


def _check_feed(recording: Path, options: ScoreOptions) -> int:
    """Check the feed and print what it came to."""
    for name in ("tracks", "topics", "out", "junit", "profile", "cutoff_m", "stale_s", "protect"):
        if getattr(options, name):
            option = {"topics": "topic"}.get(name, name.replace("_", "-"))
            raise PlotfeedError(f"--feed checks sensors, and --{option} is about a tracker")
    verdict = check_feed(recording)
    if options.as_json:
        say(json.dumps(as_json(verdict)))
    else:
        for line in as_text(verdict):
            say(line)
    return BROKEN if verdict.wrong else KEPT


def settings_of(profile: ScoreProfile | None, options: ScoreOptions) -> ScoreSettings:
    """How tracks are scored: as the profile says, and as options say that stand before it."""
    found = ScoreSettings() if profile is None else profile.score_settings()
    if options.cutoff_m is not None:
        found = replace(found, cutoff_m=options.cutoff_m)
    if options.stale_s is not None:
        found = replace(found, stale_s=options.stale_s)
    if options.protect is not None:
        parts = options.protect.split(",")
        try:
            latitude_deg, longitude_deg = map(float, parts)
        except ValueError:
            raise PlotfeedError(
                f"--protect: expected LATITUDE,LONGITUDE in degrees, not {options.protect!r}"
            ) from None
        found = replace(found, protected_deg=(latitude_deg, longitude_deg))
    return found


def publish(
    score: Score,
    profile: ScoreProfile | None,
    verdicts: Sequence[LimitVerdict],
    options: ScoreOptions,
) -> None:
    """Print a score, and write the files that are asked for."""
    title = "" if profile is None else profile.profile.title
    note = "" if profile is None else profile.profile.note
    if options.out is not None:
        _write(options.out, html_of(score, title, note, verdicts).encode(), force=options.force)
    if options.junit is not None:
        text = junit_of(score, title or NO_PROFILE, verdicts)
        _write(options.junit, text, force=options.force)
    if options.as_json:
        say(json.dumps(as_values(score, title, verdicts)))
    else:
        for line in lines(score, title, verdicts):
            say(line)


def _write(path: Path, octets: bytes, *, force: bool) -> None:
    with BufferedWriter(new_file(path, force=force)) as file:
        file.write(octets)
