"""What a recording's sensors reported, as its ledger has it, and where they saw the drones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import Self

import numpy as np

from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.recording.recorded_plots import (
    NO_PLOTS,
    SectorKey,
    SectorPlots,
    WaitingPlots,
    are_targets,
    names_of,
    plot_topics_of,
    plots_in_rows,
    sector_plots,
)
from plotfeed.feeds.recording.recorded_settings import RecordedSettings
from plotfeed.feeds.recording.recorder import recorded_scene
from plotfeed.feeds.replaying.replay_settings import ReplaySettings
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.telemetry.position_report import LATEST_UTC_NS
from plotfeed.models.beam import Sector, Sectors
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.state import FALSE_ALARM, Bools, Floats, Ints, Looks, Plots, TruthState
from plotfeed.models.truth import LiveSamples, place, slope
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.ledger import LedgerTables, ToldLooks, ToldPlots, rows_told, tables_of
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.utc import DAY_NS, NS
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.plots_csv import plots_in
from plotfeed.replay.recorded import WHAT_LEFT, Recorded, Stage

UNKNOWN_DRONE = -2  # Of a plot of which nothing says whose it is; pages know it
MOST_M, MOST_DEG, MOST_DB = 1e7, 360.0, 300.0


class DroneNumbers(dict[str, int]):
    """Drones by their names, numbered in the order in which they were first told of."""

    def __missing__(self, name: str) -> int:
        number = self[name] = len(self)
        return number


def plots_of(measured: MeasuredPlots, told: ToldPlots, drones: DroneNumbers) -> Plots:
    """Plots, and whose they are as the ledger says in the same order."""
    names = names_of(told)
    is_target = are_targets(names)
    merged = np.empty(len(told), np.object_)
    merged[:] = [tuple(drones[name] for name in each) for each in told.merged_drones]
    return nobody_s(measured.but(t_utc_ns=told.t_utc_ns)).but(
        drone=_ints(drones[name] if name else FALSE_ALARM for name in names),
        merged_drones=merged,
        true_range_m=_within(MOST_M, np.where(is_target, told.range_m, np.nan)),
        true_azimuth_deg=_within(MOST_DEG, np.where(is_target, told.azimuth_deg, np.nan)),
        true_elevation_deg=_within(MOST_DEG, np.where(is_target, told.elevation_deg, np.nan)),
    )


def nobody_s(measured: MeasuredPlots) -> Plots:
    """Plots of which nothing says whose they are; their times are known."""
    return Plots.of(
        t_utc_ns=measured.t_utc_ns.astype(np.int64),
        drone=np.full(len(measured), UNKNOWN_DRONE),
        range_m=_within(MOST_M, measured.range_m),
        azimuth_deg=_within(MOST_DEG, measured.azimuth_deg),
        elevation_deg=_within(MOST_DEG, measured.elevation_deg),
        height_m=_within(MOST_M, measured.height_m),
        snr=_ratio(measured.snr_db),
    )


def looks_of(told: ToldLooks, drones: DroneNumbers) -> Looks:
    """What the ledger says that sensors looked at."""
    return Looks(
        drone=_ints(drones[name] for name in names_of(told)),
        channel=told.channel,
        t_utc_ns=told.t_utc_ns,
        range_m=np.nan_to_num(_within(MOST_M, told.range_m)),
        azimuth_deg=_within(MOST_DEG, told.azimuth_deg),
        elevation_deg=_within(MOST_DEG, told.elevation_deg),
        snr=_ratio(told.snr_db),
        pd=np.nan_to_num(_within(1.0, told.pd)).clip(0.0),
        detected=told.detected,
        emitted_utc_ns=told.emitted_utc_ns,
    )


def _ints(values: Iterable[int]) -> Ints:
    return np.fromiter(values, np.int64)


def _within(most: float, column: Floats) -> Floats:
    return np.where(np.abs(column) <= most, column, np.nan)


def _ratio(decibels: Floats) -> Floats:
    ratio: Floats = 10.0 ** (_within(MOST_DB, decibels) / 10.0)
    return ratio


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedSession:
    """What there is to know of a recording before its messages are read one by one."""

    path: Path
    scene: Scene
    start_ns: int  # Log time of its first message
    end_ns: int
    ledger: str | None  # The topic of the ledger; None if it holds none
    carriers: Mapping[str, str]  # Sensors, by the topics from which their plots are taken
    carried: tuple[Stage, ...]  # The stages at which they are
    settings: RecordedSettings
    notes: tuple[str, ...]  # Sentences on what of it is not shown

    @classmethod
    def open(cls, path: Path) -> Self:
        """Read it to its end; raises `PlotfeedError` in one line if it cannot be shown."""
        try:
            with McapReader(path) as log:
                return cls._of(path, log)
        except OSError as error:
            raise PlotfeedError(f"{path.name}: {error.strerror or error}") from None
        except PlotfeedError as error:
            line = str(error).partition("\n")[0].removeprefix(f"{path}: ")
            raise PlotfeedError(f"{path.name}: {line}") from None

    @classmethod
    def _of(cls, path: Path, log: McapReader) -> Self:
        scene = recorded_scene(path, log)
        series, takes = log.counts.keys(), ReplaySettings().takes
        are_sent = any(takes(s.topic, s.content_type, s.stage) for s in series)
        if log.times_ns is None or not are_sent:
            raise PlotfeedError("expected messages that sensors sent; it holds none")
        start_ns, end_ns = log.times_ns
        if end_ns > LATEST_UTC_NS:
            raise PlotfeedError("expected times before the year 2262")
        ledger = f"{scene.mqtt.prefix}/truth"
        has_ledger = any(s.topic == ledger and s.stage in WHAT_LEFT for s in series)
        has_before = any(s.stage is Stage.BEFORE for s in series)
        carried = (Stage.BEFORE,) if has_ledger and has_before else WHAT_LEFT
        found, ids = (
            plot_topics_of(series, {scene.mqtt.prefix}, carried),
            {s.id for s in scene.sensor},
        )
        carriers = {topic: sensor for (topic, _), (_, sensor) in found.items() if sensor in ids}
        if not has_ledger and not carriers:
            raise PlotfeedError(
                f"no plots to show: expected the ledger, {scene.mqtt.prefix}/SENSOR/plots, "
                "or ASTERIX 048, 015 or 205"
            )
        settings = RecordedSettings.read(scene, log)  # to the end, so that damage is known
        return cls(
            path=path,
            scene=scene,
            start_ns=start_ns,
            end_ns=end_ns,
            ledger=ledger if has_ledger else None,
            carriers=carriers,
            carried=carried,
            settings=settings,
            notes=tuple(_notes(scene, carriers, len(log.damage), has_ledger=has_ledger)),
        )


def _notes(
    scene: Scene, carriers: Mapping[str, str], damaged: int, *, has_ledger: bool
) -> Iterable[str]:
    if damaged:
        yield f"Damaged places that are left out: {damaged}."
    if not has_ledger:
        yield "It holds no ledger: no truth, and nothing of what was lost, is known of it."
    silent: Sequence[str] = [s.id for s in scene.sensor if s.id not in carriers.values()]
    if silent:
        yield f"It holds no plots of {', '.join(silent)} that can be read."


FAR_NS = DAY_NS  # Times further from a recording than this are not its own


# A sector of a recording, or a message where there is no ledger, as a session would have handed it
# on, known when the sector ends; and what became of its messages.
Told = tuple[Batch, Sequence[pb.Sent]]


class RecordedSectors:
    """Reads a recording from a time on, as far as it is asked to; it may be used in a thread."""

    def __init__(
        self, log: McapReader, recording: RecordedSession, drones: DroneNumbers, from_ns: int
    ) -> None:
        self.read_ns = from_ns  # Log time as far as which it has read
        self._recording = recording
        self._prefix = recording.scene.mqtt.prefix
        self._drones = drones
        self._waiting = WaitingPlots()
        topics = {*recording.carriers, *([recording.ledger] if recording.ledger else [])}
        stages = {*recording.carried, *WHAT_LEFT}
        self._messages = log.messages(from_ns, None, topics, stages)
        self._next: Recorded | None = None

    def until(self, t_ns: int) -> list[Told]:
        """What was known then, and is new since the last call."""
        ledgers: list[Recorded] = []
        carried: list[Recorded] = []
        message = self._next or next(self._messages, None)
        while message is not None and message.log_time_ns <= t_ns:
            if message.topic == self._recording.ledger:
                ledgers.append(message)
            elif message.stage in self._recording.carried:
                carried.append(message)
            message = next(self._messages, None)
        self.read_ns, self._next = t_ns, message
        if self._recording.ledger is None:
            return [self._alone(each) for each in carried]
        carriers = self._recording.carriers
        for found in sector_plots(carried, lambda m: (self._prefix, carriers[m.topic])):
            self._waiting.add(found)
        return list(self._sectors(ledgers))

    def _sectors(self, ledgers: Sequence[Recorded]) -> Iterator[Told]:
        """Entries of the ledger with their plots; those of other times are passed over."""
        told = tables_of(message.payload for message in ledgers)
        told = told.of(np.flatnonzero(self._are_plausible(told)))
        of, numbers = told.entries, np.arange(len(told) + 1)
        look_ends, plot_ends, sent_ends = (
            np.searchsorted(table.entry, numbers)
            for table in (told.looks, told.plots, told.messages)
        )
        parts, by, is_known = list[SectorPlots](), [0], np.zeros(len(told.plots), np.bool_)
        for i, (first, end) in enumerate(pairwise(plot_ends.tolist())):
            key = SectorKey(self._prefix, of.sensor[i], int(of.scan[i]), int(of.sector[i]))
            measured = self._waiting.take(key, told.plots.t_utc_ns[first:end])
            is_known[first:end] = measured is not None
            parts += measured or []
            by.append(by[-1] + sum(map(len, measured or [])))
        ids, sensor = np.unique(of.sensor.astype(str), return_inverse=True)
        known_ns = (ledgers[n].log_time_ns for n in of.payload.tolist())
        sectors = map(_sector, of.scan.tolist(), of.sector.tolist(), known_ns)
        batch = Batch(
            sectors=Sectors.of([*sectors]).but(sensor=sensor),
            plots=plots_of(plots_in_rows(parts), told.plots.rows(is_known), self._drones),
            plots_by=np.array(by),
            looks=looks_of(told.looks, self._drones),
            looks_by=look_ends,
            sensors=ids.tolist(),
            links=of.link.tolist(),
        )
        sent = [pb.Sent(**row) for row in rows_told(told.messages, pb.Sent)]
        for i, (first, end) in enumerate(pairwise(sent_ends.tolist())):
            yield batch.one(i), sent[first:end]

    def _alone(self, message: Recorded) -> Told:
        """Plots as they were delivered, and nothing besides."""
        measured, due_ns = plots_in(message) or NO_PLOTS, message.publish_time_ns
        times_ns = [due_ns if t_ns is None else t_ns for t_ns in measured.t_utc_ns]
        sent = pb.Sent(
            topic=message.topic,
            due_utc_ns=message.publish_time_ns,
            link_due_utc_ns=message.log_time_ns,
            sent_utc_ns=message.log_time_ns,
            delivered=True,
            fate=pb.SENT,
        )
        plots = nobody_s(measured.but(t_utc_ns=np.array(times_ns, np.int64)))
        sensors = [self._recording.carriers[message.topic]]
        batch = Batch.of_one(_sector(0, 0, message.log_time_ns), plots, sensors=sensors)
        return batch, [sent]

    def _are_plausible(self, told: LedgerTables) -> Bools:
        """Whether times of each entry are near those of the recording."""
        first_ns, last_ns = self._recording.start_ns - FAR_NS, self._recording.end_ns + FAR_NS
        good = np.ones(len(told), np.bool_)
        for table, names in (
            (told.looks, ("t_utc_ns", "emitted_utc_ns")),
            (told.plots, ("t_utc_ns",)),
            (told.messages, ("due_utc_ns", "sent_utc_ns", "link_due_utc_ns")),
        ):
            for name in names:
                t_ns = getattr(table, name)
                near = (t_ns >= first_ns) & (t_ns <= last_ns)
                if name not in ("t_utc_ns", "due_utc_ns"):
                    near |= t_ns == 0  # it is not told
                good[table.entry[~near]] = False
        return good


def _sector(scan: int, index: int, known_ns: int) -> Sector:
    """A sector of which a recording says no more than when what came of it was known."""
    return Sector(scan, index, known_ns, known_ns, np.nan, np.nan)


# A velocity is fitted to places as if they were known so well, so that it is that of now.
SIGMA_M = 0.1
SCANS = 2.5  # A drone that no sensor has looked at for so many of the longest scans is not there


class SeenDrones:
    """Where the ledger's looks say that drones were."""

    def __init__(self, scene: Scene) -> None:
        self._frames = {s.id: frame_at(scene.scene.site, s.position_enu_m) for s in scene.sensor}
        longest_s = max(sensor.scan.period_s for sensor in scene.sensor)
        alive_ns = round(max(scene.telemetry.stale_after_s, SCANS * longest_s) * NS)
        self._places = LiveSamples(stale_after_ns=alive_ns, history_ns=alive_ns)
        self._last_ns: dict[int, int] = {}  # When each drone was seen last

    def take(self, batches: Iterable[Batch]) -> None:
        """What sensors looked at; of a drone nothing that was before what is known of it."""
        found: list[tuple[int, int, Floats]] = []
        for batch in batches:
            looks, frame = batch.looks, self._frames.get(batch.sensor)
            geometry = (looks.azimuth_deg, looks.elevation_deg, looks.range_m)
            there = (looks.drone >= 0) & np.isfinite(geometry).all(axis=0)
            if frame is None or not there.any():
                continue
            t_utc_ns = looks.t_utc_ns[there]
            if looks.emitted_utc_ns is not None:
                emitted_ns = looks.emitted_utc_ns[there]
                t_utc_ns = np.where(emitted_ns, emitted_ns, t_utc_ns)
            place_m = frame.to_ecef(aer_to_enu(*(part[there] for part in geometry)))
            found += zip(t_utc_ns.tolist(), looks.drone[there].tolist(), place_m, strict=True)
        new = []
        for t_ns, drone, place_m in sorted(found, key=itemgetter(0)):
            if t_ns > self._last_ns.get(drone, 0):
                self._last_ns[drone] = t_ns
                new.append((t_ns, drone, place_m))
        if new:
            times_ns, drones, places_m = (np.array(column) for column in zip(*new, strict=True))
            numbers = self._places.add(drones, times_ns, places_m)
            sigma_m = np.full(len(numbers), SIGMA_M)
            self._places.fly(numbers, self._places.fitted_velocity(numbers, sigma_m))

    def state_at(self, t_utc_ns: int) -> TruthState:
        """Drones that are there then, moved on from where they were seen last."""
        drones = np.array(sorted(self._last_ns), np.int64)
        found = self._places.stretches_at(drones, np.full(len(drones), t_utc_ns))
        there, way = found.alive, found.coefficients[:, :, found.alive]
        since_s = (t_utc_ns - found.start_ns[there]) / NS
        return TruthState(
            drone=drones[there],
            t_utc_ns=np.full(len(since_s), t_utc_ns),
            position_ecef_m=place(way, since_s).T,
            velocity_ecef_m_s=slope(way, since_s).T,
        )
