"""The feeds of a recording's sensors as they were delivered, beside the truth of its ledger."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from google.protobuf.message import DecodeError as ProtobufDecodeError

from plotfeed.feeds.console.status_line import with_progress
from plotfeed.feeds.recording.recorded_session import (
    NO_PLOTS,
    RecordedSettings,
    SectorKey,
    SectorPlots,
    name_in,
    sector_plots,
)
from plotfeed.feeds.recording.session_again import SessionRecord, recorded_scene
from plotfeed.feeds.report.asked_sensors import AskedByTime, AskedSensor, asked_of
from plotfeed.feeds.report.ledger_reading import plot_topics_of, truth_topics
from plotfeed.feeds.score.claimed_feed import (
    BelievedSensor,
    ClaimedLooks,
    SensorFeed,
    left_of_pd,
)
from plotfeed.models.clutter import CLUTTER
from plotfeed.models.state import OTHER
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import Recorded, Stage

AS_DELIVERED = (Stage.AFTER, Stage.RECEIVED, Stage.BEFORE)
"""Where plots are looked for: as a tracker had them, if that is there."""


class FeedGathering:
    """What came of one sensor, sector by sector, until it is all there."""

    def __init__(self, asked: AskedByTime | None, plots_topic: str) -> None:
        self.lost = 0
        """Sectors of which a message with plots did not arrive whole."""
        self._asked = asked
        self._topic = plots_topic
        self._believed: list[BelievedSensor | None] = []
        self._number_of: dict[int, int] = {}
        self._kept: list[AskedSensor | None] = []
        """So that no identity is used twice."""
        self._targets: dict[str, int] = {}
        self._looks: list[tuple[float, ...]] = []
        self._times_ns: list[int] = []
        self._sectors: dict[SectorKey, int] = {}
        self._keys: list[int] = []
        self._plots: dict[SectorKey, dict[int, MeasuredPlots]] = {}
        self._scans = 0.0
        self._has_clutter = False

    def take_plots(self, found: SectorPlots) -> None:
        """Take the plots of a message; copies of it are passed over."""
        self._plots.setdefault(found.key, {}).setdefault(found.number, found.plots)

    def take_entry(self, entry: pb.Ledger, key: SectorKey) -> None:
        """Take what the ledger says of a sector."""
        if key in self._sectors:
            return
        carriers = [sent for sent in entry.messages if sent.topic == self._topic and not sent.copy]
        if any(not sent.delivered or sent.HasField("flipped_bit") for sent in carriers):
            self.lost += 1
            self._plots.pop(key, None)
            return
        asked = None if self._asked is None else self._asked.in_sector(entry.scan, entry.sector)
        sector = self._sectors[key] = len(self._keys)
        self._keys.append(self._number(asked))
        self._scans += 1 / (1 if self._asked is None else self._asked.sectors)
        left = left_of_pd(asked)
        for look in entry.looks:
            target = self._targets.setdefault(name_in(look), len(self._targets))
            pd = min(look.pd / left, 1.0) if left > 0 else 0.0
            self._times_ns.append(look.time_utc_ns)
            self._looks.append(
                (sector, look.channel, target, look.range_m, look.azimuth_deg,
                 look.elevation_deg, pd, left > 0)
            )  # fmt: skip
        others = (plot.other for plot in entry.plots)
        self._has_clutter |= any(other.startswith(CLUTTER + OTHER) for other in others)

    def feed(self) -> SensorFeed:
        """All of it."""
        table = np.array(self._looks, np.float64).reshape(-1, 8).T
        parts, sectors = [NO_PLOTS], []
        for key, sector in self._sectors.items():
            messages = self._plots.get(key, {})
            for number in sorted(messages):
                parts.append(messages[number])
                sectors.append(np.full(len(messages[number]), sector))
        why = "clutter that the scene has beside is not claimed" if self._has_clutter else ""
        return SensorFeed(
            ClaimedLooks(
                sector=table[0].astype(np.int64),
                channel=table[1].astype(np.int64),
                target=table[2].astype(np.int64),
                t_utc_ns=np.array(self._times_ns, np.int64),
                range_m=table[3],
                azimuth_deg=table[4],
                elevation_deg=table[5],
                pd=table[6],
                counts=table[7].astype(np.bool_),
            ),
            MeasuredPlots.joined(parts),
            np.concatenate([np.zeros(0, np.int64), *sectors]),
            np.array(self._keys, np.int64),
            self._believed,
            self._scans,
            why,
        )

    def _number(self, asked: AskedSensor | None) -> int:
        """The number of what is claimed in a sector."""
        if id(asked) not in self._number_of:
            self._number_of[id(asked)] = len(self._believed)
            self._kept.append(asked)
            self._believed.append(None if asked is None else BelievedSensor.by(asked))
        return self._number_of[id(asked)]


class RecordedFeeds(NamedTuple):
    """What a recording holds of feeds."""

    sensors: Mapping[str, SensorFeed]
    carriers: Mapping[str, str]
    """The end of the topic from which each sensor's plots are, and the stage."""
    lost: Mapping[str, int]
    """Sectors whose plots did not arrive, by sensor."""
    notes: Sequence[str]


def recorded_feeds(path: Path) -> RecordedFeeds:
    """Read a recording; raises `PlotfeedError` without a ledger in it, and `OSError`."""
    try:
        with path.open("rb") as file:
            return _read(path, McapReader(file), file.tell)
    except DecodeError as error:
        raise PlotfeedError(f"{path}: {error}") from None


def _read(path: Path, log: McapReader, tell: Callable[[], int]) -> RecordedFeeds:
    series = list(log.summary().counts)
    truths = truth_topics(series)
    if not truths:
        raise PlotfeedError(f"{path}: holds no ledger, as plotfeed run --record makes it")
    topics = plot_topics_of(series, truths, AS_DELIVERED)
    asked, notes = _asked(path, log)
    gathered = {
        whose: FeedGathering(asked.get(whose[1]), topic) for (topic, _), whose in topics.items()
    }
    wanted = {topic for topic, _ in (*truths, *topics)}
    stages = {stage for _, stage in (*truths, *topics)}
    messages: Iterator[Recorded] = log.messages(topics=wanted, stages=stages)
    for message in with_progress(messages, path.name, tell, path.stat().st_size):
        key = (message.topic, message.stage)
        if key in truths:
            _take_entry(message, truths[key], gathered)
        elif key in topics:
            found = sector_plots(message, *topics[key])
            if found is not None:
                gathered[topics[key]].take_plots(found)
    if log.damage:
        notes.append(f"damaged places that are left out: {len(log.damage)}")
    several = len({prefix for prefix, _ in gathered}) > 1
    names = {whose: "/".join(whose) if several else whose[1] for whose in gathered}
    return RecordedFeeds(
        {names[whose]: each.feed() for whose, each in gathered.items()},
        {
            names[whose]: f"{topic.removeprefix('/'.join(whose)).strip('/')}, {_WHEN[stage]}"
            for (topic, stage), whose in topics.items()
        },
        {names[whose]: each.lost for whose, each in gathered.items()},
        notes,
    )


_WHEN = {
    Stage.BEFORE: "before the link",
    Stage.AFTER: "as delivered",
    Stage.RECEIVED: "as received",
}


def _take_entry(
    message: Recorded, prefix: str, gathered: Mapping[tuple[str, str], FeedGathering]
) -> None:
    try:
        entry = pb.Ledger.FromString(message.payload)
    except ProtobufDecodeError:
        return
    of = gathered.get((prefix, entry.sensor))
    if of is not None:
        of.take_entry(entry, SectorKey(prefix, entry.sensor, entry.scan, entry.sector))


def _asked(path: Path, log: McapReader) -> tuple[Mapping[str, AskedByTime], list[str]]:
    """What was asked of each sensor; nothing where the file has no scene that can be used."""
    try:
        start_utc_ns = SessionRecord.open(path).start_utc_ns
        scene = recorded_scene(path, log)
        settings = RecordedSettings.read(scene, log)
    except (PlotfeedError, OSError) as error:
        first_line = str(error).partition("\n")[0]
        return {}, [f"its scene cannot be used, so plots alone say what is claimed: {first_line}"]
    return asked_of(scene, settings, start_utc_ns), []
