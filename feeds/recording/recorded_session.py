"""A session as its recording has it: scene, sensors as they were set, plots beside their truth."""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from plotfeed.feeds.formats import FORMATS
from plotfeed.feeds.recording.session_again import recorded_scene
from plotfeed.feeds.replaying.replay_settings import Selection
from plotfeed.feeds.scene.changes import changed, in_force, instants_ns
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor, sensor_of
from plotfeed.feeds.telemetry.position_report import LATEST_UTC_NS
from plotfeed.models.clutter import CLUTTER
from plotfeed.models.sidelobe_echoes import SIDELOBE
from plotfeed.models.state import OTHER, Bools, Floats, Ints
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.plot_messages import batch_in, plots_in_batch, plots_of_batch
from plotfeed.replay.mcap.channels import ChannelKey
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.plots_csv import plots_in
from plotfeed.replay.recorded import WHAT_LEFT, Recorded, Stage

MAX_CHANGES = 10_000
"""Of each sensor that are known; of later ones nothing is told."""


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
            own = self._sensors[sensor]
            controlled = self._controlled[sensor][commands - 1][1] if commands else {}
            try:
                found = changed(own, *in_force(own.event, elapsed_ns), controlled)
            except PlotfeedError:
                found = None
            self._worked_out[state] = found if commands <= MAX_CHANGES else None
        return self._worked_out[state]


def _until(by_time: Sequence[tuple[int, Any]], t_utc_ns: int) -> int:
    """Count what there was until then."""
    return bisect_right(by_time, t_utc_ns, key=itemgetter(0))


NO_PLOTS = MeasuredPlots.of(())


def plot_topics() -> list[str]:
    """Ends of topics with plots that can be joined with the ledger, those that say most first.

    SAPIENT is none of them, since it keeps the plots of several sectors together.
    """
    rows = (row for row in FORMATS.values() if row.plots_in is not None and row.name != "sapient")
    return [row.facts.topic for row in rows]


class SectorKey(NamedTuple):
    """The sector that plots are of."""

    prefix: str
    """Of the session's topics."""
    sensor: str
    scan: int
    sector: int


class SectorPlots(NamedTuple):
    """The plots in a message, and which of its sector's messages it is."""

    key: SectorKey
    number: int
    plots: MeasuredPlots


def measured_in(message: Recorded) -> MeasuredPlots:
    """The plots in a message; none if it cannot be read."""
    try:
        is_batch = message.topic.endswith("/plots")
        found = plots_in_batch(message.payload) if is_batch else plots_in(message)
    except DecodeError:
        found = None
    return NO_PLOTS if found is None else found


def sector_plots(message: Recorded, prefix: str, sensor: str) -> SectorPlots | None:
    """The plots in a message of that sensor; None if it cannot be read or placed."""
    if message.topic.endswith("/plots"):
        try:
            batch = batch_in(message.payload)
        except DecodeError:
            return None
        key = SectorKey(prefix, sensor, batch.scan, batch.sector)
        return SectorPlots(key, 0, plots_of_batch(batch))
    plots, properties = plots_in(message), dict(message.properties)
    try:
        key = SectorKey(prefix, sensor, int(properties["scan"]), int(properties["sector"]))
        number = int(properties["id"].rpartition("-")[2])
    except (KeyError, ValueError):
        return None
    return None if plots is None else SectorPlots(key, number, plots)


TRUE_COLUMNS = ("range_m", "azimuth_deg", "elevation_deg")
"""Of plots, which the ledger has the truth of."""


def name_in(entry: pb.Look | pb.PlotTruth) -> str:
    """The name of what a look or plot is of, a drone or not; empty for a false alarm."""
    return entry.drone or entry.other


def target_of(plot: pb.PlotTruth) -> str:
    """The name of what was looked at and gave a plot; empty for what is nowhere, too."""
    name = name_in(plot)
    return "" if name.startswith((CLUTTER + OTHER, SIDELOBE + OTHER)) else name


@dataclass(frozen=True, slots=True)
class Truth:
    """The truth of a sector's plots, in their order."""

    values: Floats
    """Slant range in metres, azimuth and elevation in degrees; (n, 3)."""
    of_drone: Bools
    """(n,); the others are false alarms."""
    t_utc_ns: Ints

    @classmethod
    def of(cls, plots: Sequence[pb.PlotTruth]) -> Truth:
        """The truth as the ledger has it."""
        rows = [
            [getattr(plot, name) if plot.HasField(name) else math.nan for name in TRUE_COLUMNS]
            for plot in plots
        ]
        return cls(
            np.array(rows, np.float64).reshape(-1, len(TRUE_COLUMNS)),
            np.array([bool(target_of(plot)) for plot in plots], np.bool_),
            np.array([plot.time_utc_ns for plot in plots], np.int64),
        )

    def __len__(self) -> int:
        return len(self.of_drone)


MAX_WAITING_PLOTS = 200_000
"""Plots that wait for what is true of them; then the oldest are given up."""


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

    def take(self, key: SectorKey, truth: Truth) -> MeasuredPlots | None:
        """Plots of a sector, in order, which wait no longer; None if the truth is of others.

        The sensor's clock may be ahead, but of all its plots by as much.
        """
        messages = self._forget(key)
        plots = MeasuredPlots.joined([NO_PLOTS, *(messages[n] for n in sorted(messages))])
        if len(plots) != len(truth):
            return None
        is_exact = plots.category == 0
        ahead_ns = plots.t_utc_ns[is_exact] - truth.t_utc_ns[is_exact]
        return plots if (ahead_ns == ahead_ns[:1]).all() else None

    def _forget(self, key: SectorKey) -> dict[int, MeasuredPlots]:
        messages = self._sectors.pop(key, {})
        self._count -= sum(map(len, messages.values()))
        return messages


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedSession:
    """What there is to know of a recording before its messages are read one by one."""

    path: Path
    scene: Scene
    start_ns: int
    """Log time of its first message."""
    end_ns: int
    ledger: str | None
    """The topic of the ledger; None if it holds none."""
    carriers: Mapping[str, str]
    """Sensors, by the topics from which their plots are taken."""
    carried: tuple[Stage, ...]
    """The stages at which they are."""
    settings: RecordedSettings
    notes: tuple[str, ...]
    """Sentences on what of it is not shown."""

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
        summary = log.summary()
        scene = recorded_scene(path, log)
        series = summary.counts.keys()
        if summary.start_ns is None or summary.end_ns is None or not any(map(_is_sent, series)):
            raise PlotfeedError("expected messages that sensors sent; it holds none")
        if summary.end_ns > LATEST_UTC_NS:
            raise PlotfeedError("expected times before the year 2262")
        ledger = f"{scene.mqtt.prefix}/truth"
        has_ledger = any(s.topic == ledger and s.stage in WHAT_LEFT for s in series)
        has_before = any(s.stage is Stage.BEFORE for s in series)
        carried = (Stage.BEFORE,) if has_ledger and has_before else WHAT_LEFT
        carriers = _carriers(scene, {s.topic for s in series if s.stage in carried})
        if not has_ledger and not carriers:
            raise PlotfeedError(
                f"no plots to show: expected the ledger, {scene.mqtt.prefix}/SENSOR/plots, "
                "or ASTERIX 048, 015 or 205"
            )
        settings = RecordedSettings.read(scene, log)  # to the end, so that damage is known
        return cls(
            path=path,
            scene=scene,
            start_ns=summary.start_ns,
            end_ns=summary.end_ns,
            ledger=ledger if has_ledger else None,
            carriers=carriers,
            carried=carried,
            settings=settings,
            notes=tuple(_notes(scene, carriers, len(log.damage), has_ledger=has_ledger)),
        )


def _is_sent(series: ChannelKey) -> bool:
    return Selection().takes(series.topic, series.content_type, series.stage)


def _carriers(scene: Scene, topics: set[str]) -> dict[str, str]:
    found = {}
    for sensor in scene.sensor:
        of_sensor = (f"{scene.mqtt.prefix}/{sensor.id}/{end}" for end in plot_topics())
        topic = next((topic for topic in of_sensor if topic in topics), None)
        if topic is not None:
            found[topic] = sensor.id
    return found


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
