"""One run of a tracker under test: a session, its broker, the tracker's process, a score."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import re
import shlex
import shutil
import signal
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from plotfeed.feeds.console.posix import end_group
from plotfeed.feeds.lab.flights import FlightsTally
from plotfeed.feeds.lab.possible import POSSIBLE, KnownPlots, RecordedRun, plots_of, possible
from plotfeed.feeds.lab.runs import RunJob, SweepLevel, scene_of
from plotfeed.feeds.lab.score import ScoreLimit, samples_of
from plotfeed.feeds.lab.scoring import FIGURE_NAMES, NoFlightError, ScoreSettings, score_run
from plotfeed.feeds.lab.sweep import span_of
from plotfeed.feeds.lab.track_reports import UNKNOWN_NS, TrackTable, take_message
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message, ReceivedMessage
from plotfeed.feeds.scene.fields import frame_at, site_frame
from plotfeed.feeds.scene.output_keys import WaysOut
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run_over
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.brokers import Brokers, brokers_of
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.models.frames import LocalFrame
from plotfeed.models.verdicts import FigureSamples
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.ledger import LedgerTables, tables_of
from plotfeed.proto.utc import NS
from plotfeed.replay.recorded import Recorded

# On which a tracker publishes, unless the scene's page.tracks_topic or an option says.
USUAL_TOPIC = "tracker/tracks"
CONNECT_S = 5.0
# A tracker has so long for its tracks of the last plots.
LAST_WORDS_S = 1.0
# And so long to end when it is told to; then it is killed.
TERM_S = 5.0
# Of tracks that are taken in a run.
MAX_MESSAGES = 1_000_000
# Characters of a tracker's last line that are told.
MAX_LINE = 200
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

    duration_s: float | None  # Of the session's time; None is as long as the scene says
    speed: float  # Times real time
    patience_s: float  # For the tracker's first line, at which the session begins, or without one
    topic: str | None
    settings: ScoreSettings
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
    plan, scene = job.plan, scene_of(job.level)
    # The run's seed; no truth, which no tracker is to know; and nothing leaves but to its broker.
    general = scene.scene.model_copy(update={"seed": job.seed})
    mqtt = scene.mqtt.model_copy(update={"truth": False})
    scene = scene.model_copy(update={"scene": general, "mqtt": mqtt}).sent_to(WaysOut())
    start_ns, duration_s = span_of(scene, plan.duration_s)
    clock = WallClock(start_ns, speed=plan.speed)
    site = scene.scene.site
    frames = {sensor.id: frame_at(site, sensor.position_enu_m) for sensor in scene.sensor}
    longest_s = max(sensor.scan.period_s for sensor in scene.sensor)
    tally, followed = FlightsTally(frames, longest_s), _Followed(frames)
    heard = _Heard(scene, clock)
    topic = plan.topic or scene.page.tracks_topic or USUAL_TOPIC
    async with (
        brokers_of(scene, None) as brokers,
        _listening(brokers, topic, heard),
        _started(job, brokers, scene.mqtt.prefix, topic) as tracker,
    ):
        await tracker.wait_until_ready(plan.patience_s)
        await run_over(brokers, scene, clock=clock, duration_s=duration_s, observers=[followed])
        await asyncio.sleep(LAST_WORDS_S)
        failure = tracker.failure() or heard.failure
    for told in followed.ledgers:
        tally.add(told)
    truths = tally.truths(site=site_frame(site), scene=scene.scene.name)
    figures, nothing = dict.fromkeys([*FIGURE_NAMES, *POSSIBLE], math.nan), ""
    limits: list[tuple[float, FigureSamples | None]] = [(math.nan, None)] * len(plan.limits)
    try:
        score = score_run(truths, heard.table.read(topic, failure), plan.settings)
    except NoFlightError as error:
        nothing = str(error)
    else:
        failure = score.failure
        limits = [samples_of(score, limit) for limit in plan.limits]
        found = possible(RecordedRun(truths, followed.plots, followed.placeless), score)
        figures |= score.figures() | ({} if found is None else found.figures())
    late_s = [(row.sent_utc_ns - row.link_due_utc_ns)[row.delivered] / NS
              for row in (told.messages for told in followed.ledgers)]  # fmt: skip
    all_late_s = np.concatenate([np.zeros(1), *late_s])
    return {
        "level": job.level.number,
        "run": job.run,
        "seed": job.seed,
        "failure": failure,
        "unscored": nothing,
        "late_s": float(np.quantile(all_late_s, 0.95)),
        "figures": figures,
        "limits": [value for value, _ in limits],
        "trials": [np.nan if of is None else of.trials for _, of in limits],
    }


class _Followed(Observer):
    """Takes the ledger of a session, and plots with whose they are."""

    def __init__(self, frames: Mapping[str, LocalFrame]) -> None:
        self.ledgers: list[LedgerTables] = []
        self.plots: list[KnownPlots] = []
        self.placeless = 0
        self._frames = frames

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


class _Heard:
    """What the tracker published, by the session's time."""

    def __init__(self, scene: Scene, clock: WallClock) -> None:
        self.table = TrackTable()
        self.failure = ""
        self._site, self._clock = site_frame(scene.scene.site), clock
        self._messages = 0

    def take(self, message: ReceivedMessage) -> None:
        """Take a message, whatever it is."""
        self._messages += 1
        if self._messages > MAX_MESSAGES:
            self.failure = f"the tracker published more than {MAX_MESSAGES} messages"
            return
        now_ns = self._clock.now_ns()
        recorded = Recorded(
            topic=message.topic,
            payload=message.payload,
            log_time_ns=now_ns,
            publish_time_ns=now_ns,
            content_type=message.content_type or "",
        )
        take_message(self.table, recorded, self._site)


@contextlib.asynccontextmanager
async def _listening(brokers: Brokers, topic: str, heard: _Heard) -> AsyncIterator[None]:
    """Hear what is published on a topic meanwhile, at all brokers of a session."""
    links = [
        MqttTransport(address, "plotfeed-score", subscribe=[topic], on_received=heard.take)
        for address in brokers[0]
    ]
    tasks = [asyncio.create_task(link.run(), name="score-link") for link in links]
    try:
        for link in links:
            await link.wait_until_up(CONNECT_S)
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


@contextlib.asynccontextmanager
async def _started(
    job: RunJob, brokers: Brokers, prefix: str, topic: str
) -> AsyncIterator[_TrackerProcess]:
    """The tracker's process, which is gone afterwards with all that it has started."""
    (broker,) = brokers[0]
    url, port = f"mqtt://{broker.host}:{broker.port}", str(broker.port)
    values = {
        "broker": url,
        "broker5": url,
        "host": broker.host,
        "port": port,
        "port5": port,
        "prefix": prefix,
        "topic": topic,
        "seed": str(job.seed),
    }
    told = {f"PLOTFEED_TRACKER_{name.upper()}": value for name, value in values.items()}
    try:
        process = await asyncio.create_subprocess_exec(
            *job.plan.of(job.level).filled(values),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            env={**os.environ, **told, "PYTHONUNBUFFERED": "1"},
            start_new_session=True,
        )
    except OSError as error:
        raise PlotfeedError(f"--tracker: {error.strerror or error}") from None
    tracker = _TrackerProcess(process)
    try:
        yield tracker
    finally:
        await tracker.end()


class _TrackerProcess:
    """A tracker while it runs: what it says last, and how it ends."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process
        self._said = asyncio.Event()
        self._last = ""
        self._reading = asyncio.create_task(self._read(), name="tracker")

    async def wait_until_ready(self, patience_s: float) -> None:
        """Wait for its first line or its end, or for so long."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._said.wait(), patience_s)

    def failure(self) -> str:
        """How it has ended by now, although nobody told it to; empty while it runs."""
        code = self._process.returncode
        if code is None:
            return ""
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        return f"the tracker ended by itself, {how}" + (f": {self._last}" if self._last else "")

    async def end(self) -> None:
        """Tell it to end, and kill it if it does not."""
        end_group(self._process, kill=False)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._process.wait(), TERM_S)
        end_group(self._process, kill=True)
        await self._process.wait()
        self._reading.cancel()
        await asyncio.gather(self._reading, return_exceptions=True)

    async def _read(self) -> None:
        """Read what it says, so that it never waits: the last line counts."""
        stream = self._process.stdout
        line = b""
        while stream is not None and (octets := await stream.read(1 << 16)):
            *whole, line = (line + octets).split(b"\n")
            line = line[-MAX_LINE:]
            if whole:
                self._said.set()
                last = next((each for each in reversed(whole) if each.strip()), b"")
                self._last = last[-MAX_LINE:].decode(errors="replace").strip() or self._last
        self._last = line.decode(errors="replace").strip() or self._last
        self._said.set()


def of_trackers(levels: list[SweepLevel], names: list[str]) -> list[SweepLevel]:
    """Levels once for each tracker, named by it where there are several; numbered anew."""
    if len(names) == 1:
        return levels
    each = (replace(level, scene=name) for level in levels for name in names)
    return [replace(level, number=number) for number, level in enumerate(each)]
