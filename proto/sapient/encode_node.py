"""What a node says of itself: Registration when it comes, StatusReport as long as it is there."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from sapient_msg.bsi_flex_335_v2_0.location_pb2 import (
    Location,
    LocationCoordinateSystem,
    LocationDatum,
)
from sapient_msg.bsi_flex_335_v2_0.range_bearing_pb2 import (
    LocationOrRangeBearing,
    RangeBearingCone,
    RangeBearingCoordinateSystem,
    RangeBearingDatum,
)
from sapient_msg.bsi_flex_335_v2_0.registration_pb2 import Registration
from sapient_msg.bsi_flex_335_v2_0.status_report_pb2 import StatusReport

from plotfeed.proto.errors import EncodeError
from plotfeed.proto.sapient.envelope import ICD_VERSION, Ulids, check_number, check_text, envelope

DEG_M = RangeBearingCoordinateSystem.RANGE_BEARING_COORDINATE_SYSTEM_DEGREES_M
TRUE_NORTH = RangeBearingDatum.RANGE_BEARING_DATUM_TRUE
LAT_LNG = LocationCoordinateSystem.LOCATION_COORDINATE_SYSTEM_LAT_LNG_DEG_M
ELLIPSOID = LocationDatum.LOCATION_DATUM_WGS84_E
CONFIDENCE = "probability"  # Units of what is said of classes
MODE, STANDBY = "default", "standby"  # In the second one a node looks at nothing
# What a node can be asked for, and what that is; two words are for one thing.
REQUESTS = {
    "Registration": "registration",
    "Status": "status",
    "Heartbeat": "status",
    "Start": "start",
    "Stop": "stop",
    "Reset": "reset",
}
THRESHOLDS = ("Low", "Medium", "High")

# Node types of the standard that sense drones from afar.
NodeType = Literal["RADAR", "ACOUSTIC", "PASSIVE_RF", "CAMERA", "OTHER"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldOfView:
    """Where a sensor looks: a cone of the extents, which are whole angles, about its middle."""

    azimuth_deg: float
    horizontal_extent_deg: float
    elevation_deg: float
    vertical_extent_deg: float
    range_max_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SapientQuantity:
    """Something stated in a Registration; `value` where it is a constant of the sensor."""

    name: str
    units: str
    value: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """A sensor as SAPIENT knows it."""

    seed: int
    sensor: str
    node_id: str
    node_type: NodeType
    sub_type: str
    latitude_deg: float
    longitude_deg: float
    height_m: float  # Height above the ellipsoid
    field: FieldOfView
    scanning: bool
    settle_s: float  # Time until everything within cover has been looked at once
    latency_s: float  # Longest time from a measurement to the timestamp of its report
    status_interval_s: float
    tells_location: bool
    has_threshold: bool  # Whether it can be made more or less sensitive
    steers: bool  # Whether it can be told where to look
    capabilities: tuple[SapientQuantity, ...] = ()
    performance: tuple[SapientQuantity, ...] = ()
    objects: tuple[SapientQuantity, ...] = ()  # What `object_info` may hold
    signals: tuple[SapientQuantity, ...] = ()
    # What a detection may be called: the classes, or the sub-classes of `above`.
    classes: tuple[str, ...] = ()
    # The class of every detection, which goes before what the sensor itself calls it.
    above: str | None = None
    model: str
    software_version: str


def registration(node: Node, t_utc_ns: int) -> bytes:
    """A serialised SapientMessage with a Registration; raises `EncodeError`."""
    check_text("name", node.sensor)
    check_text("model", node.model)
    if not node.capabilities:
        raise EncodeError("at least one is needed", field="capabilities")
    message = envelope(node.node_id, t_utc_ns)
    message.registration.CopyFrom(
        Registration(
            node_definition=[
                Registration.NodeDefinition(
                    node_type=f"NODE_TYPE_{node.node_type}",
                    node_sub_type=[node.sub_type],
                )
            ],
            icd_version=ICD_VERSION,
            name=node.sensor,
            short_name=node.sensor,
            capabilities=[
                Registration.Capability(
                    category="sensor", type=each.name, value=each.value, units=each.units
                )
                for each in node.capabilities
            ],
            status_definition=Registration.StatusDefinition(
                status_interval=_seconds("status_interval", node.status_interval_s),
                location_definition=_geodetic(),
                field_of_view_definition=_polar(),
            ),
            mode_definition=[_mode(node), _standby(node)],
            config_data=[
                Registration.ConfigurationData(
                    manufacturer="plotfeed",
                    model=node.model,
                    serial_number=node.sensor,
                    software_version=node.software_version,
                )
            ],
        )
    )
    return message.SerializeToString()


def status(
    node: Node,
    t_utc_ns: int,
    *,
    system: Literal["OK", "GOODBYE"] = "OK",
    new: bool = False,
    mode: str = MODE,
    active_task_id: str = "",
) -> bytes:
    """A serialised SapientMessage with a StatusReport; raises `EncodeError`."""
    check_number("latitude", node.latitude_deg, -90, 90)
    check_number("longitude", node.longitude_deg, -180, 180)
    check_number("height", node.height_m, -20e3, 1e6)
    message = envelope(node.node_id, t_utc_ns)
    message.status_report.CopyFrom(
        StatusReport(
            report_id=Ulids(node.seed, node.sensor, f"status {system} {new}", t_utc_ns)[0],
            system=f"SYSTEM_{system}",
            info=StatusReport.Info.INFO_NEW if new else StatusReport.Info.INFO_UNCHANGED,
            active_task_id=active_task_id or None,
            mode=mode,
            node_location=Location(
                x=node.longitude_deg,
                y=node.latitude_deg,
                z=node.height_m,
                coordinate_system=LAT_LNG,
                datum=ELLIPSOID,
            ),
            field_of_view=LocationOrRangeBearing(range_bearing=_cone(node.field)),
            status=[_NOT_DETECTING] if mode == STANDBY else [],
        )
    )
    return message.SerializeToString()


_NOT_DETECTING = StatusReport.Status(
    status_level=StatusReport.StatusLevel.STATUS_LEVEL_INFORMATION_STATUS,
    status_type=StatusReport.StatusType.STATUS_TYPE_NOT_DETECTING,
    status_value="standby",
)


def _mode(node: Node) -> Registration.ModeDefinition:
    scan = Registration.ScanType
    location = _geodetic() if node.tells_location else _polar()
    return Registration.ModeDefinition(
        mode_name=MODE,
        mode_type=Registration.ModeType.MODE_TYPE_PERMANENT,
        settle_time=_seconds("settle_time", node.settle_s),
        maximum_latency=_seconds("maximum_latency", node.latency_s),
        scan_type=scan.SCAN_TYPE_SCANNING if node.scanning else scan.SCAN_TYPE_FIXED,
        tracking_type=Registration.TrackingType.TRACKING_TYPE_NONE,
        detection_definition=[
            Registration.DetectionDefinition(
                location_type=location,
                detection_performance=[
                    Registration.PerformanceValue(
                        type=each.name, units=each.units, unit_value=each.value
                    )
                    for each in node.performance
                ],
                detection_report=[
                    *_reported("OBJECT", node.objects),
                    *_reported("SIGNAL", node.signals),
                ],
                detection_class_definition=_class_definitions(node),
                geometric_error=Registration.GeometricError(
                    type="standard deviation",
                    units="degrees and metres",
                    variation_type="told with each detection",
                ),
            )
        ],
        task=_task(node),
    )


def _standby(node: Node) -> Registration.ModeDefinition:
    return Registration.ModeDefinition(
        mode_name=STANDBY,
        mode_type=Registration.ModeType.MODE_TYPE_PERMANENT,
        mode_description="looks at nothing",
        settle_time=_seconds("settle_time", 0.0),
        task=_task(node),
    )


def _task(node: Node) -> Registration.TaskDefinition:
    """What may be asked of a node; each command is done when all of its cover was looked at."""
    commands: dict[str, Iterable[str]] = {"REQUEST": REQUESTS, "MODE_CHANGE": (MODE, STANDBY)}
    if node.has_threshold:
        commands["DETECTION_THRESHOLD"] = THRESHOLDS
    if node.steers:
        commands["LOOK_AT"] = ("degrees from true north", "latitude, longitude and height")
    return Registration.TaskDefinition(
        concurrent_tasks=1,
        region_definition=Registration.RegionDefinition(
            region_type=[Registration.RegionType.REGION_TYPE_AREA_OF_INTEREST],
            region_area=[_polar()],
        ),
        command=[
            Registration.Command(
                type=f"COMMAND_TYPE_{name}",
                units=", ".join(values),
                completion_time=_seconds("completion_time", node.settle_s),
            )
            for name, values in commands.items()
        ],
    )


def _reported(
    category: Literal["OBJECT", "SIGNAL"], quantities: tuple[SapientQuantity, ...]
) -> list[Registration.DetectionReport]:
    return [
        Registration.DetectionReport(
            category=f"DETECTION_REPORT_CATEGORY_{category}", type=each.name, units=each.units
        )
        for each in quantities
    ]


def _class_definitions(node: Node) -> list[Registration.DetectionClassDefinition]:
    kind = Registration.ClassDefinition
    if node.above is not None:
        subs = [Registration.SubClass(type=n, units=CONFIDENCE, level=1) for n in node.classes]
        classes = [kind(type=node.above, units=CONFIDENCE, sub_class=subs)]
    else:
        classes = [kind(type=name, units=CONFIDENCE) for name in node.classes]
    if not classes:
        return []
    single = Registration.ConfidenceDefinition.CONFIDENCE_DEFINITION_SINGLE_CLASS
    return [
        Registration.DetectionClassDefinition(
            confidence_definition=single, class_definition=classes
        )
    ]


def _geodetic() -> Registration.LocationType:
    return Registration.LocationType(location_units=LAT_LNG, location_datum=ELLIPSOID)


def _polar() -> Registration.LocationType:
    return Registration.LocationType(range_bearing_units=DEG_M, range_bearing_datum=TRUE_NORTH)


def _seconds(field: str, value_s: float) -> Registration.Duration:
    check_number(field, value_s, 0, 1e9)
    return Registration.Duration(units=Registration.TimeUnits.TIME_UNITS_SECONDS, value=value_s)


def _cone(field: FieldOfView) -> RangeBearingCone:
    check_number("azimuth", field.azimuth_deg, 0, 360)
    check_number("horizontal_extent", field.horizontal_extent_deg, 0, 360)
    check_number("elevation", field.elevation_deg, -90, 90)
    check_number("vertical_extent", field.vertical_extent_deg, 0, 180)
    check_number("range", field.range_max_m, 0, 1e9)
    return RangeBearingCone(
        azimuth=field.azimuth_deg,
        horizontal_extent=field.horizontal_extent_deg,
        elevation=field.elevation_deg,
        vertical_extent=field.vertical_extent_deg,
        range=field.range_max_m,
        coordinate_system=DEG_M,
        datum=TRUE_NORTH,
    )
