"""The sensors that a recorded scene asked for, as its script and control had them by time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plotfeed.feeds.recording.recorded_session import RecordedSettings
from plotfeed.feeds.scene.fields import Site, frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.effect_keys import readings_of
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry
from plotfeed.feeds.sensing.emulated_sensors import AHEAD_NS
from plotfeed.models.beam import Timetable
from plotfeed.models.chance import Chance
from plotfeed.models.effects.readings import Readings
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.sensors.joint_sensor import JointSensor
from plotfeed.models.sensors.sensor_model import SensorModel
from plotfeed.models.state import Floats, Ints
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS, NS_IN_MS


@dataclass(frozen=True)
class AskedSensor:
    """A sensor as it was to be while its keys stayed the same."""

    keys: Sensor
    site: Site
    chance: Chance
    sea_level: SeaLevel | None
    """By which heights above mean sea level are told; None if its grid cannot be read here."""

    @cached_property
    def model(self) -> SensorModel:
        """The model that its keys make."""
        return self.keys.model(self.site)

    @cached_property
    def frame(self) -> LocalFrame:
        """The sensor's place, with true axes."""
        return frame_at(self.site, self.keys.position_enu_m)

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
        return readings_of(keys.bias, keys.drift, self.chance, keys.scan.period_ns)

    def undulation_m(self, azimuth_deg: Floats, elevation_deg: Floats, range_m: Floats) -> Floats:
        """Heights of mean sea level above the ellipsoid at places; (n,), NaN if not known."""
        if self.sea_level is None:
            return np.full(len(range_m), np.nan)
        there_enu_m = aer_to_enu(azimuth_deg, elevation_deg, range_m)
        return self.sea_level.undulation_m(*self.frame.to_geodetic(there_enu_m)[:2])

    def folded_error(self, quantity: str, error: Floats, channel: Ints) -> Floats:
        """Errors of what looks alike after a span, range rates and ranges by pulses; (n,)."""
        doppler, intervals = (getattr(self.model, name, None) for name in ("doppler", "intervals"))
        if quantity == "range rate" and doppler is not None:
            return np.asarray(doppler.folded(error, channel))
        if quantity == "range" and intervals is not None:
            return np.asarray(intervals.nearest_m(error))
        return error

    @cached_property
    def clock_ahead_ns(self) -> int:
        """Nanoseconds by which its clock is to be ahead."""
        return 0 if self.keys.bias is None else round(self.keys.bias.time_offset_s * NS)

    @property
    def merges(self) -> bool:
        """Whether echoes that are near each other are to make one plot."""
        return getattr(self.model, "merging", None) is not None

    @cached_property
    def error_factor(self) -> float | Floats:
        """Errors over the stated ones; NaN where plots do not err by what they state."""
        return self.model.error_factor if self.model.errs_as_stated else np.nan

    @property
    def is_bistatic(self) -> bool:
        """Whether it measures bistatic ranges."""
        return self.keys.geometry is SensorGeometry.BISTATIC

    @cached_property
    def false_alarms_per_scan(self) -> float:
        """Mean number; NaN where ghosts are among them."""
        if isinstance(self.model, JointSensor):
            return np.nan
        return self.model.false_alarms_per_scan


class AskedByTime:
    """One sensor of a recorded scene, by its sectors."""

    def __init__(
        self, scene: Scene, sensor: Sensor, settings: RecordedSettings, start_utc_ns: int
    ) -> None:
        self.sectors = sensor.scan.sectors
        """Of a scan."""
        self._sensor, self._settings, self._start_utc_ns = sensor.id, settings, start_utc_ns
        self._site = scene.scene.site
        try:
            self._sea_level: SeaLevel | None = SeaLevel.of(scene)
        except PlotfeedError:
            self._sea_level = None
        self._chance = Chance(scene.scene.seed, sensor.id)
        scan = sensor.scan
        self._timetable = Timetable(
            scan.period_ns, scan.sectors, scan.jitter_ms * NS_IN_MS, self._chance
        )
        self._asked: dict[int, AskedSensor] = {}
        """By the identity of the keys, which `settings` keeps."""

    def in_sector(self, scan: int, sector: int) -> AskedSensor | None:
        """The sensor as it was when a sector was worked out; None if that is not known."""
        of = self._timetable.sector(scan, sector)
        worked_out_ns = max(of.end_ns - AHEAD_NS, of.start_ns)
        keys = self._settings.worked_out(self._sensor, worked_out_ns, self._start_utc_ns)
        if keys is None:
            return None
        if id(keys) not in self._asked:
            self._asked[id(keys)] = AskedSensor(keys, self._site, self._chance, self._sea_level)
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
        return sum(self._is_at_work(number) for number in lacking[:MOST_LACKING])

    def _is_at_work(self, number: int) -> bool:
        asked = self.in_sector(*divmod(number, self.sectors))
        return asked is not None and asked.keys.enabled


MOST_LACKING = 100_000
"""In a row, that are looked at one by one."""


def asked_of(
    scene: Scene, settings: RecordedSettings, start_utc_ns: int
) -> Mapping[str, AskedByTime]:
    """All sensors of a recorded scene, by id."""
    return {s.id: AskedByTime(scene, s, settings, start_utc_ns) for s in scene.sensor}
