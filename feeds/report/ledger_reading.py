"""Reads a recording once and counts what its ledger says of each sensor, in bounded memory."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from google.protobuf.message import DecodeError as ProtobufDecodeError

from plotfeed.feeds.console.status_line import with_progress
from plotfeed.feeds.recording.look_tally import LookTally
from plotfeed.feeds.recording.recorded_session import (
    RecordedSettings,
    SectorKey,
    name_in,
    plot_topics,
    target_of,
)
from plotfeed.feeds.recording.recorder import SCENE_NAME
from plotfeed.feeds.recording.session_again import SessionRecord, recorded_scene
from plotfeed.feeds.report.asked_sensors import AskedByTime, AskedSensor, asked_of
from plotfeed.feeds.report.error_tally import ErrorsTally, MeasuredBesideTruth, SectorTruth
from plotfeed.feeds.report.link_tally import LinkTally, Passage, Setting, Turn
from plotfeed.feeds.report.plot_tally import CELL_M, MAX_CELLS, AlarmsTally, SectorsTally
from plotfeed.models.state import OTHER
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import LEDGER
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.replay.mcap.channels import ChannelKey
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import WHAT_LEFT, Damage, Recorded, Stage

MAX_LINKS = 100
"""Settings of one sensor's link; what is under further ones is not told."""


class SensorTally:
    """Takes its entries one after the other."""

    def __init__(self, prefix: str, sensor: str, asked: AskedByTime | None) -> None:
        self.prefix = prefix
        self.sensor = sensor
        self.entries = 0
        self.plots = 0
        """Of drones and what else was looked at, by the ledger."""
        self.of_others: Counter[str] = Counter()
        """Plots of what is no drone, by what it is."""
        self.links: dict[str, LinkTally] = {}
        """By the JSON of their keys, in the order in which they came into force."""
        self.left_out = 0
        """Entries under settings that were too many."""
        self.passage = Passage()
        self.looks = LookTally(CELL_M, MAX_CELLS)
        self.errors = ErrorsTally()
        self.asked = asked
        """What its scene asked of it; None if that is not known."""
        self.alarms = AlarmsTally(0 if asked is None else asked.sectors)
        self.sectors = SectorsTally()
        self._numbers: dict[str, int] = {}

    def add(self, entry: pb.Ledger) -> AskedSensor | None:
        """Take a sector; what was asked of the sensor in it, if that is known."""
        self.entries += 1
        asked = None
        if self.asked is not None:
            asked = self.asked.in_sector(entry.scan, entry.sector)
            self.sectors.add(entry.scan * self.asked.sectors + entry.sector)
        looks: Sequence[pb.Look] = entry.looks
        if len(looks) > 1 and asked is not None and asked.merges:
            # Those whose echoes merged have one outcome, of the very same odds.
            looks = list({(look.pd, look.channel): look for look in looks}.values())
        odds, detected = [look.pd for look in looks], [look.detected for look in looks]
        self.looks.add([look.range_m for look in looks], odds, detected)
        self.plots += sum(bool(target_of(plot)) for plot in entry.plots)
        self.of_others.update(plot.other.partition(OTHER)[0] for plot in entry.plots if plot.other)
        self.alarms.add(sum(not name_in(plot) for plot in entry.plots), asked)
        link = self._link(entry.link)
        if link is None:
            self.left_out += 1
        else:
            self._take_messages(entry, link)
        return asked

    def end(self) -> None:
        """There are no more."""
        self.passage.end()
        self.sectors.end()
        self.errors.count()
        for link in self.links.values():
            link.count()

    def _link(self, text: str) -> LinkTally | None:
        link = self.links.get(text)
        if link is None and len(self.links) < MAX_LINKS:
            self._numbers[text] = len(self.links)
            link = self.links[text] = LinkTally(Setting.of(text))
        return link

    def _take_messages(self, entry: pb.Ledger, link: LinkTally) -> None:
        row = self._numbers[entry.link]
        for sent in entry.messages:
            fate = sent.fate or (pb.SENT if sent.delivered else pb.FATE_UNSPECIFIED)
            link.add(sent, fate)
            if not sent.copy:
                self.passage.add(Turn(sent.number, sent.due_utc_ns, sent.sent_utc_ns, fate, row))


TRUTH = "/truth"
MAX_SENSORS = 10_000
REMEMBERED = 65_536
"""Entries by which it is noticed that one was recorded twice."""
STAGES = (Stage.BEFORE, Stage.AFTER, Stage.RECEIVED)
"""In which plots are looked for, the most complete first."""


@dataclass(slots=True)
class Counted:
    """What a recording's ledger came to."""

    sensors: dict[tuple[str, str], SensorTally] = field(default_factory=dict)
    """By prefix and name."""
    plots_from: dict[tuple[str, str], str] = field(default_factory=dict)
    """Where the plots were found, by sensor."""
    entries: int = 0
    unreadable: int = 0
    """Entries that are no ledger."""
    repeated: int = 0
    """Entries that were there before."""
    first_ns: int | None = None
    """Log time of the first entry."""
    last_ns: int | None = None
    scene: str = ""
    """Name of the recorded scene, if there is one."""
    scene_sensors: list[str] = field(default_factory=list)
    """Of that scene, in its order."""
    notes: list[str] = field(default_factory=list)
    damage: list[Damage] = field(default_factory=list)


def read(path: Path) -> Counted:
    """Count a file; raises `PlotfeedError` if it is no MCAP or holds no ledger, and `OSError`."""
    try:
        with path.open("rb") as file:
            return _Reading(path, file).counted()
    except DecodeError as error:
        raise PlotfeedError(f"{path}: {error}") from None


class _Reading:
    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file
        self._log = McapReader(file)
        self._found = Counted(damage=self._log.damage)
        series = list(self._log.summary().counts)
        self._truths = truth_topics(series)
        if not self._truths:
            raise PlotfeedError(f"{path}: {_without_ledger(self._log.damage)}")
        self._plots = plot_topics_of(series, self._truths, STAGES)
        self._asked = self._asked_sensors()
        self._join = MeasuredBesideTruth()
        self._seen: OrderedDict[SectorKey, None] = OrderedDict()

    def counted(self) -> Counted:
        """Read it all."""
        for message in self._messages():
            key = (message.topic, message.stage)
            if key in self._truths:
                self._take_entry(message, self._truths[key])
            elif key in self._plots:
                self._join.add_message(message, *self._plots[key])
        self._join.end()
        for sensor in self._found.sensors.values():
            sensor.end()
        for (topic, stage), whose in self._plots.items():
            kind = topic.removeprefix("/".join(whose)).strip("/")
            self._found.plots_from[whose] = f"{kind}, {_WHEN[stage]}"
        return self._found

    def _messages(self) -> Iterator[Recorded]:
        wanted = {topic for topic, _ in (*self._truths, *self._plots)}
        stages = {stage for _, stage in (*self._truths, *self._plots)}
        messages = self._log.messages(topics=wanted, stages=stages)
        octets = self._path.stat().st_size
        return with_progress(messages, self._path.name, self._file.tell, octets)

    def _asked_sensors(self) -> Mapping[str, AskedByTime]:
        """What was asked, by sensor; empty where the file has no scene that can be used."""
        attachments = self._log.attachments()
        if all(attachment.name != SCENE_NAME for attachment in attachments):
            return {}
        try:
            start_utc_ns = SessionRecord.open(self._path).start_utc_ns
            scene = recorded_scene(self._path, self._log)
            settings = RecordedSettings.read(scene, self._log)
        except (PlotfeedError, OSError) as error:
            first_line = str(error).partition("\n")[0]
            self._found.notes.append(f"its scene cannot be used: {first_line}")
            return {}
        self._found.scene = scene.scene.name
        self._found.scene_sensors = [sensor.id for sensor in scene.sensor]
        return asked_of(scene, settings, start_utc_ns)

    def _take_entry(self, message: Recorded, prefix: str) -> None:
        found = self._found
        try:
            entry = pb.Ledger.FromString(message.payload)
        except ProtobufDecodeError:
            found.unreadable += 1
            return
        sector = SectorKey(prefix, entry.sensor, entry.scan, entry.sector)
        if sector in self._seen:
            found.repeated += 1
            return
        self._seen[sector] = None
        if len(self._seen) > REMEMBERED:
            self._seen.popitem(last=False)
        found.entries += 1
        found.first_ns = message.log_time_ns if found.first_ns is None else found.first_ns
        found.last_ns = message.log_time_ns
        self._take(entry, sector)

    def _take(self, entry: pb.Ledger, sector: SectorKey) -> None:
        key = (sector.prefix, sector.sensor)
        tally = self._found.sensors.get(key)
        if tally is None:
            if len(self._found.sensors) >= MAX_SENSORS:
                return
            asked = self._asked.get(sector.sensor)
            tally = self._found.sensors[key] = SensorTally(*key, asked)
        asked_then = tally.add(entry)
        if entry.plots and not self._is_spoilt(entry, key):
            self._join.add_truth(sector, SectorTruth.of(entry, asked_then), tally.errors)

    def _is_spoilt(self, entry: pb.Ledger, whose: tuple[str, str]) -> bool:
        """Tell whether the link has flipped a bit of the very plots that are to be read."""
        flipped = [sent.topic for sent in entry.messages if sent.HasField("flipped_bit")]
        return any(
            self._plots.get((topic, stage)) == whose for topic in flipped for stage in WHAT_LEFT
        )


_WHEN = {
    Stage.BEFORE: "before the link",
    Stage.AFTER: "after the link",
    Stage.RECEIVED: "as received",
}


def _without_ledger(damage: list[Damage]) -> str:
    if damage:
        return f"holds no ledger that is whole: {damage[0]}"
    return (
        f"holds no ledger: expected {LEDGER} on a topic that ends in {TRUTH}, "
        "as plotfeed run --record makes it"
    )


def truth_topics(series: list[ChannelKey]) -> dict[tuple[str, Stage], str]:
    """Prefixes by topic and stage: what left, or else what was received of the same topic."""
    found: dict[str, Stage] = {}
    for each in series:
        unlabelled = "messageType=" not in each.content_type
        if each.topic.endswith(TRUTH) and (unlabelled or each.content_type.endswith(LEDGER)):
            best = found.get(each.topic, each.stage)
            found[each.topic] = Stage.AFTER if Stage.AFTER in (best, each.stage) else best
    return {(topic, stage): topic.removesuffix(TRUTH) for topic, stage in found.items()}


def plot_topics_of(
    series: list[ChannelKey], truths: Mapping[tuple[str, Stage], str], stages: Sequence[Stage]
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
