"""False alarms of a sensor: asked for by its scene as it was at a time, and delivered."""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

from plotfeed.feeds.recording.session_record import SessionRecord
from plotfeed.feeds.report.spreads import z_score
from plotfeed.feeds.scene.changes import changed
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.sensor_keys import RotatingScan, in_force, instants_ns
from plotfeed.feeds.sensing.emulated_sensor import AHEAD_NS
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

MAX_COMMANDS = 10_000
"""Settings of a sensor that are kept; with more, nothing is said to be asked."""
Changes = Mapping[str, Any]


@dataclass(slots=True)
class SceneAlarms:
    """Of one sensor of a scene."""

    scene: Scene
    sensor: Sensor
    start_utc_ns: int
    _commands: list[tuple[int, Changes]] = field(default_factory=list)
    _per_scan: dict[tuple[int, int], float] = field(default_factory=dict)
    _instants_ns: list[int] = field(init=False)

    def __post_init__(self) -> None:
        self._instants_ns = instants_ns(self.sensor.event)

    @property
    def sectors(self) -> int:
        """Of a scan."""
        return self.sensor.scan.sectors if isinstance(self.sensor.scan, RotatingScan) else 1

    def control(self, payload: bytes, t_utc_ns: int) -> None:
        """Take what a settings message says that control has changed, from that time on."""
        try:
            said = json.loads(payload)["controlled"]
        except (ValueError, KeyError, TypeError, RecursionError):
            return
        if isinstance(said, dict) and len(self._commands) <= MAX_COMMANDS:
            self._commands.append((t_utc_ns, said))

    def in_sector(self, scan: int, sector: int) -> float:
        """Mean number in a sector; NaN if that cannot be told."""
        period_ns = round(self.sensor.scan.period_s * NS)
        end_utc_ns = (scan * self.sectors + sector + 1) * period_ns // self.sectors
        worked_out_ns = end_utc_ns - min(AHEAD_NS, period_ns // self.sectors)
        elapsed_ns = max(worked_out_ns - self.start_utc_ns, 0)
        events = bisect_right(self._instants_ns, elapsed_ns)
        commands = bisect_right(self._commands, worked_out_ns, key=lambda command: command[0])
        if (events, commands) not in self._per_scan:
            self._per_scan[events, commands] = self._worked_out(elapsed_ns, commands)
        return self._per_scan[events, commands] / self.sectors

    def _worked_out(self, elapsed_ns: int, commands: int) -> float:
        if len(self._commands) > MAX_COMMANDS:
            return math.nan
        control = self._commands[commands - 1][1] if commands else {}
        try:
            sensor = changed(self.sensor, *in_force(self.sensor.event, elapsed_ns), control)
        except PlotfeedError:
            return math.nan
        return sensor.model(self.scene.scene.site).false_alarms_per_scan


def asked_alarms(path: Path) -> dict[str, SceneAlarms]:
    """By sensor, of the record of a session; raises `PlotfeedError` and `OSError`."""
    record = SessionRecord.open(path)
    with TemporaryDirectory(prefix="plotfeed-") as folder:
        scene = record.scene(Path(folder))
    return {sensor.id: SceneAlarms(scene, sensor, record.start_utc_ns) for sensor in scene.sensor}


class AskedAlarms(Protocol):
    """Says how many false alarms a sensor was to have."""

    @property
    def sectors(self) -> int:
        """Of a scan."""

    def in_sector(self, scan: int, sector: int) -> float:
        """Their mean number; NaN if that cannot be told."""

    def control(self, payload: bytes, t_utc_ns: int) -> None:
        """Take what a settings message says, from that time on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmFigures:
    """False alarms of one sensor."""

    count: int
    scans: float
    """That the ledger tells of, parts of them counted as such; NaN where no scene says."""
    asked: float
    """By the scene, in all of these scans; NaN where no scene says."""
    asked_per_scan: float
    delivered_per_scan: float
    z: float


@dataclass(slots=True)
class AlarmsTally:
    """Of one sensor's ledger."""

    asked: AskedAlarms | None
    count: int = 0
    _sectors: int = 0
    _mean: float = 0.0

    def add(self, false_alarms: int, scan: int, sector: int) -> None:
        """Take a sector."""
        self.count += false_alarms
        self._sectors += 1
        if self.asked is not None:
            self._mean += self.asked.in_sector(scan, sector)

    def figures(self) -> AlarmFigures:
        """Of all that were taken."""
        if self.asked is None:
            nan = math.nan
            return AlarmFigures(
                count=self.count,
                scans=nan,
                asked=nan,
                asked_per_scan=nan,
                delivered_per_scan=nan,
                z=nan,
            )
        scans = self._sectors / self.asked.sectors
        return AlarmFigures(
            count=self.count,
            scans=scans,
            asked=self._mean,
            asked_per_scan=self._mean / scans if scans else math.nan,
            delivered_per_scan=self.count / scans if scans else math.nan,
            z=z_score(self.count - self._mean, self._mean),  # binomial over very many cells
        )
