"""A sensor as a node of SAPIENT: what it is, what it looks at, and when it may report."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.mount_keys import mount_of
from plotfeed.models.beam import Sector
from plotfeed.models.confidence import Confidence, TargetPrior, confidence_of
from plotfeed.models.frames import aer_to_enu, wrap_360
from plotfeed.models.sensors.sensor_model import JointSensor, Targets
from plotfeed.models.state import Emitter, Signature
from plotfeed.proto.errors import DecodeError, EncodeError
from plotfeed.proto.sapient.decode_sapient import restamped_later
from plotfeed.proto.sapient.encode_sapient import (
    AGE,
    BISTATIC_RANGE,
    BISTATIC_RANGE_RATE,
    RANGE_RATE,
    SNR,
    TRANSMITTER,
    FieldOfView,
    Manner,
    Node,
    SapientQuantity,
)
from plotfeed.proto.sapient.envelope import node_id
from plotfeed.proto.utc import NS

CONTENT_TYPE = REPORT_FORMATS["sapient"].content_type
# A stamp may be a group of sectors older, up to 94 ms, and the last way takes some time too.
MAX_LATE_NS = 800_000_000
MIN_GAP_NS = 80_000_000
ROUNDING_NS = 2000  # By which rounding to nanoseconds and microseconds may shorten a gap

SIGNALS = (
    SapientQuantity(name="amplitude", units="dBm"),
    *(
        SapientQuantity(name=f"{part} frequency", units="Hz")
        for part in ("start", "centre", "stop")
    ),
)


class Groups:
    """Runs of as many sectors as take 80 ms, counted from 1970.

    So a sector's group does not depend on when the session began, or on what was missed.
    """

    def __init__(self, period_ns: int, sectors: int) -> None:
        self._sectors = sectors
        self.size = -(-MIN_GAP_NS * sectors // period_ns)
        whole = self.size * period_ns % (1000 * sectors) == 0
        if not whole and self.size * period_ns < (MIN_GAP_NS + ROUNDING_NS) * sectors:
            self.size += 1
        self.longest_ns = -(-self.size * period_ns // sectors)

    def number(self, sector: Sector) -> int:
        """The group that a sector is in."""
        return self._count(sector) // self.size

    def ends_with(self, sector: Sector) -> bool:
        """Whether a sector is the last of its group."""
        return (self._count(sector) + 1) % self.size == 0

    def _count(self, sector: Sector) -> int:
        return sector.scan * self._sectors + sector.index


@dataclass(frozen=True, slots=True)
class Measures:
    """What the plots of a sensor hold."""

    snr: bool
    azimuth: bool
    place: bool  # In three dimensions
    range_rate: bool


def groups_of(sensor: Sensor) -> Groups:
    """Which of its sectors are reported together."""
    return Groups(sensor.scan.period_ns, sensor.scan.sectors)


def manner_of(scene: Scene, sensor: Sensor) -> Manner:
    """How a sensor's detections are told."""
    settings = scene.sapient
    return Manner(
        detection_confidence=settings.detection_confidence,
        default_class=settings.default_class,
        class_confidence=settings.default_class_confidence,
        band_hz=sensor.band_hz,
        transmitters=tuple(t.id for t in sensor.illuminators),
        tells_age=sensor.scan.rotates or groups_of(sensor).size > 1,
    )


def node_of(scene: Scene, sensor: Sensor) -> Node:
    """The node that a sensor registers as."""
    site, manner, measures = scene.scene.site, manner_of(scene, sensor), measures_of(scene, sensor)
    frame = frame_at(site, sensor.position_enu_m)
    rate_per_s = sensor.believed.model(site).false_alarms_per_scan / sensor.scan.period_s
    return Node(
        seed=scene.scene.seed,
        sensor=sensor.id,
        node_id=node_id(scene.scene.seed, sensor.id),
        node_type=sensor.sapient_type,
        sub_type=sensor.type.replace("_", " "),
        latitude_deg=frame.latitude_deg,
        longitude_deg=frame.longitude_deg,
        height_m=frame.height_m,
        field=_field(sensor),
        scanning=sensor.scan.rotates,
        settle_s=sensor.scan.period_s,
        latency_s=groups_of(sensor).longest_ns / NS,
        status_interval_s=scene.sapient.status_interval_s,
        tells_location=tells_location(scene, measures),
        steers=mount_of(sensor) is not None,
        has_threshold=sensor.false_alarm_probability is not None,
        capabilities=(
            SapientQuantity(name="range", units="m", value=f"{sensor.range_max_m:g}"),
            SapientQuantity(name="scan period", units="s", value=f"{sensor.scan.period_s:g}"),
        ),
        performance=(SapientQuantity(name="FAR", units="per second", value=f"{rate_per_s:.6g}"),),
        objects=_objects(manner, measures),
        signals=SIGNALS if manner.band_hz else (),
        classes=_classes(scene, sensor),
        above=manner.default_class,
        model=sensor.preset or sensor.type,
        software_version=version("plotfeed"),
    )


def tells_location(scene: Scene, measures: Measures) -> bool:
    """Whether detections are places on the Earth, rather than range and bearing.

    Of a detector that finds no direction it is its own place: to a consumer, a missing azimuth may
    be north.
    """
    return not measures.azimuth or (measures.place and scene.sapient.location == "location")


def measures_of(scene: Scene, sensor: Sensor) -> Measures:
    """What plots hold, by what the model predicts of a target amidst its cover."""
    field, band_hz = _field(sensor), sensor.band_hz or (0.0, 0.0)
    enu_m = aer_to_enu([field.azimuth_deg], [field.elevation_deg], [field.range_max_m / 2])
    emitter = Emitter(frequency_hz=sum(band_hz) / 2, eirp_dbm=20.0)
    target = Signature(rcs_m2=1.0, sound_power_db=100.0, size_m=1.0, emitters=(emitter,))
    predicted = sensor.model(scene.scene.site).predict(Targets.of_one(target, enu_m))
    azimuth, elevation, distance, snr = (
        bool(np.isfinite(column[0]))
        for column in (
            predicted.sigma_azimuth_deg,
            predicted.sigma_elevation_deg,
            predicted.sigma_range_m,
            predicted.snr,
        )
    )
    return Measures(
        snr=snr,
        azimuth=azimuth,
        place=azimuth and elevation and distance,
        range_rate=predicted.sigma_range_rate_m_s is not None,
    )


def detection_confidence_of(scene: Scene, sensor: Sensor) -> Confidence | None:
    """How probable it is that detections are of drones.

    None where the scene says that itself, and of a sensor whose plots may be ghosts.
    """
    if scene.sapient.detection_confidence is not None:
        return None
    if isinstance(sensor.model(scene.scene.site), JointSensor):
        return None
    keys, field = scene.sapient.prior, _field(sensor)
    emitters: tuple[Emitter, ...] = ()
    if sensor.band_hz is not None:
        emitters = (Emitter(frequency_hz=sum(sensor.band_hz) / 2, eirp_dbm=keys.eirp_dbm),)
    signature = Signature(
        rcs_m2=keys.rcs_m2,
        sound_power_db=keys.sound_power_db,
        emitters=emitters,
        size_m=keys.size_m,
    )
    prior = TargetPrior(mean_number=keys.expected_drones, signature=signature)
    half_deg = field.horizontal_extent_deg / 2
    azimuths_deg = (field.azimuth_deg - half_deg, field.azimuth_deg + half_deg)
    return confidence_of(
        sensor.believed.model(scene.scene.site),
        prior,
        azimuths_deg,
        np.random.Generator(np.random.Philox(0)),
    )


def _field(sensor: Sensor) -> FieldOfView:
    """The cover; all directions where the sensor has no limits."""
    azimuths, elevations = (
        [getattr(sensor, f"{angle}_{end}_deg", d) for end, d in (("min", -most), ("max", most))]
        for angle, most in (("azimuth", 180), ("elevation", 90))
    )
    return FieldOfView(
        azimuth_deg=float(wrap_360(sum(azimuths) / 2)),
        horizontal_extent_deg=float(azimuths[1] - azimuths[0]),
        elevation_deg=sum(elevations) / 2,
        vertical_extent_deg=float(elevations[1] - elevations[0]),
        range_max_m=sensor.range_max_m,
    )


def _objects(manner: Manner, measures: Measures) -> tuple[SapientQuantity, ...]:
    rate = BISTATIC_RANGE_RATE if manner.transmitters else RANGE_RATE
    told = {
        SapientQuantity(name=SNR, units="dB"): measures.snr,
        SapientQuantity(name=BISTATIC_RANGE, units="m"): bool(manner.transmitters),
        SapientQuantity(name=rate, units="m/s"): measures.range_rate,
        SapientQuantity(name=TRANSMITTER, units="name"): bool(manner.transmitters),
        SapientQuantity(name=AGE, units="s"): manner.tells_age,
    }
    return tuple(quantity for quantity, is_told in told.items() if is_told)


def _classes(scene: Scene, sensor: Sensor) -> tuple[str, ...]:
    """What the sensor itself may call its detections, of what the scene's drones are and emit.

    Telemetry may bring other emissions, which a node that has not registered them cannot name.
    """
    drones = scene.fleet.kinds
    kinds = (emitter.kind for drone in drones for emitter in drone.emitters)
    models = (drone.model for drone in drones)
    named = [*(kinds if sensor.tells_kinds else ()), *(models if sensor.tells_models else ())]
    return tuple(dict.fromkeys([*sensor.classes, *filter(None, named)]))


def as_it_may_leave(message: Message, t_utc_ns: int, rule: str) -> bytes | None:
    """The payload of a message that leaves at that time, or None if it is dropped."""
    late_ns = t_utc_ns - message.due_utc_ns
    if late_ns <= MAX_LATE_NS or rule == "send":
        return message.payload
    if rule == "drop":
        return None
    with contextlib.suppress(DecodeError, EncodeError):  # of a message that the link has corrupted
        return restamped_later(message.payload, late_ns)
    return message.payload
