"""What a recorded scene asked of its sensors by time, and what they take themselves to be."""

from __future__ import annotations

import json
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from typing import Any, Self

import numpy as np

from plotfeed.feeds.engine.emulated_sensors import AHEAD_NS
from plotfeed.feeds.lab import oracle
from plotfeed.feeds.scene.changes import changed, in_force, instants_ns
from plotfeed.feeds.scene.fields import Site, frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.feeds.scene.sensors import Sensor, sensor_of
from plotfeed.feeds.scene.sensors.effect_keys import readings_of
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry
from plotfeed.models.beam import Timetable
from plotfeed.models.chance import Chance
from plotfeed.models.effects.readings import Readings
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.sensors.sensor_model import JointSensor, SensorModel
from plotfeed.models.state import Floats, Ints
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS, NS_IN_MS
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import WHAT_LEFT

# Sensors whose plots state errors that follow from their own ratios, as the oracle has them.
RADARS = frozenset({"active_radar", "mimo_radar", "passive_radar"})
MAX_CHANGES = 10_000  # Of each sensor that are known; of later ones nothing is told


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


@dataclass(frozen=True)
class AskedSensor:
    """A sensor as it was to be while its keys stayed the same."""

    scene: Scene
    keys: Sensor
    # By which heights above mean sea level are told; None if its grid cannot be read here.
    sea_level: SeaLevel | None = None
    # Its keys as it stands and looks, where these are others than those by which it is judged.
    standing: Sensor | None = None

    @property
    def site(self) -> Site:
        """The site of its scene."""
        return self.scene.scene.site

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
        chance = Chance(self.scene.scene.seed, keys.id)
        return readings_of(keys.bias, keys.drift, chance, keys.scan.period_ns)

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
        try:
            self._sea_level: SeaLevel | None = scene.sea_level()
        except PlotfeedError:
            self._sea_level = None
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
        return sum(self._is_at_work(number) for number in lacking[:MOST_LACKING])

    def _is_at_work(self, number: int) -> bool:
        asked = self.in_sector(*divmod(number, self.sectors))
        return asked is not None and asked.keys.enabled


MOST_LACKING = 100_000  # In a row, that are looked at one by one
