"""A recorded session read once: entries of its ledger as columns, and plots, a part at a time."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO, NamedTuple, Self

import numpy as np

from plotfeed.feeds.console.printed import with_progress
from plotfeed.feeds.formats import FORMATS
from plotfeed.feeds.lab.asked import AskedByTime, RecordedSettings
from plotfeed.feeds.recording.recorder import SessionRecord
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.clutter import CLUTTER
from plotfeed.models.sidelobe_echoes import SIDELOBE
from plotfeed.models.state import OTHER, Bools, Ints, Texts
from plotfeed.proto.content_types import LEDGER, LEDGER_BATCH, message_type
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.ledger import LedgerTables, ToldLooks, ToldPlots, tables_of
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.plot_messages import batch_in, plots_of_batches
from plotfeed.replay.mcap.channels import ChannelKey
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.plots_csv import plots_in
from plotfeed.replay.recorded import SCENE_NAME, Recorded, Stage

NO_PLOTS = MeasuredPlots.of(())
TRUTH = "/truth"
# What messages there may be, by what they say of themselves.
LEDGERS = ("", LEDGER, LEDGER_BATCH)
# Messages that are read together, and their octets, as those of the ledger have many sectors.
AT_ONCE, OCTETS_AT_ONCE = 8192, 4 << 20
REMEMBERED = 65_536  # Entries by which it is noticed that one was recorded twice
# Plots that wait for what is true of them; then the oldest are given up.
MAX_WAITING_PLOTS = 200_000
MOST_COMPLETE = (Stage.BEFORE, Stage.AFTER, Stage.RECEIVED)
# Stages at which plots are looked for, the best first: the most complete, or as a tracker saw.
AS_DELIVERED = (Stage.AFTER, Stage.RECEIVED, Stage.BEFORE)


def plot_topics() -> list[str]:
    """Ends of topics with plots that can be joined with the ledger, those that say most first.

    SAPIENT is none of them, since it keeps the plots of several sectors together.
    """
    rows = (row for row in FORMATS.values() if row.plots_in is not None and row.name != "sapient")
    return [row.facts.topic for row in rows]


def names_of(told: ToldLooks | ToldPlots) -> Texts:
    """Names of what looks or plots are of, drones or not, (n,); empty for false alarms."""
    return np.where(told.drone != "", told.drone, told.other)


def are_targets(names: Texts) -> Bools:
    """Which of those were looked at: neither false alarms nor what is nowhere, (n,)."""
    nowhere = ("", CLUTTER + OTHER, SIDELOBE + OTHER)
    known = {name: bool(name) and not name.startswith(nowhere[1:]) for name in set(names.tolist())}
    return np.array([known[name] for name in names.tolist()], np.bool_)


class SectorKey(NamedTuple):
    """The sector that plots are of."""

    prefix: str  # Of the session's topics
    sensor: str
    scan: int
    sector: int


class SectorPlots(NamedTuple):
    """The plots in a message, and which of its sector's messages it is."""

    key: SectorKey
    number: int
    plots: MeasuredPlots


def sector_plots(
    messages: Iterable[Recorded], whose: Callable[[Recorded], tuple[str, str]]
) -> Iterator[SectorPlots]:
    """Plots in messages that hold any; what cannot be read or placed is left out."""
    keys, batches = [], []
    for message in messages:
        prefix, sensor = whose(message)
        if message.topic.endswith("/plots"):
            try:
                batch = batch_in(message.payload)
            except DecodeError:
                continue
            if batch.plots:
                keys.append(SectorKey(prefix, sensor, batch.scan, batch.sector))
                batches.append(batch)
            continue
        plots, properties = plots_in(message), dict(message.properties)
        try:
            key = SectorKey(prefix, sensor, int(properties["scan"]), int(properties["sector"]))
            number = int(properties["id"].rpartition("-")[2])
        except (KeyError, ValueError):
            continue
        if plots is not None:
            yield SectorPlots(key, number, plots)
    together, first = plots_of_batches(batches), 0
    for key, batch in zip(keys, batches, strict=True):
        end = first + len(batch.plots)
        yield SectorPlots(key, 0, together.between(first, end))
        first = end


class WaitingPlots:
    """Plots by sector, until the ledger's entry comes, which is the last as a rule."""

    def __init__(self) -> None:
        self._sectors: OrderedDict[SectorKey, dict[int, MeasuredPlots]] = OrderedDict()
        self._count = 0

    def add(self, found: SectorPlots) -> None:
        """Keep the plots of a message; a duplicate of it is passed over."""
        if not len(found.plots):
            return
        messages = self._sectors.setdefault(found.key, {})
        if found.number in messages:
            return
        messages[found.number] = found.plots
        self._count += len(found.plots)
        while self._count > MAX_WAITING_PLOTS and self._sectors:
            self._forget(next(iter(self._sectors)))

    def count(self, key: SectorKey) -> int:
        """Count the plots of a sector."""
        return sum(map(len, self._sectors.get(key, {}).values()))

    def take(self, key: SectorKey, t_utc_ns: Ints | None = None) -> MeasuredPlots | None:
        """Plots of a sector, in order, which wait no longer; None if those times are of others.

        The sensor's clock may be ahead, but of all its plots by as much.
        """
        messages = self._forget(key)
        plots = MeasuredPlots.joined([NO_PLOTS, *(messages[n] for n in sorted(messages))])
        if t_utc_ns is None:
            return plots
        if len(plots) != len(t_utc_ns):
            return None
        is_exact = plots.category == 0
        ahead_ns = plots.t_utc_ns[is_exact] - t_utc_ns[is_exact]
        return plots if (ahead_ns == ahead_ns[:1]).all() else None

    def _forget(self, key: SectorKey) -> dict[int, MeasuredPlots]:
        messages = self._sectors.pop(key, {})
        self._count -= sum(map(len, messages.values()))
        return messages


class EvidencePart(NamedTuple):
    """What some messages of a recording tell: entries that are new, and plots."""

    told: LedgerTables
    keys: Sequence[SectorKey]  # Of the entries
    plots: Sequence[SectorPlots]

    def by_sensor(self) -> Iterator[tuple[tuple[str, str], LedgerTables, list[SectorKey]]]:
        """Entries of each prefix and sensor."""
        rows: dict[tuple[str, str], list[int]] = {}
        for row, key in enumerate(self.keys):
            rows.setdefault(key[:2], []).append(row)
        for whose, which in rows.items():
            yield whose, self.told.of(np.array(which)), [self.keys[row] for row in which]


class Evidence:
    """What a recording has of a session: its scene and settings, and parts of its ledger."""

    def __init__(self, path: Path, file: BinaryIO, stages: Sequence[Stage], folder: Path) -> None:
        """Plots are looked for at the first of those stages; raises `PlotfeedError`.

        `folder` is where files of its scene may be unpacked.
        """
        # Entries that are no ledger, and those that were there before.
        self.unreadable = self.repeated = 0
        self.first_ns: int | None = None
        self.last_ns: int | None = None  # Log times of the first and the last entry
        # Why its scene cannot be used; empty where it can, or where there is none.
        self.problem = ""
        self.scene: Scene | None = None
        # What was asked of sensors, by id; of none without a scene that can be used.
        self.asked: Mapping[str, AskedByTime] = {}
        self.log = McapReader(file)
        self._path, self._file, self._folder = path, file, folder
        series = list(self.log.summary().counts)
        self._truths = truth_topics(series)
        if not self._truths:
            raise PlotfeedError(f"{path}: {self._without_ledger()}")
        # Prefix and sensor of the topics and stages at which plots are.
        self.carriers = plot_topics_of(series, self._truths, stages)
        self._seen: OrderedDict[SectorKey, None] = OrderedDict()

    @classmethod
    @contextmanager
    def of(cls, path: Path, stages: Sequence[Stage] = MOST_COMPLETE) -> Iterator[Self]:
        """The evidence in a file; raises `PlotfeedError` if it holds no ledger, and `OSError`."""
        try:
            with path.open("rb") as file, TemporaryDirectory() as folder:
                yield cls(path, file, stages, Path(folder))
        except DecodeError as error:
            raise PlotfeedError(f"{path}: {error}") from None

    def ask(self) -> None:
        """Take notice of what the recorded scene asks of its sensors."""
        try:
            record = SessionRecord.open(self._path)
            start_utc_ns, scene = record.start_utc_ns, record.scene(self._folder)
            settings = RecordedSettings.read(scene, self.log)
        except (PlotfeedError, OSError) as error:
            self.problem = str(error).partition("\n")[0]
            return
        self.scene = scene
        self.asked = {s.id: AskedByTime(scene, s, settings, start_utc_ns) for s in scene.sensor}

    @property
    def has_scene(self) -> bool:
        """Whether it has a scene with it, of use or not."""
        return any(attachment.name == SCENE_NAME for attachment in self.log.attachments())

    def carrier_of(self, when: Mapping[Stage, str]) -> dict[tuple[str, str], str]:
        """Where plots were found, by prefix and sensor: the kind, and the word for the stage."""
        return {
            whose: f"{topic.removeprefix('/'.join(whose)).strip('/')}, {when[stage]}"
            for (topic, stage), whose in self.carriers.items()
        }

    def parts(self, *, with_plots: bool = True) -> Iterator[EvidencePart]:
        """All of it, in the order of the file, some messages at a time."""
        series = {*self._truths, *(self.carriers if with_plots else ())}
        found = self.log.messages(topics={t for t, _ in series}, stages={s for _, s in series})
        octets = self._path.stat().st_size
        messages = with_progress(found, self._path.name, self._file.tell, octets)
        while several := _some_of(messages):
            of = [(message.topic, message.stage) for message in several]
            ledgers = [m for m, key in zip(several, of, strict=True) if key in self._truths]
            carried = (m for m, key in zip(several, of, strict=True) if key in self.carriers)
            told, keys = self._new(ledgers)
            plots = sector_plots(carried, lambda m: self.carriers[m.topic, m.stage])
            yield EvidencePart(told, keys, list(plots) if with_plots else [])

    def _new(self, ledgers: Sequence[Recorded]) -> tuple[LedgerTables, list[SectorKey]]:
        """Entries that were not there before."""
        told = tables_of(message.payload for message in ledgers)
        self.unreadable += len(ledgers) - len(set(told.entries.payload.tolist()))
        held = told.entries
        columns = (held.payload, held.sensor, held.scan, held.sector)
        which, keys = [], []
        for row, (number, *of) in enumerate(zip(*(c.tolist() for c in columns), strict=True)):
            message = ledgers[number]
            key = SectorKey(self._truths[message.topic, message.stage], *of)
            if key in self._seen:
                self.repeated += 1
                continue
            self._seen[key] = None
            if len(self._seen) > REMEMBERED:
                self._seen.popitem(last=False)
            if self.first_ns is None:
                self.first_ns = message.log_time_ns
            self.last_ns = message.log_time_ns
            which.append(row)
            keys.append(key)
        return told.of(np.array(which, np.int64)), keys

    def _without_ledger(self) -> str:
        if self.log.damage:
            return f"holds no ledger that is whole: {self.log.damage[0]}"
        return (
            f"holds no ledger: expected {LEDGER_BATCH} on a topic that ends in {TRUTH}, "
            "as plotfeed run --record makes it"
        )


def _some_of(messages: Iterator[Recorded]) -> list[Recorded]:
    """The next messages, few enough to be read together."""
    some, octets = [], 0
    for message in messages:
        some.append(message)
        octets += len(message.payload)
        if len(some) == AT_ONCE or octets > OCTETS_AT_ONCE:
            break
    return some


def truth_topics(series: Sequence[ChannelKey]) -> dict[tuple[str, Stage], str]:
    """Prefixes by topic and stage: what left, or else what was received of the same topic."""
    found: dict[str, Stage] = {}
    for each in series:
        if each.topic.endswith(TRUTH) and message_type(each.content_type) in LEDGERS:
            best = found.get(each.topic, each.stage)
            found[each.topic] = Stage.AFTER if Stage.AFTER in (best, each.stage) else best
    return {(topic, stage): topic.removesuffix(TRUTH) for topic, stage in found.items()}


def plot_topics_of(
    series: Sequence[ChannelKey], truths: Mapping[tuple[str, Stage], str], stages: Sequence[Stage]
) -> dict[tuple[str, Stage], tuple[str, str]]:
    """Prefix and sensor by topic and stage: of each sensor the most exact kind of plots.

    At the first of those stages at which there are any.
    """
    prefixes = set(truths.values())
    best: dict[tuple[str, str], tuple[int, int, str, Stage]] = {}
    for each in series:
        for rank, kind in enumerate(plot_topics()):
            place = each.topic.removesuffix(f"/{kind}")
            prefix, _, sensor = place.rpartition("/")
            if place == each.topic or prefix not in prefixes or each.stage not in stages:
                continue
            found = (rank, stages.index(each.stage), each.topic, each.stage)
            key = (prefix, sensor)
            best[key] = min(best.get(key, found), found)
    return {(topic, stage): key for key, (_, _, topic, stage) in best.items()}
