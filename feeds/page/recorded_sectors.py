"""What a recording's sensors reported, as its ledger has it, and where they saw the drones."""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, chain
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from google.protobuf.message import DecodeError as ProtobufDecodeError

from plotfeed.feeds.recording.recorded_session import (
    NO_PLOTS,
    RecordedSession,
    SectorKey,
    Truth,
    WaitingPlots,
    measured_in,
    name_in,
    sector_plots,
)
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.live_samples import fit_velocity
from plotfeed.models.state import FALSE_ALARM, Floats, Ints, Looks, Plots, TruthState
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.utc import DAY_NS, NS
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import WHAT_LEFT, Recorded

UNKNOWN_DRONE = -2
"""Of a plot of which nothing says whose it is; pages know it."""
MOST_M, MOST_DEG, MOST_DB = 1e7, 360.0, 300.0


class DroneNumbers:
    """Drones by their names, in the order in which they were first told of."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self._numbers: dict[str, int] = {}

    def of(self, name: str) -> int:
        """The number of a drone."""
        number = self._numbers.get(name)
        if number is None:
            number = self._numbers[name] = len(self.names)
            self.names.append(name)
        return number


def plots_of(
    measured: MeasuredPlots, truths: Sequence[pb.PlotTruth], drones: DroneNumbers
) -> Plots:
    """Plots, and whose they are as the ledger says in the same order."""
    merged = np.empty(len(truths), np.object_)
    merged[:] = [tuple(map(drones.of, truth.merged_drones)) for truth in truths]
    truth = Truth.of(truths)
    range_m, azimuth_deg, elevation_deg = np.where(truth.of_drone, truth.values.T, np.nan)
    return nobody_s(measured.but(t_utc_ns=truth.t_utc_ns)).but(
        drone=_ints(drones.of(name) if (name := name_in(t)) else FALSE_ALARM for t in truths),
        merged_drones=merged,
        true_range_m=_within(MOST_M, range_m),
        true_azimuth_deg=_within(MOST_DEG, azimuth_deg),
        true_elevation_deg=_within(MOST_DEG, elevation_deg),
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


def looks_of(looks: Sequence[pb.Look], drones: DroneNumbers) -> Looks:
    """What the ledger says that sensors looked at."""
    return Looks(
        drone=_ints(drones.of(name_in(look)) for look in looks),
        channel=_ints(look.channel for look in looks),
        t_utc_ns=_ints(look.time_utc_ns for look in looks),
        range_m=np.nan_to_num(_within(MOST_M, (look.range_m for look in looks))),
        azimuth_deg=_within(MOST_DEG, (look.azimuth_deg for look in looks)),
        elevation_deg=_within(MOST_DEG, (look.elevation_deg for look in looks)),
        snr=_ratio(look.snr_db for look in looks),
        pd=np.nan_to_num(_within(1.0, (look.pd for look in looks))).clip(0.0),
        detected=np.array([look.detected for look in looks], np.bool_),
        emitted_utc_ns=_ints(look.emitted_utc_ns for look in looks),
    )


def _ints(values: Iterable[int]) -> Ints:
    return np.fromiter(values, np.int64)


def _within(most: float, values: Iterable[float]) -> Floats:
    column = values if isinstance(values, np.ndarray) else np.fromiter(values, np.float64)
    return np.where(np.abs(column) <= most, column, np.nan)


def _ratio(decibels: Iterable[float]) -> Floats:
    ratio: Floats = 10.0 ** (_within(MOST_DB, decibels) / 10.0)
    return ratio


FAR_NS = DAY_NS
"""Times further from a recording than this are not its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedSector:
    """A sector of a recording, or a message where there is no ledger."""

    at_ns: int
    """Log time at which this was known."""
    sensor: str
    looks: Looks
    plots: Plots
    sent: Sequence[pb.Sent]
    link: str | None
    """The link's keys then, in JSON, empty for none; None if that is not known."""


class _Entry(NamedTuple):
    """A sector as it was read."""

    at_ns: int
    told: pb.Ledger
    """Without plots where those that were measured are not known."""
    measured: MeasuredPlots


class RecordedSectors:
    """Reads a recording from a time on, as far as it is asked to; it may be used in a thread."""

    def __init__(
        self, log: McapReader, recording: RecordedSession, drones: DroneNumbers, from_ns: int
    ) -> None:
        self.read_ns = from_ns
        """Log time as far as which it has read."""
        self._recording = recording
        self._prefix = recording.scene.mqtt.prefix
        self._drones = drones
        self._waiting = WaitingPlots()
        topics = {*recording.carriers, *([recording.ledger] if recording.ledger else [])}
        stages = {*recording.carried, *WHAT_LEFT}
        self._messages = log.messages(from_ns, None, topics, stages)
        self._next: Recorded | None = None

    def until(self, t_ns: int) -> list[RecordedSector]:
        """What was known then, and is new since the last call."""
        entries: list[_Entry] = []
        message = self._next or next(self._messages, None)
        while message is not None and message.log_time_ns <= t_ns:
            entries += self._taken(message)
            message = next(self._messages, None)
        self.read_ns, self._next = t_ns, message
        return list(self._sectors(entries))

    def _taken(self, message: Recorded) -> Iterator[_Entry]:
        if message.topic == self._recording.ledger:
            yield from self._entry(message)
        elif message.stage not in self._recording.carried:
            return
        elif self._recording.ledger is None:
            yield self._alone(message)
        else:
            self._wait(message)

    def _wait(self, message: Recorded) -> None:
        """Keep plots until the ledger tells of them."""
        sensor = self._recording.carriers[message.topic]
        found = sector_plots(message, self._prefix, sensor)
        if found is not None:
            self._waiting.add(found)

    def _entry(self, message: Recorded) -> Iterator[_Entry]:
        """Take an entry of the ledger; what is none, or of another time, is passed over."""
        try:
            told = pb.Ledger.FromString(message.payload)
        except ProtobufDecodeError:
            return
        if not self._is_plausible(told):
            return
        key = SectorKey(self._prefix, told.sensor, told.scan, told.sector)
        measured = self._waiting.take(key, Truth.of(told.plots))
        if measured is None:
            del told.plots[:]
        yield _Entry(message.log_time_ns, told, NO_PLOTS if measured is None else measured)

    def _alone(self, message: Recorded) -> _Entry:
        """Plots as they were delivered, and nothing besides."""
        told = pb.Ledger(sensor=self._recording.carriers[message.topic])
        told.messages.add(
            topic=message.topic,
            due_utc_ns=message.publish_time_ns,
            link_due_utc_ns=message.log_time_ns,
            sent_utc_ns=message.log_time_ns,
            delivered=True,
            fate=pb.SENT,
        )
        measured, due_ns = measured_in(message), message.publish_time_ns
        times_ns = [due_ns if t_ns is None else t_ns for t_ns in measured.t_utc_ns]
        timed = measured.but(t_utc_ns=np.array(times_ns, np.int64))
        return _Entry(message.log_time_ns, told, timed)

    def _sectors(self, entries: Sequence[_Entry]) -> Iterator[RecordedSector]:
        """Columns of all entries, made at once and cut."""
        has_ledger = self._recording.ledger is not None
        measured = MeasuredPlots.joined([NO_PLOTS, *(entry.measured for entry in entries)])
        truths = list(chain.from_iterable(entry.told.plots for entry in entries))
        plots = plots_of(measured, truths, self._drones) if has_ledger else nobody_s(measured)
        told_looks = chain.from_iterable(entry.told.looks for entry in entries)
        looks = looks_of(list(told_looks), self._drones)
        plot_ends = accumulate(len(entry.measured) for entry in entries)
        look_ends = accumulate(len(entry.told.looks) for entry in entries)
        for entry, plot_end, look_end in zip(entries, plot_ends, look_ends, strict=True):
            yield RecordedSector(
                at_ns=entry.at_ns,
                sensor=entry.told.sensor,
                looks=looks.between(look_end - len(entry.told.looks), look_end),
                plots=plots.between(plot_end - len(entry.measured), plot_end),
                sent=entry.told.messages,
                link=entry.told.link if has_ledger else None,
            )

    def _is_plausible(self, told: pb.Ledger) -> bool:
        """Tell whether times of an entry are near those of the recording."""
        first_ns, last_ns = self._recording.start_ns - FAR_NS, self._recording.end_ns + FAR_NS
        times = chain(
            (look.time_utc_ns for look in told.looks),
            (look.emitted_utc_ns or first_ns for look in told.looks),
            (plot.time_utc_ns for plot in told.plots),
            (one.due_utc_ns for one in told.messages),
            (one.sent_utc_ns or first_ns for one in told.messages),
            (one.link_due_utc_ns or first_ns for one in told.messages),
        )
        return all(first_ns <= t_ns <= last_ns for t_ns in times)


KEPT = 12
"""Places of a drone, the latest ones."""
SIGMA_M = 0.1
"""A velocity is fitted to places as if they were known so well, so that it is that of now."""
SCANS = 2.5
"""A drone that no sensor has looked at for so many of the longest scans is not there."""


class _Seen(NamedTuple):
    t_ns: int
    position_ecef_m: Floats
    velocity_ecef_m_s: Floats


class SeenDrones:
    """Where the ledger's looks say that drones were."""

    def __init__(self, scene: Scene) -> None:
        self._frames = {s.id: frame_at(scene.scene.site, s.position_enu_m) for s in scene.sensor}
        longest_s = max(sensor.scan.period_s for sensor in scene.sensor)
        self._alive_ns = round(max(scene.telemetry.stale_after_s, SCANS * longest_s) * NS)
        self._places: dict[int, list[tuple[int, Floats]]] = {}
        self._latest: dict[int, _Seen] = {}
        self._changed: set[int] = set()
        """Drones that were seen since the last were worked out."""

    def take(self, sensor: str, looks: Looks) -> None:
        """What a sensor looked at."""
        if sensor not in self._frames:
            return
        geometry = (looks.azimuth_deg, looks.elevation_deg, looks.range_m)
        there = (looks.drone >= 0) & np.isfinite(geometry).all(axis=0)
        place_m = self._frames[sensor].to_ecef(aer_to_enu(*(part[there] for part in geometry)))
        t_utc_ns, drones = looks.t_utc_ns[there], looks.drone[there].tolist()
        if looks.emitted_utc_ns is not None:
            emitted_ns = looks.emitted_utc_ns[there]
            t_utc_ns = np.where(emitted_ns, emitted_ns, t_utc_ns)
        for drone, t_ns, position in zip(drones, t_utc_ns.tolist(), place_m, strict=True):
            self._note(drone, t_ns, position)

    def state_at(self, t_utc_ns: int) -> TruthState:
        """Drones that are there then, moved on from where they were seen last."""
        for drone in self._changed:
            times, positions = zip(*self._places[drone], strict=True)
            velocity_m_s = fit_velocity(times, positions, SIGMA_M)
            self._latest[drone] = _Seen(times[-1], positions[-1], velocity_m_s)
        self._changed.clear()
        there = [(k, v) for k, v in self._latest.items() if t_utc_ns - v.t_ns <= self._alive_ns]
        since_s = np.array([(t_utc_ns - seen.t_ns) / NS for _, seen in there])
        position_m = np.array([seen.position_ecef_m for _, seen in there]).reshape(-1, 3)
        velocity_m_s = np.array([seen.velocity_ecef_m_s for _, seen in there]).reshape(-1, 3)
        return TruthState(
            drone=np.array([drone for drone, _ in there], np.int64),
            t_utc_ns=np.full(len(there), t_utc_ns),
            position_ecef_m=position_m + since_s[:, None] * velocity_m_s,
            velocity_ecef_m_s=velocity_m_s,
        )

    def _note(self, drone: int, t_ns: int, position_ecef_m: Floats) -> None:
        """Sensors tell of the same time, and of earlier ones, too."""
        places = self._places.setdefault(drone, [])
        if any(t_ns == other_ns for other_ns, _ in places):
            return
        insort(places, (t_ns, position_ecef_m), key=itemgetter(0))
        del places[:-KEPT]
        self._changed.add(drone)
