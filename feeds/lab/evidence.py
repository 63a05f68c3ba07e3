"""A recorded session read once: entries of its ledger as columns, and plots, a part at a time.

With what its scene asked of each sensor by time, and what sensors take themselves to be.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, NamedTuple, Self

import numpy as np

from plotfeed.feeds.console.printed import with_progress
from plotfeed.feeds.engine.emulated_sensors import AHEAD_NS
from plotfeed.feeds.lab import oracle
from plotfeed.feeds.recording.recorded_plots import (
    SectorKey,
    SectorPlots,
    WaitingPlots,
    plot_topics_of,
    sector_plots,
)
from plotfeed.feeds.recording.recorded_settings import RecordedSettings
from plotfeed.feeds.recording.recorder import SessionRecord
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.effect_keys import readings_of
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry
from plotfeed.models.beam import Timetable
from plotfeed.models.chance import Chance
from plotfeed.models.effects.readings import Readings
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.sensors.sensor_model import JointSensor, SensorModel
from plotfeed.models.state import Bools, Floats, Ints
from plotfeed.proto.content_types import LEDGER, LEDGER_BATCH, message_type
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.ledger import LedgerTables, tables_of
from plotfeed.proto.utc import NS, NS_IN_MS
from plotfeed.replay.mcap import ChannelKey, McapReader
from plotfeed.replay.recorded import Recorded, Stage

TRUTH = "/truth"
LEDGERS = ("", LEDGER, LEDGER_BATCH)  # What messages there may be, by what they say of themselves
# Messages that are read together, and their octets, as those of the ledger have many sectors.
AT_ONCE, OCTETS_AT_ONCE = 8192, 4 << 20
REMEMBERED = 65_536  # Entries by which it is noticed that one was recorded twice
MOST_COMPLETE = (Stage.BEFORE, Stage.AFTER, Stage.RECEIVED)
# Stages at which plots are looked for, the best first: the most complete, or as a tracker saw.
AS_DELIVERED = (Stage.AFTER, Stage.RECEIVED, Stage.BEFORE)


# Sensors whose plots state errors that follow from their own ratios, as the oracle has them.
RADARS = frozenset({"active_radar", "mimo_radar", "passive_radar"})
MOST_LACKING = 100_000  # Sectors in a row, that are looked at one by one


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
    def is_joined(self) -> bool:
        """Whether its plots are places that several detections make, and how these err is known."""
        return self.keys.type in oracle.JOINED

    @property
    def errs_as_known(self) -> bool:
        """Whether it is known how its plots err: as they state, or as several detections do."""
        return self.model.errs_as_stated or self.is_joined

    @property
    def is_steered(self) -> bool:
        """Whether it steers its beam dwell by dwell, some of which search."""
        return bool(self.keys.scan.kind == "electronic")

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
        sensors = self._asked.values()
        if any(isinstance(each.model, JointSensor) for each in sensors):
            errors = "" if all(each.is_joined for each in sensors) else "errors and "
            return f"{errors}false alarms, as detections are joined to places, some wrongly"
        if any(not each.errs_as_known for each in sensors):
            return "errors, which a layout of microphones leaves other than normal"
        return ""

    def missed(self, lacking: range) -> int:
        """How many of those sectors, by number, there were to be: it was at work."""
        asked = (self.in_sector(*divmod(n, self.sectors)) for n in lacking[:MOST_LACKING])
        return sum(each is not None and each.keys.enabled for each in asked)


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
