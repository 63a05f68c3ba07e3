"""A recorded session read once: entries of its ledger as columns, and plots, a part at a time.

With what its scene asked of each sensor by time, and what sensors take themselves to be.
"""

from __future__ import annotations

import json
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, groupby, pairwise
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, NamedTuple, Self

import numpy as np

from plotfeed.feeds.console.printed import with_progress
from plotfeed.feeds.engine.emulated_sensors import AHEAD_NS
from plotfeed.feeds.formats import FORMATS
from plotfeed.feeds.lab import oracle
from plotfeed.feeds.recording.recorder import SessionRecord
from plotfeed.feeds.scene.changes import changed, in_force, instants_ns
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.feeds.scene.sensors import Sensor, sensor_of
from plotfeed.feeds.scene.sensors.effect_keys import readings_of
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry
from plotfeed.models.beam import Timetable
from plotfeed.models.chance import Chance
from plotfeed.models.clutter import CLUTTER, SIDELOBE
from plotfeed.models.effects.readings import Readings
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.sensors.sensor_model import JointSensor, SensorModel
from plotfeed.models.state import OTHER, Bools, Floats, Ints, Texts
from plotfeed.proto.asterix.decode_plots import told_of_plots_and_tracks
from plotfeed.proto.content_types import LEDGER, LEDGER_BATCH, message_type
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.ledger import LedgerTables, ToldLooks, ToldPlots, tables_of
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.plot_messages import batch_in, plots_of_batches
from plotfeed.proto.plotfeed_pb2 import PlotBatch
from plotfeed.proto.utc import NS, NS_IN_MS
from plotfeed.replay.mcap import ChannelKey, McapReader
from plotfeed.replay.recorded import WHAT_LEFT, Recorded, Stage

NO_PLOTS = MeasuredPlots.of(())
TRUTH = "/truth"
LEDGERS = ("", LEDGER, LEDGER_BATCH)  # What messages there may be, by what they say of themselves
# Messages that are read together, and their octets, as those of the ledger have many sectors.
AT_ONCE, OCTETS_AT_ONCE = 8192, 4 << 20
REMEMBERED = 65_536  # Entries by which it is noticed that one was recorded twice
# Plots that wait for what is true of them; then the oldest are given up.
MAX_WAITING_PLOTS = 200_000
MOST_COMPLETE = (Stage.BEFORE, Stage.AFTER, Stage.RECEIVED)
# Stages at which plots are looked for, the best first: the most complete, or as a tracker saw.
AS_DELIVERED = (Stage.AFTER, Stage.RECEIVED, Stage.BEFORE)


# Sensors whose plots state errors that follow from their own ratios, as the oracle has them.
RADARS = frozenset({"active_radar", "mimo_radar", "passive_radar"})
MAX_CHANGES = 10_000  # Of each sensor that are known; of later ones nothing is told
MOST_LACKING = 100_000  # Sectors in a row, that are looked at one by one


class RecordedSettings:
    """Sensors by time, as settings messages tell of them; before the first, as in the scene."""

    def __init__(self, scene: Scene) -> None:
        self._sensors = {sensor.id: sensor for sensor in scene.sensor}
        self._told: dict[str, list[tuple[int, Sensor]]] = {name: [] for name in self._sensors}
        self._controlled: dict[str, list[tuple[int, Mapping[str, Any]]]] = {
            name: [] for name in self._sensors
        }
        self._instants_ns = {s.id: instants_ns(s.event) for s in scene.sensor}
        self._worked_out: dict[tuple[str, int, int], Sensor | None] = {}

    @classmethod
    def read(cls, scene: Scene, log: McapReader) -> Self:
        """Read all that a recording tells."""
        found = cls(scene)
        topics = {f"{scene.mqtt.prefix}/{name}/settings": name for name in found._sensors}
        for message in log.messages(topics=set(topics), stages=WHAT_LEFT):
            found.take(topics[message.topic], message.payload, message.log_time_ns)
        return found

    def take(self, sensor: str, payload: bytes, t_utc_ns: int) -> None:
        """Note what a message tells of a sensor from that time on; what tells nothing is none."""
        try:
            told = json.loads(payload)
            controlled = told.get("controlled")
        except (ValueError, AttributeError, RecursionError):
            return
        if isinstance(controlled, dict) and len(self._controlled[sensor]) <= MAX_CHANGES:
            self._controlled[sensor].append((t_utc_ns, controlled))
        try:
            now = sensor_of(told["in_force"])
        except (ValueError, KeyError, TypeError, RecursionError):  # pydantic's are ValueErrors
            return
        is_it = now.id == sensor and type(now) is type(self._sensors[sensor])
        if is_it and len(self._told[sensor]) < MAX_CHANGES:
            self._told[sensor].append((t_utc_ns, now))

    def told_at(self, t_utc_ns: int) -> dict[str, Sensor]:
        """Sensors by id, as the last messages until then had them."""
        found = dict(self._sensors)
        for name, told in self._told.items():
            number = _until(told, t_utc_ns)
            if number:
                found[name] = told[number - 1][1]
        return found

    def told_between(self, after_utc_ns: int, until_utc_ns: int) -> Iterator[str]:
        """The ids of sensors of which a message told later than that, and until then."""
        for sensor, told in self._told.items():
            if _until(told, after_utc_ns) < _until(told, until_utc_ns):
                yield sensor

    def worked_out(self, sensor: str, t_utc_ns: int, start_utc_ns: int) -> Sensor | None:
        """A sensor as the script of its scene and control had it then; None if that is not known.

        The session began at `start_utc_ns`. It is the same object for as long as nothing changes.
        """
        elapsed_ns = max(t_utc_ns - start_utc_ns, 0)
        commands = _until(self._controlled[sensor], t_utc_ns)
        state = (sensor, bisect_right(self._instants_ns[sensor], elapsed_ns), commands)
        if state not in self._worked_out:
            own, self._worked_out[state] = self._sensors[sensor], None
            controlled = self._controlled[sensor][commands - 1][1] if commands else {}
            if commands <= MAX_CHANGES:
                with suppress(PlotfeedError):
                    found = changed(own, *in_force(own.event, elapsed_ns), controlled)
                    self._worked_out[state] = found
        return self._worked_out[state]


def _until(by_time: Sequence[tuple[int, Any]], t_utc_ns: int) -> int:
    """Count what there was until then."""
    return bisect_right(by_time, t_utc_ns, key=itemgetter(0))


@dataclass(frozen=True)
class AskedSensor:
    """A sensor as it was to be while its keys stayed the same."""

    scene: Scene
    keys: Sensor
    # By which heights above mean sea level are told; None if its grid cannot be read here.
    sea_level: SeaLevel | None = None
    # Its keys as it stands and looks, where these are others than those by which it is judged.
    standing: Sensor | None = None

    @cached_property
    def model(self) -> SensorModel:
        """The model that its keys make."""
        return self.keys.model(self.scene.scene.site)

    @cached_property
    def frame(self) -> LocalFrame:
        """The sensor's place, with true axes."""
        return frame_at(self.scene.scene.site, self.keys.position_enu_m)

    @cached_property
    def own_axes(self) -> Floats | None:
        """Rotation from true east, north and up to its own, (3, 3); None if it stands right."""
        axes = self.frame if self.keys.bias is None else self.keys.bias.axes(self.frame)
        if axes is self.frame:
            return None
        return np.asarray(axes.rotation_from_ecef @ self.frame.rotation_from_ecef.T)

    @cached_property
    def readings(self) -> Readings | None:
        """The errors of its readings, None for none: the drift is the one that the seed draws."""
        keys = self.keys
        chance = Chance(self.scene.scene.seed, keys.id)
        return readings_of(keys.bias, keys.drift, chance, keys.scan.period_ns)

    def undulation_m(self, azimuth_deg: Floats, elevation_deg: Floats, range_m: Floats) -> Floats:
        """Heights of mean sea level above the ellipsoid at places; (n,), NaN if not known."""
        if self.sea_level is None:
            return np.full(len(range_m), np.nan)
        there_enu_m = aer_to_enu(azimuth_deg, elevation_deg, range_m)
        return self.sea_level.undulation_m(*self.frame.to_geodetic(there_enu_m)[:2])

    @cached_property
    def clock_ahead_ns(self) -> int:
        """Nanoseconds by which its clock is to be ahead."""
        return 0 if self.keys.bias is None else round(self.keys.bias.time_offset_s * NS)

    @cached_property
    def error_factor(self) -> float | Floats:
        """Errors over the stated ones; NaN where plots do not err by what they state."""
        return self.model.error_factor if self.model.errs_as_stated else np.nan

    @cached_property
    def claimed(self) -> Self:
        """The sensor as it takes itself to be: without errors and degradation."""
        whole = self.keys.model_copy(update={"degradation": None})
        right = whole.model_copy(update={"bias": None, "drift": None})
        return type(self)(self.scene, right, self.sea_level, whole)

    def of_looks(self, looks: oracle.LooksGiven) -> oracle.Asked:
        """What is asked of looks, (n,), worked out apart from what a session runs."""
        return oracle.asked(self.scene, self.standing or self.keys, looks)

    def stated_sigmas(self, snr: Floats, channel: Ints) -> Mapping[str, Floats]:
        """What a radar's plots state of their errors at their own ratios, linear; (n,) each."""
        if self.keys.type in RADARS:
            found = oracle.stated_sigmas(self.keys, snr, channel)
            if self.is_bistatic:
                found["sigma_bistatic_range_m"] = found.pop("sigma_range_m")
            return found
        return self.model.sigmas_at(snr, channel)

    def from_enu_m(self, channel: Ints) -> Floats:
        """Where signals of channels come from, of one that measures bistatic ranges; (n, 3)."""
        model: Any = self.model
        return np.asarray(model.positions_enu_m[channel])

    @property
    def is_bistatic(self) -> bool:
        """Whether it measures bistatic ranges."""
        return self.keys.geometry is SensorGeometry.BISTATIC

    @cached_property
    def false_alarms(self) -> tuple[float, str]:
        """Mean number in a scan; NaN, and why, where that is not known."""
        return oracle.false_alarms_per_scan(self.scene, self.keys)


class AskedByTime:
    """One sensor of a recorded scene, by its sectors."""

    def __init__(
        self, scene: Scene, sensor: Sensor, settings: RecordedSettings, start_utc_ns: int
    ) -> None:
        self.sectors = sensor.scan.sectors  # Of a scan
        self._sensor, self._settings, self._start_utc_ns = sensor.id, settings, start_utc_ns
        self._scene = scene
        self._sea_level: SeaLevel | None = None
        with suppress(PlotfeedError):
            self._sea_level = scene.sea_level()
        scan, chance = sensor.scan, Chance(scene.scene.seed, sensor.id)
        jitter_ns = scan.jitter_ms * NS_IN_MS
        self._timetable = Timetable(scan.period_ns, scan.sectors, jitter_ns, chance)
        # By the identity of the keys, which `settings` keeps.
        self._asked: dict[int, AskedSensor] = {}

    def in_sector(self, scan: int, sector: int) -> AskedSensor | None:
        """The sensor as it was when a sector was worked out; None if that is not known."""
        of = self._timetable.sector(scan, sector)
        worked_out_ns = max(of.end_ns - AHEAD_NS, of.start_ns)
        keys = self._settings.worked_out(self._sensor, worked_out_ns, self._start_utc_ns)
        if keys is None:
            return None
        if id(keys) not in self._asked:
            self._asked[id(keys)] = AskedSensor(self._scene, keys, self._sea_level)
        return self._asked[id(keys)]

    @property
    def unjudged(self) -> str:
        """What of its plots is not judged, and why; empty where all is."""
        models = [asked.model for asked in self._asked.values()]
        if any(isinstance(model, JointSensor) for model in models):
            return "errors and false alarms, as detections are joined to places, some wrongly"
        if any(not model.errs_as_stated for model in models):
            return "errors, which a layout of microphones leaves other than normal"
        return ""

    def missed(self, lacking: range) -> int:
        """How many of those sectors, by number, there were to be: it was at work."""
        asked = (self.in_sector(*divmod(n, self.sectors)) for n in lacking[:MOST_LACKING])
        return sum(each is not None and each.keys.enabled for each in asked)


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


@dataclass(frozen=True, slots=True)
class SectorPlots:
    """The plots in a message: some rows of a table, which is that of many messages."""

    key: SectorKey
    number: int  # Of the message, among those of its sector
    table: MeasuredPlots
    first: int
    end: int

    def __len__(self) -> int:
        return self.end - self.first


def plots_in_rows(parts: Iterable[SectorPlots]) -> MeasuredPlots:
    """The plots of all parts, in their order."""
    tables = [NO_PLOTS]
    for _, together in groupby(parts, key=lambda part: id(part.table)):
        several = list(together)
        rows = [np.arange(part.first, part.end) for part in several]
        tables.append(several[0].table.rows(np.concatenate(rows)))
    return MeasuredPlots.joined(tables)


def sector_plots(
    messages: Iterable[Recorded], whose: Callable[[Recorded], tuple[str, str]]
) -> Iterator[SectorPlots]:
    """Plots in messages that hold any; what cannot be read or placed is left out."""
    of_batches: list[tuple[SectorKey, int, int]] = []
    of_asterix: list[tuple[SectorKey, int, int]] = []
    batches: list[PlotBatch] = []
    told: list[dict[str, Any]] = []
    for message in messages:
        prefix, sensor = whose(message)
        if message.topic.endswith("/plots"):
            try:
                batch = batch_in(message.payload)
            except DecodeError:
                continue
            key = SectorKey(prefix, sensor, batch.scan, batch.sector)
            batches.append(batch)
            of_batches.append((key, 0, len(batch.plots)))
            continue
        properties = dict(message.properties)
        try:
            key = SectorKey(prefix, sensor, int(properties["scan"]), int(properties["sector"]))
            number = int(properties["id"].rpartition("-")[2])
        except (KeyError, ValueError):
            continue
        plots = told_of_plots_and_tracks(message.payload, message.log_time_ns) or []
        told += plots
        of_asterix.append((key, number, len(plots)))
    for table, several in (
        (plots_of_batches(batches), of_batches),
        (MeasuredPlots.of(told), of_asterix),
    ):
        end = 0
        for key, number, count in several:
            first, end = end, end + count
            if count:
                yield SectorPlots(key, number, table, first, end)


class WaitingPlots:
    """Plots by sector, until the ledger's entry comes, which is the last as a rule."""

    def __init__(self) -> None:
        self._sectors: OrderedDict[SectorKey, dict[int, SectorPlots]] = OrderedDict()
        self.total = 0

    def add(self, found: SectorPlots) -> None:
        """Keep the plots of a message; a duplicate of it is passed over."""
        messages = self._sectors.setdefault(found.key, {})
        if found.number in messages:
            return
        messages[found.number] = found
        self.total += len(found)
        while self.total > MAX_WAITING_PLOTS and self._sectors:
            self._forget(next(iter(self._sectors)))

    def count(self, key: SectorKey) -> int:
        """Count the plots of a sector."""
        return sum(map(len, self._sectors.get(key, {}).values()))

    def take(self, key: SectorKey, t_utc_ns: Ints) -> list[SectorPlots] | None:
        """Plots of a sector, in order, which wait no longer; None if those times are of others.

        The sensor's clock may be ahead, but of all its plots by as much.
        """
        messages = self._forget(key)
        parts = [messages[n] for n in sorted(messages)]
        if sum(map(len, parts)) != len(t_utc_ns):
            return None
        ahead_ns, at = set(), 0
        for part in parts:
            true_ns = t_utc_ns[at : (at := at + len(part))]
            if not part.table.category[part.first]:  # of ASTERIX times are told in steps
                measured_ns = part.table.t_utc_ns[part.first : part.end]
                ahead_ns |= {*(measured_ns - true_ns).tolist()}
        return parts if len(ahead_ns) < 2 else None

    def _forget(self, key: SectorKey) -> dict[int, SectorPlots]:
        messages = self._sectors.pop(key, {})
        self.total -= sum(map(len, messages.values()))
        return messages


class EvidencePart(NamedTuple):
    """What some messages of a recording tell: entries that are new, and the plots of each."""

    told: LedgerTables
    keys: Sequence[SectorKey]  # Of the entries
    # In the order of what is true of them; None where none came, or others than the entry tells of.
    plots: Sequence[Sequence[SectorPlots] | None]
    contradicted: Bools  # Of which entries others came

    def rows(self, which: Ints) -> EvidencePart:
        """The entries at ascending indices."""
        keys, plots = ([each[row] for row in which.tolist()] for each in (self.keys, self.plots))
        return EvidencePart(self.told.of(which), keys, plots, self.contradicted[which])

    def by_sensor(self) -> Iterator[tuple[tuple[str, str], EvidencePart]]:
        """The entries of each prefix and sensor."""
        rows: dict[tuple[str, str], list[int]] = {}
        for row, key in enumerate(self.keys):
            rows.setdefault(key[:2], []).append(row)
        for whose, which in rows.items():
            yield whose, self.rows(np.array(which))


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
        series = list(self.log.counts)
        self._truths = truth_topics(series)
        if not self._truths and self.log.damage:
            raise PlotfeedError(f"{path}: holds no ledger that is whole: {self.log.damage[0]}")
        if not self._truths:
            raise PlotfeedError(
                f"{path}: holds no ledger: expected {LEDGER_BATCH} on a topic that ends in {TRUTH}"
                ", as plotfeed run --record makes it"
            )
        # Prefix and sensor of the topics and stages at which plots are.
        self.carriers = plot_topics_of(series, {*self._truths.values()}, stages)
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

    def parts(self) -> Iterator[EvidencePart]:
        """All of it, in the order of the file, some messages at a time.

        Plots count that come before their entry, or among the messages that are read next.
        """
        waiting = WaitingPlots()
        for part, _ in pairwise(chain(self._told(waiting), [None])):
            if part is None:
                continue
            told, keys = part
            truths, plots = told.plots, list[Sequence[SectorPlots] | None]()
            contradicted = np.zeros(len(told), np.bool_)
            ends = np.searchsorted(truths.entry, np.arange(len(told) + 1)).tolist()
            for n, (key, of) in enumerate(zip(keys, pairwise(ends), strict=True)):
                has_some = waiting.count(key) > 0
                plots.append(waiting.take(key, truths.t_utc_ns[slice(*of)]))
                contradicted[n] = has_some and plots[-1] is None
            yield EvidencePart(told, keys, plots, contradicted)

    def _told(self, waiting: WaitingPlots) -> Iterator[tuple[LedgerTables, list[SectorKey]]]:
        """Entries that are new, of some messages at a time, whose plots then wait."""
        series = {*self._truths, *self.carriers}
        found = self.log.messages(topics={t for t, _ in series}, stages={s for _, s in series})
        octets = self._path.stat().st_size
        messages = with_progress(found, self._path.name, self._file.tell, octets)
        while several := _some_of(messages):
            of = [(message.topic, message.stage) for message in several]
            ledgers = [m for m, key in zip(several, of, strict=True) if key in self._truths]
            carried = (m for m, key in zip(several, of, strict=True) if key in self.carriers)
            for plots in sector_plots(carried, lambda m: self.carriers[m.topic, m.stage]):
                waiting.add(plots)
            yield self._new(ledgers)

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
    series: Iterable[ChannelKey], prefixes: set[str], stages: Sequence[Stage]
) -> dict[tuple[str, Stage], tuple[str, str]]:
    """Prefix and sensor by topic and stage: of each sensor the most exact kind of plots.

    At the first of those stages at which there are any.
    """
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
