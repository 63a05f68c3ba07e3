"""What a sensor says of itself beside its reports: its place and cover, its keys, its status."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.engine.visibility import limits_of
from plotfeed.feeds.messages.message import Message, retained_message
from plotfeed.feeds.scene.fields import frame_at, geodetic
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry
from plotfeed.feeds.telemetry.receiver import to_json
from plotfeed.models.sensors.sensor_model import SensorModel
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import asterix_content_type
from plotfeed.proto.utc import iso_utc

if TYPE_CHECKING:
    from plotfeed.models.cueing import CuedState

RANGE_KINDS = {
    SensorGeometry.MONOSTATIC: pb.SensorDescription.SLANT,
    SensorGeometry.BISTATIC: pb.SensorDescription.BISTATIC,
    SensorGeometry.BEARINGS: pb.SensorDescription.NO_RANGE,
}
# Signal-to-noise ratios of detections for which errors are told.
ACCURACIES_AT_DB = (13.0, 20.0, 30.0)
DEGREE_DIGITS, METRE_DIGITS = 9, 4  # Digits after the point of places: 0.1 mm
MOUNT_DIGITS = 4  # Of where mounts point, degrees


def description_of(scene: Scene, sea_level: SeaLevel, sensor: Sensor) -> pb.SensorDescription:
    """What and where a sensor is, what it covers and how it reports; without a time."""
    site = scene.scene.site
    here = frame_at(site, sensor.position_enu_m)
    described = pb.SensorDescription(
        sensor=sensor.id,
        type=sensor.type,
        enabled=sensor.enabled,
        azimuth_reference=pb.SensorDescription.TRUE_NORTH,
        elevation_reference=pb.SensorDescription.HORIZONTAL_OF_SENSOR,
        range_kind=RANGE_KINDS[sensor.geometry],
        scan_kind=sensor.scan.kind,
        scan_period_s=sensor.scan.period_s,
        sectors=sensor.scan.sectors,
        range_max_m=sensor.range_max_m,
        accuracies=_accuracies(sensor.model(site)),
        outputs=outputs_of(scene.mqtt.prefix, sensor),
        **_place(sea_level, here.latitude_deg, here.longitude_deg, here.height_m),
    )
    for channel, transmitter in enumerate(sensor.illuminators):
        described.transmitters.add(
            id=transmitter.id,
            channel=channel,
            frequency_hz=transmitter.frequency_hz,
            **_place(sea_level, *geodetic(site, transmitter.place).tolist()),
        )
    for key, value in limits_of(sensor).items():
        if value is not None:
            setattr(described, key, value)
    if any(REPORT_FORMATS[name].categories for name in sensor.report):
        described.sac, described.sic = sensor.sac, sensor.sic
    return described


def _place(
    sea_level: SeaLevel, latitude_deg: float, longitude_deg: float, height_m: float
) -> dict[str, Any]:
    """Where something is, as descriptions say it."""
    above_sea_m = height_m - float(sea_level.undulation_m(latitude_deg, longitude_deg))
    return {
        "latitude_deg": round(latitude_deg, DEGREE_DIGITS),
        "longitude_deg": round(longitude_deg, DEGREE_DIGITS),
        "height_m": round(height_m, METRE_DIGITS),
        "altitude_m": round(above_sea_m, METRE_DIGITS),
    }


def status_of(description: pb.SensorDescription) -> pb.SensorStatus:
    """A status that says where the sensor is, and nothing yet of how it does."""
    return pb.SensorStatus(
        sensor=description.sensor,
        latitude_deg=description.latitude_deg,
        longitude_deg=description.longitude_deg,
        height_m=description.height_m,
    )


def status_message(prefix: str, status: pb.SensorStatus, now_utc_ns: int) -> Message:
    """A sensor's status, as of now, for whoever comes later."""
    status.time_utc.FromNanoseconds(now_utc_ns)
    source, sensor = f"{prefix}/{status.sensor}", status.sensor
    return retained_message(source, "status", to_json(status), now_utc_ns, sensor=sensor)


def description_message(prefix: str, description: pb.SensorDescription, now_utc_ns: int) -> Message:
    """What and where a sensor is and how it reports, for whoever comes later."""
    source, sensor = f"{prefix}/{description.sensor}", description.sensor
    return retained_message(source, "description", to_json(description), now_utc_ns, sensor=sensor)


def settings_message(
    prefix: str, sensor: Sensor, controlled: Mapping[str, Any], since_utc_ns: int, now_utc_ns: int
) -> Message:
    """What a sensor's keys are since a time, and which of them control has changed."""
    said = {
        "sensor": sensor.id,
        "time_utc": iso_utc(since_utc_ns),
        "controlled": controlled,
        "in_force": sensor.model_dump(mode="json", exclude_unset=True, exclude={"event"}),
    }
    payload, source = json.dumps(said).encode(), f"{prefix}/{sensor.id}"
    return retained_message(source, "settings", payload, now_utc_ns, sensor=sensor.id)


def mount_status(sensor: Sensor, state: CuedState) -> pb.MountStatus:
    """Where a sensor's mount points; of a camera, with its field of view."""
    at = state.pointing
    told = pb.MountStatus(
        pan_deg=round(at.pan_deg, MOUNT_DIGITS),
        tilt_deg=round(at.tilt_deg, MOUNT_DIGITS),
        settled=state.sees(at.t_utc_ns),
        cued_by=state.source,
    )
    told.time_utc.FromNanoseconds(at.t_utc_ns)
    if hasattr(sensor, "horizontal_fov_deg"):
        told.horizontal_fov_deg = round(at.field_deg, MOUNT_DIGITS)
    return told


def outputs_of(prefix: str, sensor: Sensor) -> Iterator[pb.SensorOutput]:
    """Every topic that it reports on, in the order of its formats."""
    root = f"{prefix}/{sensor.id}"
    for name in dict.fromkeys(sensor.report):
        facts = REPORT_FORMATS[name]
        if not facts.categories:
            topic = f"{root}/{facts.topic}"
            yield pb.SensorOutput(format=name, topic=topic, content_type=facts.content_type)
        for category in sensor.categories(name):
            yield pb.SensorOutput(
                format=name,
                topic=f"{root}/asterix/{category:03d}",
                content_type=asterix_content_type(category),
            )


def _accuracies(model: SensorModel) -> Iterator[pb.Accuracy]:
    """What plots state of their errors, at several signal-to-noise ratios."""
    for snr_db in ACCURACIES_AT_DB:
        stated = model.stated_sigmas(10 ** (snr_db / 10))
        if stated:
            yield pb.Accuracy(snr_db=snr_db, **stated)
