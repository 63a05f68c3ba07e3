"""`plotfeed score SCENE --tracker`: a tracker beside sessions, at levels of keys; its curve."""

from __future__ import annotations

import asyncio
import contextlib
import math
import re
import shlex
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import asdict, dataclass, replace
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np

from plotfeed.feeds.console.companion import Companion, beside
from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.printed import finite, printable, say
from plotfeed.feeds.console.process import refuse_if_there
from plotfeed.feeds.lab import pictures
from plotfeed.feeds.lab.flights import FlightsTally
from plotfeed.feeds.lab.lab_settings import ScoreOptions, TrackerSettings, tell
from plotfeed.feeds.lab.possible import POSSIBLE, KnownPlots, RecordedRun, plots_of, possible
from plotfeed.feeds.lab.runs import NAME, Journal, RunJob, digests, finish_runs
from plotfeed.feeds.lab.score import (
    LIMITS,
    NO_PROFILE,
    LimitVerdict,
    ScoreLimit,
    ScoreProfile,
    closing,
    judged_figure,
    junit_of,
    load_profile,
    mark_of,
    page,
    samples_of,
    settings_of,
    write_new,
)
from plotfeed.feeds.lab.scoring import COUNTS, FIGURE_NAMES, NoFlightError, Score, ScoreSettings
from plotfeed.feeds.lab.sweep import Results, figure_columns, key_columns, level_rows, span_of
from plotfeed.feeds.lab.tables import Table, TextColumn, of_cells, write_table
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.recorded_tracks import UNKNOWN_NS, TrackTable
from plotfeed.feeds.scene.fields import frame_at, site_frame
from plotfeed.feeds.scene.levels import SweepLevel, levels_of, scene_of
from plotfeed.feeds.scene.output_keys import WaysOut
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.varied_keys import VariedKey
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run_over
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.brokers import brokers_of
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.models.state import Floats
from plotfeed.models.verdicts import (
    POCOCK,
    RISK,
    FigureSamples,
    Interval,
    breaking_level,
    look_risk,
    mean_interval,
    seeds_interval,
)
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.ledger import LedgerTables, tables_of
from plotfeed.proto.utc import NS

# On which a tracker publishes, unless the scene's page.tracks_topic or an option says.
USUAL_TOPIC = "tracker/tracks"
CONNECT_S = 5.0
LAST_WORDS_S = 1.0  # A tracker has so long for its tracks of the last plots
MAX_MESSAGES = 1_000_000  # Of tracks that are taken in a run
# What a command may have in braces, and as PLOTFEED_TRACKER_... in its environment.
PLACES = ("broker", "broker5", "host", "port", "port5", "prefix", "topic", "seed")
_PLACE = re.compile(r"\{(\w+)\}")


@dataclass(frozen=True, slots=True)
class TrackerCommand:
    """A tracker under test, by its name and the words that start it."""

    name: str
    words: tuple[str, ...]

    @classmethod
    def parse(cls, text: str) -> Self:
        """`[NAME=]COMMAND`, words as in a shell; raises `PlotfeedError` if there is no such."""
        named = re.match(r"([\w-]+)=(.+)", text, re.DOTALL)
        name, command = (named[1], named[2]) if named else ("tracker", text)
        try:
            words = shlex.split(command)
        except ValueError as error:
            raise PlotfeedError(f"--tracker {command}: {error}") from None
        if not words or shutil.which(words[0]) is None:
            raise PlotfeedError(f"--tracker: no program {(words or [''])[0]!r} can be started")
        for word in words:
            for place in _PLACE.findall(word):
                if place not in PLACES:
                    there = ", ".join(PLACES)
                    raise PlotfeedError(f"--tracker: {{{place}}}: expected one of {there}")
        return cls(name, tuple(words))

    def filled(self, values: Mapping[str, str]) -> list[str]:
        """Words of the command, with values in place of what stands in braces."""
        return [_PLACE.sub(lambda found: values[found[1]], word) for word in self.words]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerPlan:
    """What runs of a tracker have in common at all levels."""

    settings: TrackerSettings
    topic: str | None
    how: ScoreSettings
    limits: Sequence[ScoreLimit]  # Of a profile
    trackers: Sequence[TrackerCommand]

    def of(self, level: SweepLevel) -> TrackerCommand:
        """The tracker that runs at a level."""
        return self.trackers[level.number % len(self.trackers)]


def run_tracker(job: RunJob) -> dict[str, Any]:
    """The figures of a run, NaN and infinite ones too, and how the tracker failed if it did.

    Where there is nothing to score, `unscored` says why. Raises `PlotfeedError` without a broker.
    """
    return asyncio.run(_run(job))


async def _run(job: RunJob) -> dict[str, Any]:
    plan, asked, scene = job.plan, job.plan.settings, scene_of(job.level)
    # The run's seed; no truth, which no tracker is to know; and nothing leaves but to its broker.
    general = scene.scene.model_copy(update={"seed": job.seed})
    mqtt = scene.mqtt.model_copy(update={"truth": False})
    scene = scene.model_copy(update={"scene": general, "mqtt": mqtt}).sent_to(WaysOut())
    start_ns, duration_s = span_of(scene, asked.duration)
    clock = WallClock(start_ns, speed=asked.speed)
    site = site_frame(scene.scene.site)
    followed, table, heard = _Followed(scene), TrackTable(), 0

    def take(_topic: str, payload: bytes, content_type: str | None) -> None:
        """What the tracker published, by the session's time, whatever it is."""
        nonlocal heard
        heard += 1
        if heard <= MAX_MESSAGES:
            table.take(payload, content_type or "", clock.now_ns(), site)

    topic = plan.topic or scene.page.tracks_topic or USUAL_TOPIC
    async with contextlib.AsyncExitStack() as around:
        brokers = await around.enter_async_context(brokers_of(scene, None))
        (broker,), _ = brokers
        link = MqttTransport(broker, "plotfeed-score", subscribe=[topic], on_message=take)
        await around.enter_async_context(link.connected(CONNECT_S))
        started = _started(job, broker, scene.mqtt.prefix, topic)
        tracker = await around.enter_async_context(started)
        await tracker.wait_until_ready(asked.patience)
        await run_over(brokers, scene, clock=clock, duration_s=duration_s, observers=[followed])
        await asyncio.sleep(LAST_WORDS_S)
        flooded = f"the tracker published more than {MAX_MESSAGES} messages"
        failure = tracker.failure() or (flooded if heard > MAX_MESSAGES else "")
    late_s: list[Floats] = [np.zeros(1)]  # By how much the machine itself was late
    for told in followed.ledgers:
        followed.tally.add(told)
        sent = told.messages.rows(told.messages.delivered)
        late_s.append((sent.sent_utc_ns - sent.link_due_utc_ns) / NS)
    truths = followed.tally.truths(site=site, scene=scene.scene.name)
    figures, nothing = dict.fromkeys([*FIGURE_NAMES, *POSSIBLE], math.nan), ""
    limits: list[tuple[float, FigureSamples | None]] = [(math.nan, None)] * len(plan.limits)
    try:
        score = Score(truths, table.read(topic, failure), plan.how)
    except NoFlightError as error:
        nothing = str(error)
    else:
        failure = score.failure
        limits = [samples_of(score, limit) for limit in plan.limits]
        found = possible(RecordedRun(truths, followed.plots, followed.placeless), score)
        figures |= score.figures() | ({} if found is None else found.figures())
    return {
        "level": job.level.number,
        "run": job.run,
        "seed": job.seed,
        "failure": failure,
        "unscored": nothing,
        "late_s": float(np.quantile(np.concatenate(late_s), 0.95)),
        "figures": figures,
        "limits": [value for value, _ in limits],
        "trials": [np.nan if of is None else of.trials for _, of in limits],
    }


class _Followed(Observer):
    """Takes the ledger of a session, and plots with whose they are."""

    def __init__(self, scene: Scene) -> None:
        site, sensors = scene.scene.site, scene.sensor
        self._frames = {sensor.id: frame_at(site, sensor.position_enu_m) for sensor in sensors}
        self.tally = FlightsTally(self._frames, max(s.scan.period_s for s in sensors))
        self.ledgers: list[LedgerTables] = []  # Counted after the run, which they would hold up
        self.plots: list[KnownPlots] = []
        self.placeless = 0

    def ledger(self, message: Message) -> None:
        """A sector is told of."""
        self.ledgers.append(tables_of([message.payload]))

    def settled(self, batch: Batch, sent: Sequence[pb.Sent]) -> None:
        """What became of a sector's plots is known."""
        if not len(batch.plots) or batch.sensor not in self._frames:
            return
        came_ns = [each.sent_utc_ns for each in sent if each.delivered]
        drone = np.array([batch.names[n] if n >= 0 else "" for n in batch.plots.drone], np.object_)
        arrived_ns = min(came_ns, default=UNKNOWN_NS)
        found, without = plots_of(drone, batch.plots, self._frames[batch.sensor], arrived_ns)
        self.plots.append(found)
        self.placeless += without


def _started(
    job: RunJob, broker: BrokerAddress, prefix: str, topic: str
) -> AbstractAsyncContextManager[Companion]:
    """The tracker's process, which is gone afterwards with all that it has started."""
    url, port = f"mqtt://{broker.host}:{broker.port}", str(broker.port)
    told_of = (url, url, broker.host, port, port, prefix, topic, str(job.seed))
    values = dict(zip(PLACES, told_of, strict=True))
    told = {f"PLOTFEED_TRACKER_{name.upper()}": value for name, value in values.items()}
    return beside(job.plan.of(job.level).filled(values), told, "tracker")


# Figures of the printed table and the picture, with their titles and how they are printed: as known
# at the time, so that lateness costs.
SHOWN = {
    "known_gospa_m": ("GOSPA, m", ".1f"),
    "gospa_feed_m": ("by feed", ".1f"),
    "gospa_link_m": ("by link", ".1f"),
    "gospa_tracker_m": ("by tracker", ".1f"),
    "known_completeness": ("completeness", ".3f"),
    "known_spuriousness": ("spuriousness", ".3f"),
    "known_position_accuracy_m": ("mean error, m", ".1f"),
    "latency_p95_s": ("latency p95, s", ".2f"),
    "initiation_median_s": ("initiation, s", ".1f"),
}
INCHES = (15.0, 11.0)
# A machine that is later than this, or than such a share of what is varied, tells of itself.
LATE_S, LATE_SHARE = 0.1, 0.1
# Of which verdicts the risk is told: those of all levels together are wrong more often.
AT_A_LEVEL = "at each level "


class CurvePoint:
    """A tracker at one level: means over runs, with intervals, and verdicts on the limits."""

    def __init__(
        self,
        level: SweepLevel,
        tracker: str,
        results: Results,
        asked: Sequence[ScoreLimit],
        looks: int,
    ) -> None:
        """Judge the runs of the level, as its journal has them, at each of so many looks."""
        runs = [result for (number, _), result in results.items() if number == level.number]

        def column(of: str, name: Any) -> Floats:
            return np.array([run[of][name] for run in runs], np.float64)

        self.level, self.tracker, self.runs = level, tracker, len(runs)
        # How it failed in runs in which it did, and why there was nothing to score in others.
        self.failures = [run["failure"] for run in runs if run["failure"]]
        self.unscored = [run["unscored"] for run in runs if run.get("unscored")]
        # By how much the machine itself was late.
        self.late_s = float(np.mean([run["late_s"] for run in runs])) if runs else np.nan
        self.figures = {name: mean_interval(column("figures", name)) for name in SHOWN}
        # Figures of limits, (limits, runs).
        limits = [column("limits", n) for n in range(len(asked))]
        self.limits = np.array(limits).reshape(-1, len(runs))
        self.verdicts: list[LimitVerdict] = []
        risk = look_risk(looks, RISK / max(len(asked), 1))
        for n, (limit, values) in enumerate(zip(asked, self.limits, strict=True)):
            figure = judged_figure(limit, is_known=True)
            is_count = figure.removeprefix("known_").removeprefix("space_") in COUNTS
            found = seeds_interval(values, risk, column("trials", n), are_counts=is_count)
            self.verdicts.append(LimitVerdict(limit, figure, found, self.runs, "many runs"))

    @property
    def is_scored(self) -> bool:
        """Whether there was anything to score in any run."""
        return len(self.unscored) < self.runs

    @property
    def is_decided(self) -> bool:
        """Whether more runs would change no verdict."""
        is_known = self.is_scored and bool(self.verdicts)
        return is_known and all(v.status != "undecided" for v in self.verdicts)

    def as_json(self) -> dict[str, Any]:
        """Figures by name, as value, low and high."""
        return {
            "tracker": self.tracker,
            "values": self.level.by_path(),
            "runs": self.runs,
            "failures": list(self.failures),
            "unscored": list(self.unscored),
            "late_s": self.late_s,
            "figures": {name: figure._asdict() for name, figure in self.figures.items()},
            "limits": [vars(verdict) for verdict in self.verdicts],
        }


@dataclass(frozen=True, kw_only=True)
class Survival:
    """Up to which level a tracker keeps a limit."""

    limit: str
    tracker: str
    key: str
    others: str  # What else is so on the way
    level: Interval
    # By how much the machine was late on the way, where that is too much to tell the level.
    late_s: float

    def __str__(self) -> str:
        where = f" ({self.others})" if self.others else ""
        head = f"{self.tracker}, {self.limit}{where}:"
        if self.late_s:
            return f"{head} not told: the machine itself was late by {self.late_s:.2g} s"
        value, low, high = (
            "no level" if x == -np.inf else "all levels" if x == np.inf else f"{x:.4g}"
            for x in self.level
        )
        if not np.isfinite(self.level.value):
            return f"{head} holds at {value} of {self.key} ({low} to {high})"
        return f"{head} holds to {value} of {self.key} ({low} to {high})"


def survivals(points: Sequence[CurvePoint], asked: Sequence[ScoreLimit]) -> Iterator[Survival]:
    """Breaking levels of each limit and tracker, along the first key of numbers that is varied."""
    for tracker in dict.fromkeys(point.tracker for point in points):
        own = (point for point in points if point.tracker == tracker and point.is_scored)
        of = {point.level.number: point for point in own}
        axis = pictures.LevelAxis([point.level for point in of.values()]) if len(of) > 1 else None
        if axis is None or axis.key is None:
            continue
        for others, levels in axis.lines.items():
            on = [of[level.number] for level in levels]
            at = np.array([axis.at(level) for level in levels])
            late_s = max(point.late_s for point in on)
            unit_s = 1e-3 if axis.title.endswith("_ms") else 1.0 if axis.title.endswith("_s") else 0
            may_s = LATE_SHARE * float(np.ptp(at)) * unit_s or LATE_S
            runs = min(point.runs for point in on)
            for n, limit in enumerate(asked):
                bound = limit.at_least if limit.at_most is None else limit.at_most
                values = np.array([point.limits[n, :runs] for point in on])
                yield Survival(
                    limit=limit.title,
                    tracker=tracker,
                    key=axis.title,
                    others=others,
                    level=breaking_level(at, values, bound or 0.0, rises=limit.at_most is not None),
                    late_s=late_s if late_s > may_s else 0.0,
                )


def curve_table(points: Sequence[CurvePoint]) -> Table:
    """Points as a table."""
    columns = [
        *key_columns(points, TextColumn("tracker", "tracker")),
        TextColumn("runs", "runs", "d"),
        TextColumn("failed", lambda point: len(point.failures), "d"),
        *figure_columns(SHOWN),
    ]
    title = "Scores as known at the time; in brackets 95 % intervals, by the bootstrap over runs"
    return Table(title, columns, points)


def limit_table(points: Sequence[CurvePoint]) -> Table:
    """Verdicts at all levels."""
    verdicts = [(str(point.level), each) for point in points for each in point.verdicts]
    cells = Table("", LIMITS, [each for _, each in verdicts])
    rows = [(at, *row) for (at, _), row in zip(verdicts, cells.cells(), strict=True)]
    columns = of_cells(["at", *cells.header], f"<{cells.sides}")
    return Table("Limits at each level", columns, rows)


def curve_lines(points: Sequence[CurvePoint], survived: Sequence[Survival]) -> Iterator[str]:
    """Points as tables for people, what they survive, and how trackers failed."""
    yield from (line.rstrip() for line in curve_table(points).lines())
    if any(point.verdicts for point in points):
        yield from limit_table(points).lines()
    yield ""
    yield from map(str, survived)
    first: dict[str, str] = {}
    for point in points:
        if point.late_s > LATE_S:
            yield f"the machine itself was late by {point.late_s:.2g} s ({point.level})"
        if point.unscored:
            of = f"{len(point.unscored)} of {point.runs} runs"
            yield f"nothing was scored in {of}: {point.unscored[0]} ({point.level})"
        for failure in point.failures:
            first.setdefault(failure, str(point.level))
    yield from (f"failed: {failure} ({where})" for failure, where in first.items())


@contextlib.contextmanager
def curve_figure(points: Sequence[CurvePoint]) -> Iterator[Any]:
    """The picture."""
    axis = pictures.LevelAxis([point.level for point in points])
    names = ", ".join(dict.fromkeys(point.tracker for point in points))
    failed, runs = sum(len(point.failures) for point in points), sum(p.runs for p in points)
    more = f"; failed in {failed}" if failed else ""
    title = f"{names}: {runs} runs, bars 95 % over those of a level{more}"
    with pictures.figure_of(INCHES, pictures.plain_text(title)) as figure:
        for axes, (name, (title, _)) in zip(figure.subplots(3, 3).flat, SHOWN.items(), strict=True):
            found = {point.level.number: point.figures[name] for point in points}
            pictures.draw_by_level(axes, axis, found, title, "")
        yield figure


def score_tracker(scene: Path, settings: TrackerSettings, options: ScoreOptions) -> int:
    """Run what is not done yet, write the table and the pictures; the exit code.

    With a profile, levels at which all its limits are decided take no more runs, which is looked at
    after each fifth of those asked for. The code is 1 where a tracker failed in any run, or a limit
    is broken at any level. Raises `PlotfeedError`, and `OSError`.
    """
    profile = None if options.profile is None else load_profile(options.profile)
    plan = TrackerPlan(
        settings=settings,
        topic=options.topics[0] if options.topics else None,
        how=settings_of(profile, options.changes),
        limits=[] if profile is None else profile.limit,
        trackers=[TrackerCommand.parse(text) for text in settings.trackers],
    )
    asked, names = plan.limits, [tracker.name for tracker in plan.trackers]
    if len(set(names)) < len(names):
        raise PlotfeedError("--tracker: several need names of their own: NAME=COMMAND")
    if settings.ray is not None:
        need_extra("ray", "--ray", "fleet", load=False)
    of_scene = levels_of([scene], [VariedKey.parse(text) for text in settings.vary])
    told = {
        "plotfeed": version("plotfeed"),
        "scenes": digests(of_scene),
        "--vary": [list(map(list, level.changes)) for level in of_scene],
        "--tracker": [[tracker.name, *tracker.words] for tracker in plan.trackers],
        "--seed": settings.seed,
        "--duration": settings.duration,
        "--speed": settings.speed,
        "--topic": plan.topic,
        "--profile": [limit.model_dump() for limit in asked],
        "settings of the score": plan.how.model_dump(),
    }
    levels = of_scene
    if len(names) > 1:  # once for each tracker, named by it
        each = (replace(level, scene=name) for level in of_scene for name in names)
        levels = [replace(level, number=number) for number, level in enumerate(each)]
    given = [path for path in (options.out, options.junit) if path is not None]
    is_new = not (settings.folder / NAME).exists()
    for path in [*given, *(settings.files() if is_new else [])]:
        refuse_if_there(path, force=options.force)
    if options.out is not None:
        need_extra("matplotlib.figure", "a chart", "charts")
    looks = min(len(POCOCK), settings.runs) if asked else 1
    with Journal(settings.folder / NAME, told, anew=options.force) as kept:
        before, open_levels = len(kept.of_first(settings.runs)), levels
        decided_by: dict[int, CurvePoint] = {}
        for look in range(1, looks + 1):
            runs = -(-settings.runs * look // looks)
            finish_runs(kept, run_tracker, open_levels, settings, plan, runs=runs)
            done = kept.of_first(runs)
            for level in open_levels:
                point = CurvePoint(level, plan.of(level).name, done, asked, looks)
                decided_by[level.number] = point
            open_levels = [lv for lv in open_levels if not decided_by[lv.number].is_decided]
            if not open_levels:
                break
        points = [decided_by[level.number] for level in levels]
        if not any(point.is_scored for point in points):
            raise PlotfeedError(points[0].unscored[0])
        done = {
            key: run
            for key, run in kept.of_first(settings.runs).items()
            if key[1] < decided_by[key[0]].runs
        }
        _write_scores(levels, points, done, settings)
    survived = list(survivals(points, asked))
    failures = [failure for point in points for failure in point.failures]
    verdicts = [verdict.at(point.level) for point in points for verdict in point.verdicts]
    _write_verdicts(points, survived, verdicts, profile, options)
    values = {
        "runs": settings.runs,
        "were_done": before,
        "points": [point.as_json() for point in points],
        "survives": [asdict(each) | {"level": each.level._asdict()} for each in survived],
    }
    lines = [*curve_lines(points, survived)]
    if verdicts and not failures:
        lines.append(closing("", verdicts, AT_A_LEVEL))
    tell(values, lines, [*settings.files(), *given], as_json=options.as_json)
    if before and not options.as_json:
        say(f"{before} runs were done before")
    return 1 if failures or mark_of("", verdicts) == "broken" else 0


def _write_scores(
    levels: Sequence[SweepLevel],
    points: Sequence[CurvePoint],
    done: Results,
    settings: TrackerSettings,
) -> None:
    names = [*FIGURE_NAMES, *POSSIBLE]
    own = {"failure": str, "late_s": float, **dict.fromkeys(names, float)}
    rows = {
        key: [[run["failure"] or None, run["late_s"], *finite([run["figures"][n] for n in names])]]
        for key, run in sorted(done.items())
    }
    table, *charts = settings.files()
    first = "tracker" if len(settings.trackers) > 1 else "scene"
    write_table(table, *level_rows(levels, done, rows, own, first=first))
    for chart in charts:
        with curve_figure(points) as figure:
            pictures.save_picture(figure, chart)


def _write_verdicts(
    points: Sequence[CurvePoint],
    survived: Sequence[Survival],
    verdicts: Sequence[LimitVerdict],
    profile: ScoreProfile | None,
    options: ScoreOptions,
) -> None:
    """The page for who signs, and JUnit's file."""
    title = NO_PROFILE if profile is None else profile.profile.title
    failure = next((failure for point in points for failure in point.failures), "")
    if options.junit is not None:
        write_new(options.junit, junit_of(title, verdicts, failure, 0.0), force=options.force)
    if options.out is not None:
        parts = [f"<p>{escape(printable(str(each)))}</p>\n" for each in survived]
        parts += [limit_table(points).html()] if verdicts else []
        with curve_figure(points) as figure:
            parts += [pictures.svg_of(figure), curve_table(points).html()]
        told = closing(failure, verdicts, AT_A_LEVEL), mark_of(failure, verdicts)
        text = page(printable(f"Trackers: {title}"), *told, parts)
        write_new(options.out, text, force=options.force)
