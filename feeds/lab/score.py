"""`plotfeed score`: a score as text, JSON, HTML and JUnit's XML, and a profile's limits on it."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from html import escape
from importlib.metadata import version
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
from plotfeed.feeds.lab.diagnosis import diagnosed
from plotfeed.feeds.lab.flights import read_trial, scene_of
from plotfeed.feeds.lab.gathering import FeedReport
from plotfeed.feeds.lab.lab_settings import ScoreOptions
from plotfeed.feeds.lab.pictures import figure_of, finish, plain_text, svg_of
from plotfeed.feeds.lab.possible import RecordedRun, possible, read_run
from plotfeed.feeds.lab.report import feed_lines
from plotfeed.feeds.lab.scoring import FIGURE_NAMES, REPORTS, SETS, Figures, Score, ScoreSettings
from plotfeed.feeds.lab.tables import Table, TextColumn, number, of_cells
from plotfeed.feeds.recording.recorded_tracks import TracksRead, read_tracks
from plotfeed.feeds.scene.fields import SceneTable
from plotfeed.feeds.scene.problems import in_a_line, problems_of
from plotfeed.models.state import Floats, Ints
from plotfeed.models.track_metrics import stretches
from plotfeed.models.verdicts import RISK, Decision, FigureSamples, Interval, decided, times_more
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
        needed, _ = WORKED_OUT.get(self.figure, (None, None))
        if needed is None and self.figure not in FIGURE_NAMES:
            raise ValueError(
                f"figure: expected one of {', '.join(WORKED_OUT)}, or of the figures of a score"
            )
        for parameter, _ in WORKED_OUT.values():
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
    settings: ScoreSettings = Field(default_factory=ScoreSettings)
    limit: Annotated[list[ScoreLimit], Field(min_length=1, max_length=1000)]


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
        return ScoreProfile.model_validate(tree)
    except ValidationError as error:
        raise PlotfeedError(f"{name}: {in_a_line(problems_of(error, tree))}") from None
    except (ValueError, RecursionError) as error:
        raise PlotfeedError(f"{name}: no TOML: {error}") from None


class LimitVerdict:
    """A limit, and whether what is known of a figure decides that it is kept."""

    def __init__(self, limit: ScoreLimit, figure: str, found: Interval, of: int, unit: str) -> None:
        """Judge an interval; `unit` says what more of which would decide."""
        alone = not unit and not math.isnan(found.value)
        held = Interval(*[found.value] * 3) if alone else found
        status, note = decided(held, limit.at_most, limit.at_least), "of this run" * alone
        if status == "undecided":
            bound = limit.at_most if limit.at_most is not None else limit.at_least
            more = times_more(found, bound or 0.0)
            note = f"about {more:.2g} times as {unit} would decide" if more < 1e4 else ""
        if limit.figure in SETS:
            how = "as stamped" if figure == limit.figure else "as known"
            note = f"{how}; {note}" if note else how
        self.name, self.figure, self.asked = limit.title, limit.figure, limit.asked
        # The figure lies between low and high; they are not known of what is of this run alone.
        self.value, self.low, self.high = found
        self.status: Decision = status
        self.of = of  # How many reports, periods, drones or runs it is of; 0 if that says nothing
        self.note = note

    @property
    def told(self) -> str:
        """The figure beside what is asked."""
        value = "not known" if math.isnan(self.value) else f"{self.value:.6g}"
        between = "" if math.isnan(self.low) else f" ({self.low:.6g} to {self.high:.6g})"
        many = f" (of {self.of})" if self.of else ""
        noted = f": {self.note}" if self.note else ""
        return f"{self.figure} {value}{between}{many}, asked {self.asked}{noted}"

    def at(self, level: object) -> Self:
        """A copy of the verdict whose name says at which level it is."""
        named = copy(self)
        named.name = f"{self.name} ({level})"
        return named


def verdicts_of(score: Score, profile: ScoreProfile) -> list[LimitVerdict]:
    """Every limit of a profile, in its order: all of them wrong in no more runs than `RISK`.

    What sets of tracks are asked is of what was known at the time, where that is known.
    """
    risk, found = RISK / len(profile.limit), []
    for limit in profile.limit:
        value, samples = samples_of(score, limit)
        figure = judged_figure(limit, is_known=score.as_known is not None)
        bounds = Interval(value, math.nan, math.nan) if samples is None else samples.interval(risk)
        of = len(samples.parts) if samples is not None and limit.figure in WORKED_OUT else 0
        unit = "" if samples is None else "long a run"
        found.append(LimitVerdict(limit, figure, bounds, of, unit))
    return found


def judged_figure(limit: ScoreLimit, *, is_known: bool) -> str:
    """The figure that a limit is of: of sets as known, where that is known."""
    return f"known_{limit.figure}" if is_known and limit.figure in SETS else limit.figure


def samples_of(score: Score, limit: ScoreLimit) -> tuple[float, FigureSamples | None]:
    """The figure that a limit is of, NaN if not known, and what it is of; None: this run alone."""
    if limit.figure not in WORKED_OUT:
        figure = judged_figure(limit, is_known=score.as_known is not None)
        return score.figures()[figure], score.samples.get(figure)
    parameter, worked_out = WORKED_OUT[limit.figure]
    samples = worked_out(score, getattr(limit, parameter))
    return samples.value, samples


def _in_cover(score: Score) -> Iterator[tuple[int, int, int, Ints]]:
    """Each drone as often as it came into cover, from when to when, and when its reports came."""
    for drone, stays in enumerate(score.stays_utc_ns):
        times = np.sort(score.errors.known_utc_ns[score.errors.drone == drone])
        for begin_ns, end_ns in stays:
            yield drone, begin_ns, end_ns, times


def _share(parts: Iterable[tuple[int, Any, Floats]]) -> FigureSamples:
    """A share of what drones had, one after the other: the drone, and what of which whole."""
    rows = [np.stack([part, whole, np.full(len(part), drone)]) for drone, part, whole in parts]
    hits, wholes, drones = np.concatenate([np.zeros((3, 0)), *rows], axis=1)
    return FigureSamples(hits, wholes, drones.astype(np.int64), is_share=True)


def update_share(score: Score, period_s: float) -> FigureSamples:
    """The share of whole periods in cover in which a report of the drone was received.

    By when reports are of, a tracker that holds back minutes of them would miss no period.
    """
    period_ns, found = round(period_s * NS), []
    for drone, begin_ns, end_ns, times in _in_cover(score):
        periods = np.arange(-(-begin_ns // period_ns), end_ns // period_ns)
        found.append((drone, np.isin(periods, times // period_ns), np.ones(len(periods))))
    return _share(found)


def long_gap_share(score: Score, longer_than_s: float) -> FigureSamples:
    """The share of the time of drones in cover that lies in gaps longer than that, by gaps.

    A gap is from when one report of the drone is received to the next, from when it comes to its
    first, and from its last to when it goes.
    """
    found = []
    for drone, begin_ns, end_ns, times in _in_cover(score):
        inside = times[(times >= begin_ns) & (times <= end_ns)]
        gaps_s = np.diff(np.concatenate([[begin_ns], inside, [end_ns]])) / NS
        found.append((drone, np.where(gaps_s > longer_than_s, gaps_s, 0.0), gaps_s))
    return _share(found)


def far_share(score: Score, beyond_m: float) -> FigureSamples:
    """The share of reports that are further over the ground from any drone."""
    known_m: Floats = score.nearest_m[np.isfinite(score.nearest_m)]
    return _share([(0, known_m > beyond_m, np.ones(len(known_m)))])


# Figures that need one more number: by which key it is told, and how they are worked out.
WORKED_OUT: Mapping[str, tuple[str, Callable[[Score, float], FigureSamples]]] = {
    "update_share": ("period_s", update_share),
    "long_gap_share": ("longer_than_s", long_gap_share),
    "far_share": ("beyond_m", far_share),
}


class ScoreReport:
    """A score, and all that is said of it."""

    def __init__(
        self, run: RecordedRun, tracks: TracksRead, settings: ScoreSettings,
        profile: ScoreProfile | None,
    ) -> None:  # fmt: skip
        self.score = Score(run.truths, tracks, settings)
        # Of the profile, and what that notes.
        self.title = "" if profile is None else profile.profile.title
        self.note = "" if profile is None else profile.profile.note
        self.verdicts = [] if profile is None else verdicts_of(self.score, profile)
        self.diagnosis = diagnosed(run.truths, tracks, settings)
        self.possible = possible(run, self.score)

    @property
    def is_kept(self) -> bool:
        """Whether no limit is broken, and the tracker did not fail."""
        return mark_of(self.score.failure, self.verdicts) != "broken"

    def head(self) -> list[str]:
        """What was scored, and how."""
        score = self.score
        lasted_s = (score.end_utc_ns - score.start_utc_ns) / NS
        of_scene = f"scene {score.scene}, " if score.scene else ""
        return [
            f"{score.source}: {of_scene}{score.counted} drone(s), {score.tracks} track(s), "
            f"{lasted_s:.1f} s from {iso_utc(score.start_utc_ns)}",
            f"distances {score.distances}; beyond {score.settings.cutoff_m:g} m a track is of no "
            f"drone, older than {score.settings.stale_s:g} s it is not there",
        ]

    def notes(self) -> Iterator[str]:
        """What is wrong with all, what was possible, what was left out, how the tracker failed."""
        score = self.score
        if self.diagnosis is not None:
            of = (score, self.diagnosis.without)
            now, then = (f"{s.as_stamped.gospa_m:.1f}" for s in of)
            yield f"your {', then '.join(self.diagnosis.findings)}"
            yield f"without that GOSPA would be {then} m, where it is {now} m as stamped"
        if self.possible is not None:
            yield str(self.possible)
        yield from score.notes
        for reason, many in score.left_out.items():
            yield f"{many} reports: {reason}"
        if score.failure:
            yield score.failure

    def tables(self) -> Iterator[Table]:
        """All tables, that of verdicts first."""
        if self.verdicts:
            yield Table(printable(self.title), LIMITS, self.verdicts)
        yield from tables_of(self.score)

    def closing(self) -> str:
        """The verdict in a line."""
        return closing(self.score.failure, self.verdicts)

    def as_values(self) -> dict[str, Any]:
        """The score for JSON; null for what is not known."""
        score, found = self.score, self.diagnosis
        values: dict[str, Any] = finite(
            {
                "scene": score.scene,
                "source": score.source,
                "start_utc": iso_utc(score.start_utc_ns),
                "end_utc": iso_utc(score.end_utc_ns),
                "dimensions": score.settings.dimensions,
                "settings": score.settings.model_dump(),
                "figures": score.figures(),
                "drones": [vars(each) for each in score.drones],
                "sensors": [vars(each) for each in score.sensors],
                "left_out": dict(score.left_out),
                "failure": score.failure,
                "notes": list(score.notes),
                "findings": [] if found is None else list(found.findings),
                "figures_without": None if found is None else found.without.figures(),
                "possible": None if self.possible is None else vars(self.possible),
                "profile": self.title,
                "limits": [vars(each) for each in self.verdicts],
            }
        )
        return values


DRONES_TOLD = 50  # In text; JSON has all


def lines(told: ScoreReport) -> Iterator[str]:
    """All lines of a score, the verdict last."""
    first, second = told.head()
    yield from (printable(first), f"  {second}")
    for note in told.notes():
        yield f"  note: {printable(note)}"
    tables = list(told.tables())
    if told.verdicts:  # beside the last line, which is of them
        tables.append(tables.pop(0))
    for shown in tables:
        yield from shown.lines(DRONES_TOLD)
    yield ""
    yield told.closing()


def tables_of(score: Score) -> Iterator[Table]:
    """All tables of a score but that of verdicts."""
    of: tuple[Figures, ...] = (score.as_stamped, score.as_known or Figures(), score.in_space)
    rows = [
        (text, *(number(each[name], form) for each in of)) for name, (text, form) in SETS.items()
    ]
    heads = ("", "as stamped", "as known", "in space")
    yield Table("Tracks beside drones, over time", of_cells(heads, "<>>>"), rows)
    of = (score.reports, score.in_space)
    told = [
        (text, *(number(e[n], form) for e in of)) for n, (text, form) in REPORTS.items() if text
    ]
    title = f"Reports, {score.reports.reports:.0f}, each at its own time"
    yield Table(title, of_cells(("error", score.distances, "in space"), "<>>"), told)
    many = score.counted - score.never_tracked
    beginnings = [
        ("drones that had a track", f"{many} of {score.counted}"),
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
    TextColumn("from", "low", ".6g"),
    TextColumn("to", "high", ".6g"),
    TextColumn("asked", "asked"),
    TextColumn("of", lambda limit: str(limit.of or ""), "s"),
    TextColumn("", "note"),
)


def mark_of(failure: str, verdicts: Sequence[LimitVerdict]) -> Literal["broken", "kept", ""]:
    """How a page marks verdicts: kept where all are passed, and nothing where any is undecided."""
    if failure or any(each.status == "failed" for each in verdicts):
        return "broken"
    return "kept" if verdicts and all(each.status == "passed" for each in verdicts) else ""


def closing(failure: str, verdicts: Sequence[LimitVerdict], where: str = "") -> str:
    """The verdict in a line; `where` says of which verdicts together the risk is told."""
    if failure:
        return f"The tracker failed: {printable(failure)}."
    if not verdicts:
        return "No profile: nothing is judged. --profile asks for limits."
    counts = Counter(verdict.status for verdict in verdicts)
    told = [f"{counts['passed']} of {len(verdicts)} limits kept"]
    told += [f"{n} {status}" for status, n in sorted(counts.items()) if status != "passed"]
    return f"{', '.join(told)}; {where}any verdict is wrong in at most {RISK:.0%} of such runs."


INCHES = (11.0, 3.0)
MOST_POINTS = 1200  # Of a line: more are drawn as means
MOST_DRONES = 60  # In the chart of drones: the first ones
BLUE, ORANGE, RED, GREY, GREEN = "#1d4ed8", "#c2410c", "#be123c", "#94a3b8", "#15803d"
BINS = 60
NAME = 16


def charts(score: Score) -> dict[str, str]:
    """Charts by their titles, each as an SVG element; needs matplotlib."""
    drawn: dict[str, Callable[[Any, Score], None]] = {
        "Where drones had a track, and where not": _map,
        "GOSPA over time, and its parts": _gospa,
        "When each drone had a track": _drones,
        "Errors of reports over time": _errors,
    }
    if np.isfinite(score.errors.nees).any():
        drawn["NEES over its degrees of freedom: 1 for an honest tracker"] = _nees
    if np.isfinite(score.errors.latency_s).any():
        drawn["Latency of reports"] = _latency
    settings: Any = {"svg.fonttype": "none", "font.size": 9.0}
    beside: Any = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "frameon": False}
    found = {}
    for title, draw in drawn.items():
        with figure_of(INCHES, **settings) as figure:
            axes = figure.subplots()
            draw(axes, score)
            if axes.get_legend_handles_labels()[0]:
                axes.legend(**beside, fontsize=8.5)
            found[title] = svg_of(figure)
    return found


def _thinned(x: Floats, *columns: Floats) -> list[Floats]:
    """Columns, or means of neighbours where there are too many to be drawn."""
    every = -(-len(x) // MOST_POINTS)
    if every <= 1:
        return [x, *columns]
    whole = len(x) // every * every
    return [column[:whole].reshape(-1, every).mean(axis=1) for column in (x, *columns)]


def _map(axes: Any, score: Score) -> None:
    for (name, places_m), colour in zip(score.places.items(), (GREY, RED, ORANGE), strict=True):
        shown = places_m[:: -(-len(places_m) // MOST_POINTS) or 1]
        if len(shown):
            axes.plot(*shown.T, ".", color=colour, ms=3.0, label=name)
    axes.set_aspect("equal", adjustable="datalim")
    finish(axes, "", "m east", "m north")


def _gospa(axes: Any, score: Score) -> None:
    steps, power = score.steps, 1.0 / score.settings.order
    total = (steps.localisation + steps.missed + steps.false) ** power
    x, total, location, missed, false = _thinned(
        score.since_s, total, steps.localisation**power, steps.missed**power, steps.false**power
    )
    axes.plot(x, missed, color=RED, lw=0.9, label="drones without a track")
    axes.plot(x, false, color=ORANGE, lw=0.9, label="tracks of no drone")
    axes.plot(x, location, color=GREEN, lw=0.9, label="localisation")
    axes.plot(x, total, color=BLUE, lw=1.4, label="GOSPA")
    finish(axes, "", "s", "m")


def _drones(axes: Any, score: Score) -> None:
    shown, step_s = min(len(score.drones), MOST_DRONES), score.settings.step_s
    since_s = score.since_s
    for n in range(shown):
        for there, colour, height in (
            (score.there[:, n], GREY, 0.7),
            (score.tracked[:, n], BLUE, 0.4),
        ):
            begins, ends = stretches(there[:, None])
            bars = np.stack([since_s[begins], (ends - begins) * step_s], axis=1).tolist()
            axes.broken_barh(bars, (n - height / 2, height), color=colour, lw=0)
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


def _nees(axes: Any, score: Score) -> None:
    errors = score.errors
    tested = np.isfinite(errors.nees)
    order = np.argsort(errors.t_utc_ns[tested], kind="stable")
    since_s = (errors.t_utc_ns[tested][order] - score.start_utc_ns) / NS
    each = errors.nees[tested][order] / score.settings.dimensions
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


# For who signs, not for who builds.
GLOSSARY = {
    "GOSPA": "how far tracks and drones are apart as sets: errors, missed drones and false tracks.",
    "as stamped, as known": "by the times that reports are of, or by when they were there to use.",
    "completeness": "of the drones that were there, the share that had a track.",
    "spuriousness": "of the tracks, the share that is of no drone.",
    "swap": "a track passes from one drone to another.",
    "NEES": "errors beside what the tracker claims of them: 1 is honest, more is too sure.",
    "lag": "how long ago the drone was where its track is.",
    "passed, failed": "decided with the stated risk; undecided: a longer run, or more, would tell.",
}


def page(title: str, verdict: str, mark: str, parts: Iterable[str]) -> bytes:
    """One file of HTML: a title, the verdict, parts, words, and the version that made it."""
    words = "".join(f"<dt>{escape(w)}</dt><dd>{escape(m)}</dd>" for w, m in GLOSSARY.items())
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>\n"
        f'<h1>{escape(title)}</h1>\n<p class="verdict {mark}">{escape(verdict)}</p>\n'
        f"{''.join(parts)}<h2>Words</h2>\n<dl>{words}</dl>\n"
        f"<p>plotfeed {version('plotfeed')}</p>\n</body></html>\n"
    ).encode()


def html_of(told: ScoreReport) -> bytes:
    """The page of a score; needs matplotlib."""
    score = told.score
    mark = mark_of(score.failure, told.verdicts)
    parts = [f"<p>{escape(printable(line))}</p>\n" for line in told.head()]
    notes = "".join(f"<li>{escape(printable(each))}</li>" for each in told.notes())
    parts.append(f"<ul>{notes}</ul>\n" if notes else "")
    tables = [table.html() for table in told.tables()]
    first = 2 if told.verdicts else 1
    parts += [*tables[:first], f"<p>{escape(printable(told.note))}</p>\n" if told.note else ""]
    parts += [f"<h2>{escape(name)}</h2>\n{svg}\n" for name, svg in charts(score).items()]
    title = printable(f"Score: {score.scene or score.source}")
    return page(title, told.closing(), mark, [*parts, *tables[first:]])


# What no XML 1.0 document may hold, escaped or not.
FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_of(
    profile: str, verdicts: Sequence[LimitVerdict], failure: str, lasted_s: float
) -> bytes:
    """A suite with a case for the tracker and one for each limit.

    A limit that is broken is a failure, a tracker that failed an error, and what cannot be tested
    or decided is skipped. Its time is that of the run.
    """
    failed = sum(each.status == "failed" for each in verdicts)
    skipped = sum(each.status in ("undecided", "not testable") for each in verdicts)
    counts = {
        "tests": str(len(verdicts) + 1),
        "failures": str(failed),
        "errors": str(int(bool(failure))),
        "skipped": str(skipped),
        "time": f"{lasted_s:.3f}",
    }
    suites = Element("testsuites", counts)
    suite = SubElement(suites, "testsuite", {"name": clean(f"plotfeed score {profile}"), **counts})
    place = clean(f"plotfeed.score.{profile}")
    tracker = SubElement(suite, "testcase", classname=place, name="tracker", time="0")
    if failure:
        SubElement(tracker, "error", message=clean(failure), type="tracker")
    for each in verdicts:
        case = SubElement(suite, "testcase", classname=place, name=clean(each.name), time="0")
        if each.status == "failed":
            SubElement(case, "failure", message=clean(each.told), type="limit")
        elif each.status != "passed":
            SubElement(case, "skipped", message=clean(each.told))
    text: bytes = tostring(suites, "utf-8")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + text + b"\n"


def clean(text: str) -> str:
    """Text without what XML may not hold."""
    return FORBIDDEN.sub("", text)


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
    settings = settings_of(profile, options.changes)
    scene = scene_of(recording)
    file = recording if options.tracks is None else options.tracks
    if options.truth:
        times_ns = read_tracks(file, scene, options.topics).reports.t_utc_ns
        dated_ns = times_ns[times_ns > 2 * DAY_NS]  # those of raw files are of no day
        midnight_ns = int(dated_ns.min()) // DAY_NS * DAY_NS if len(dated_ns) else 0
        run = RecordedRun(read_trial(options.truth, scene, date_utc_ns=midnight_ns))
    else:
        run = read_run(recording, scene)
    midnight_ns = run.truths.start_utc_ns // DAY_NS * DAY_NS
    tracks = read_tracks(file, scene, options.topics, date_utc_ns=midnight_ns)
    told = ScoreReport(run, tracks, settings, profile)
    score = told.score
    if options.out is not None:
        write_new(options.out, html_of(told), force=options.force)
    if options.junit is not None:
        lasted_s = (score.end_utc_ns - score.start_utc_ns) / NS
        text = junit_of(told.title or NO_PROFILE, told.verdicts, score.failure, lasted_s)
        write_new(options.junit, text, force=options.force)
    for line in [json.dumps(told.as_values())] if options.as_json else lines(told):
        say(line)
    return int(not told.is_kept)


def _check_feed(recording: Path, options: ScoreOptions) -> int:
    """Check the feed and print what it came to."""
    for name in ("tracks", "truth", "topics", "out", "junit", "profile", "changes"):
        if getattr(options, name):
            option = {"topics": "topic", "changes": "set"}.get(name, name)
            raise PlotfeedError(f"--feed checks sensors, and --{option} is about a tracker")
    told = FeedReport(recording, "claimed")
    for line in [json.dumps(told.as_values())] if options.as_json else feed_lines(told):
        say(line)
    return int(bool(told.verdicts.wrong))


def settings_of(profile: ScoreProfile | None, changes: Sequence[str]) -> ScoreSettings:
    """How tracks are scored: as the profile says, and as `KEY=VALUE` says that stand before it."""
    tree = {} if profile is None else profile.settings.model_dump(exclude_unset=True)
    for change in changes:
        key, _, value = change.partition("=")
        try:
            tree |= tomllib.loads(f"{key} = {value}")
        except ValueError:
            raise PlotfeedError(f"--set {change}: expected KEY=VALUE as in a profile") from None
    try:
        return ScoreSettings.model_validate(tree)
    except ValidationError as error:
        raise PlotfeedError(f"--set {in_a_line(problems_of(error, tree))}") from None


def write_new(path: Path, octets: bytes, *, force: bool) -> None:
    """Write a file, which is there already only where `force` says so."""
    with BufferedWriter(new_file(path, force=force)) as file:
        file.write(octets)
