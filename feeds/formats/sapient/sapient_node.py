"""A sensor as a node of SAPIENT: what it is, when it may report, and its DetectionReports."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from importlib.metadata import version

import numpy as np

from plotfeed.feeds.formats import SectorFormat, address_of
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message, numbered
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.mount_keys import mount_of
from plotfeed.models.beam import Sector
from plotfeed.models.confidence import Confidence, TargetPrior, confidence_of
from plotfeed.models.frames import WGS84_A_M, aer_to_enu, wrap_360
from plotfeed.models.sensors.sensor_model import JointSensor, Targets
from plotfeed.models.state import Emitter, Floats, Plots, Signature
from plotfeed.proto.errors import DecodeError, EncodeError
from plotfeed.proto.sapient.decode_sapient import restamped_later
from plotfeed.proto.sapient.encode_sapient import (
    AGE,
    BISTATIC_RANGE,
    BISTATIC_RANGE_RATE,
    MAX_ERROR_DEG,
    MAX_RANGE_M,
    RANGE_RATE,
    SNR,
    TRANSMITTER,
    DetectionEncoder,
    FieldOfView,
    Node,
    Positions,
    SapientQuantity,
)
from plotfeed.proto.sapient.envelope import node_id
from plotfeed.proto.utc import NS

CONTENT_TYPE = REPORT_FORMATS["sapient"].content_type
# A stamp may be a group of sectors older, up to 94 ms, and the last way takes some time too.
MAX_LATE_NS = 800_000_000
MIN_GAP_NS = 80_000_000
MAX_SIGMA_DEG = 180.0
ROUNDING_NS = 2000  # By which rounding to nanoseconds and microseconds may shorten a gap


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


def groups_of(sensor: Sensor) -> Groups:
    """Which of its sectors are reported together."""
    return Groups(sensor.scan.period_ns, sensor.scan.sectors)


def node_of(scene: Scene, sensor: Sensor) -> Node:
    """The node that a sensor registers as."""
    site, settings, looks = scene.scene.site, scene.sapient, _field(sensor)
    frame, groups = frame_at(site, sensor.position_enu_m), groups_of(sensor)
    rate_per_s = sensor.believed.model(site).false_alarms_per_scan / sensor.scan.period_s
    # What plots hold, by what the model predicts of a target amidst its cover.
    enu_m = aer_to_enu([looks.azimuth_deg], [looks.elevation_deg], [looks.range_max_m / 2])
    emitter = Emitter(frequency_hz=sum(sensor.band_hz or (0.0, 0.0)) / 2, eirp_dbm=20.0)
    target = Signature(rcs_m2=1.0, sound_power_db=100.0, size_m=1.0, emitters=(emitter,))
    plot = sensor.model(site).predict(Targets.of_one(target, enu_m))
    has_snr, has_azimuth, has_elevation, has_range = (
        bool(np.isfinite(column[0]))
        for column in (plot.snr, plot.sigma_azimuth_deg, plot.sigma_elevation_deg,
                       plot.sigma_range_m)
    )  # fmt: skip
    has_place = has_azimuth and has_elevation and has_range
    tells_age, is_bistatic = sensor.scan.rotates or groups.size > 1, bool(sensor.illuminators)
    told = {
        SapientQuantity(name=SNR, units="dB"): has_snr,
        SapientQuantity(name=BISTATIC_RANGE, units="m"): is_bistatic,
        SapientQuantity(name=BISTATIC_RANGE_RATE if is_bistatic else RANGE_RATE, units="m/s"): (
            plot.sigma_range_rate_m_s is not None
        ),
        SapientQuantity(name=TRANSMITTER, units="name"): is_bistatic,
        SapientQuantity(name=AGE, units="s"): tells_age,
    }
    return Node(
        seed=scene.scene.seed,
        sensor=sensor.id,
        node_id=node_id(scene.scene.seed, sensor.id),
        node_type=sensor.sapient_type,
        sub_type=sensor.type.replace("_", " "),
        latitude_deg=frame.latitude_deg,
        longitude_deg=frame.longitude_deg,
        height_m=frame.height_m,
        field=looks,
        scanning=sensor.scan.rotates,
        settle_s=sensor.scan.period_s,
        latency_s=groups.longest_ns / NS,
        status_interval_s=settings.status_interval_s,
        # Without directions it tells its own place: a missing azimuth may be taken for north.
        tells_location=(has_place and settings.location == "location") or not has_azimuth,
        has_direction=has_azimuth,
        steers=mount_of(sensor) is not None,
        has_threshold=sensor.false_alarm_probability is not None,
        capabilities=(
            SapientQuantity(name="range", units="m", value=f"{sensor.range_max_m:g}"),
            SapientQuantity(name="scan period", units="s", value=f"{sensor.scan.period_s:g}"),
        ),
        performance=(SapientQuantity(name="FAR", units="per second", value=f"{rate_per_s:.6g}"),),
        objects=tuple(quantity for quantity, is_told in told.items() if is_told),
        classes=_classes(scene, sensor),
        above=settings.default_class,
        model=sensor.preset or sensor.type,
        software_version=version("plotfeed"),
        detection_confidence=settings.detection_confidence,
        class_confidence=settings.default_class_confidence,
        band_hz=sensor.band_hz,
        transmitters=tuple(each.id for each in sensor.illuminators),
        tells_age=tells_age,
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


def _sigmas_enu_m(plots: Plots) -> tuple[Floats, Floats, Floats]:
    """Errors along east, north and up, to first order in those of range and angles.

    Up is the sensor's: at 20 km the target's own is 0.2 degrees away.
    """
    azimuth, elevation = np.radians(plots.azimuth_deg), np.radians(plots.elevation_deg)
    along_m = plots.sigma_range_m
    across_m = plots.range_m * np.cos(elevation) * np.radians(plots.sigma_azimuth_deg)
    upwards_m = plots.range_m * np.radians(plots.sigma_elevation_deg)
    level_m = np.hypot(along_m * np.cos(elevation), upwards_m * np.sin(elevation))
    return (
        np.hypot(level_m * np.sin(azimuth), across_m * np.cos(azimuth)),
        np.hypot(level_m * np.cos(azimuth), across_m * np.sin(azimuth)),
        np.hypot(along_m * np.sin(elevation), upwards_m * np.cos(elevation)),
    )


def _degrees(metres: Floats, latitude_deg: Floats | None = None) -> Floats:
    """Metres along a meridian, or along a parallel, as degrees; an error needs no ellipsoid."""
    share = 1.0 if latitude_deg is None else np.cos(np.radians(latitude_deg))
    with np.errstate(divide="ignore"):
        degrees = np.degrees(metres / (WGS84_A_M * share))
    return np.minimum(degrees, MAX_SIGMA_DEG)


class SapientReports(SectorFormat):
    """One message a plot, all of a group of sectors stamped with the end of the last.

    The standard has no time of measurement, and a middleware may refuse detections whose stamps are
    less than 80 ms apart: where sectors are shorter, plots wait for the end of their group.
    """

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._address = address_of(scene, sensor, "sapient", CONTENT_TYPE)
        self._groups = groups_of(sensor)
        node = node_of(scene, sensor)
        self._encoder = DetectionEncoder(node)
        self._confidence = detection_confidence_of(scene, sensor)
        self._frame = frame_at(scene.scene.site, sensor.position_enu_m)
        self._range_max_m = sensor.range_max_m
        self._on_earth = node.tells_location
        self._has_direction = node.has_direction
        self._group = -1
        self._waiting: list[Plots] = []

    def messages_of(self, batch: Batch) -> list[Message]:
        """The messages of a group of sectors, if this one ends it."""
        sector = batch.sector
        group = self._groups.number(sector)
        if group != self._group:  # of one that was not finished, the time is past
            self._group, self._waiting = group, []
        self._waiting.append(batch.plots)
        if not self._groups.ends_with(sector):
            return []
        together, self._waiting = Plots.joined(self._waiting), []
        together = replace(  # an error without bound, as of azimuth straight above, is left unsaid
            together,
            sigma_range_m=_bounded(together.sigma_range_m, MAX_RANGE_M),
            sigma_azimuth_deg=_bounded(together.sigma_azimuth_deg, MAX_ERROR_DEG),
            sigma_elevation_deg=_bounded(together.sigma_elevation_deg, MAX_ERROR_DEG),
        )
        payloads = self._encoder.messages(
            sector.end_ns,
            together,
            self._positions(together),
            None if self._confidence is None else self._confidence.of(together.snr),
        )
        return numbered(self._address, payloads, batch.stamp)

    def _positions(self, plots: Plots) -> Positions | None:
        """Where plots are on the Earth; of those without a direction the sensor's own place.

        Give or take its range then: a disc of even probability has a standard deviation of half its
        radius along each axis. None where range and bearing are told instead.
        """
        if not self._on_earth:
            return None
        if self._has_direction:
            enu_m = aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
            latitude_deg, longitude_deg, height_m = self._frame.to_geodetic(enu_m)
            east_m, north_m, up_m = _sigmas_enu_m(plots)
        else:
            latitude_deg = np.full(len(plots), self._frame.latitude_deg)
            longitude_deg = np.full(len(plots), self._frame.longitude_deg)
            east_m = north_m = np.full(len(plots), self._range_max_m / 2)
            height_m = up_m = np.full(len(plots), np.nan)
        return Positions(
            longitude_deg=longitude_deg,
            latitude_deg=latitude_deg,
            height_m=height_m,
            sigma_longitude_deg=_degrees(east_m, latitude_deg),
            sigma_latitude_deg=_degrees(north_m),
            sigma_height_m=up_m,
        )


def _bounded(sigma: Floats, most: float) -> Floats:
    return np.where(sigma <= most, sigma, np.nan)
