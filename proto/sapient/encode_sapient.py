"""Messages of SAPIENT (BSI Flex 335 v2.0) of a node: what it says of itself, and its detections."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from sapient_msg.bsi_flex_335_v2_0.detection_report_pb2 import DetectionReport
from sapient_msg.bsi_flex_335_v2_0.location_pb2 import (
    Location,
    LocationCoordinateSystem,
    LocationDatum,
)
from sapient_msg.bsi_flex_335_v2_0.range_bearing_pb2 import (
    RangeBearing,
    RangeBearingCoordinateSystem,
    RangeBearingDatum,
)

from plotfeed.models.state import Columns, Floats, Plots
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.sapient.envelope import (
    ICD_VERSION,
    MAX_IDS,
    Ulids,
    check_number,
    check_text,
    envelope,
    measured,
    serialised,
    set_stamp,
    stamp_ns,
)
from plotfeed.proto.units import with_rounding

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
    # What a detection may be called: the classes, or the sub-classes of `above`.
    classes: tuple[str, ...] = ()
    # The class of every detection, which goes before what the sensor itself calls it.
    above: str | None = None
    model: str
    software_version: str

    # What detections are, and no word of in a Registration: whether they have an azimuth,
    has_direction: bool = dataclasses.field(default=True, compare=False)
    # and what is said of each.
    detection_confidence: float | None = dataclasses.field(default=None, compare=False)
    class_confidence: float = dataclasses.field(default=1.0, compare=False)
    # Band of a receiver: each detection is a signal, somewhere in it.
    band_hz: tuple[float, float] | None = dataclasses.field(default=None, compare=False)
    # Transmitters of a bistatic radar, by channel.
    transmitters: tuple[str, ...] = dataclasses.field(default=(), compare=False)
    # Whether the time from measurement to timestamp is told.
    tells_age: bool = dataclasses.field(default=False, compare=False)


SIGNALS = (
    SapientQuantity(name="amplitude", units="dBm"),
    *(
        SapientQuantity(name=f"{part} frequency", units="Hz")
        for part in ("start", "centre", "stop")
    ),
)
# Of what a node tells, and where it looks: places on the Earth, or ranges and bearings.
_GEODETIC = {"location_units": LAT_LNG, "location_datum": ELLIPSOID}
_POLAR = {"range_bearing_units": DEG_M, "range_bearing_datum": TRUE_NORTH}


def registration(node: Node, t_utc_ns: int) -> bytes:
    """A serialised SapientMessage with a Registration; raises `EncodeError`."""
    check_text("name", node.sensor)
    check_text("model", node.model)
    if not node.capabilities:
        raise EncodeError("at least one is needed", field="capabilities")
    content = {
        "node_definition": [
            {"node_type": f"NODE_TYPE_{node.node_type}", "node_sub_type": [node.sub_type]}
        ],
        "icd_version": ICD_VERSION,
        "name": node.sensor,
        "short_name": node.sensor,
        "capabilities": [
            {"category": "sensor", "type": each.name, "value": each.value, "units": each.units}
            for each in node.capabilities
        ],
        "status_definition": {
            "status_interval": _seconds("status_interval", node.status_interval_s),
            "location_definition": _GEODETIC,
            "field_of_view_definition": _POLAR,
        },
        "mode_definition": [
            {
                "mode_name": MODE,
                "mode_type": "MODE_TYPE_PERMANENT",
                "settle_time": _seconds("settle_time", node.settle_s),
                "maximum_latency": _seconds("maximum_latency", node.latency_s),
                "scan_type": f"SCAN_TYPE_{'SCANNING' if node.scanning else 'FIXED'}",
                "tracking_type": "TRACKING_TYPE_NONE",
                "detection_definition": [_detections(node)],
                "task": _task(node),
            },
            {
                "mode_name": STANDBY,
                "mode_type": "MODE_TYPE_PERMANENT",
                "mode_description": "looks at nothing",
                "settle_time": _seconds("settle_time", 0.0),
                "task": _task(node),
            },
        ],
        "config_data": [
            {
                "manufacturer": "plotfeed",
                "model": node.model,
                "serial_number": node.sensor,
                "software_version": node.software_version,
            }
        ],
    }
    return serialised(node.node_id, t_utc_ns, registration=content)


def _detections(node: Node) -> dict[str, Any]:
    """What detections tell: where, how well, of what, and of which class."""
    told = {"OBJECT": node.objects, "SIGNAL": SIGNALS if node.band_hz else ()}
    classes: list[dict[str, Any]] = [
        {"type": name, "units": CONFIDENCE} for name in node.classes if node.above is None
    ]
    if node.above is not None:
        subs = [{"type": name, "units": CONFIDENCE, "level": 1} for name in node.classes]
        classes = [{"type": node.above, "units": CONFIDENCE, "sub_class": subs}]
    of_one = {"confidence_definition": "CONFIDENCE_DEFINITION_SINGLE_CLASS"}
    return {
        "location_type": _GEODETIC if node.tells_location else _POLAR,
        "detection_performance": [
            {"type": each.name, "units": each.units, "unit_value": each.value}
            for each in node.performance
        ],
        "detection_report": [
            {
                "category": f"DETECTION_REPORT_CATEGORY_{category}",
                "type": each.name,
                "units": each.units,
            }
            for category, quantities in told.items()
            for each in quantities
        ],
        "detection_class_definition": [of_one | {"class_definition": classes}] if classes else [],
        "geometric_error": {
            "type": "standard deviation",
            "units": "degrees and metres",
            "variation_type": "told with each detection",
        },
    }


def _task(node: Node) -> dict[str, Any]:
    """What may be asked of a node; each command is done when all of its cover was looked at."""
    commands: dict[str, Iterable[str]] = {"REQUEST": REQUESTS, "MODE_CHANGE": (MODE, STANDBY)}
    if node.has_threshold:
        commands["DETECTION_THRESHOLD"] = THRESHOLDS
    if node.steers:
        commands["LOOK_AT"] = ("degrees from true north", "latitude, longitude and height")
    return {
        "concurrent_tasks": 1,
        "region_definition": {
            "region_type": ["REGION_TYPE_AREA_OF_INTEREST"],
            "region_area": [_POLAR],
        },
        "command": [
            {
                "type": f"COMMAND_TYPE_{name}",
                "units": ", ".join(values),
                "completion_time": _seconds("completion_time", node.settle_s),
            }
            for name, values in commands.items()
        ],
    }


def _seconds(field: str, value_s: float) -> dict[str, Any]:
    check_number(field, value_s, 0, 1e9)
    return {"units": "TIME_UNITS_SECONDS", "value": value_s}


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
    field = node.field
    for name, value, low, high in (
        ("latitude", node.latitude_deg, -90, 90),
        ("longitude", node.longitude_deg, -180, 180),
        ("height", node.height_m, -20e3, 1e6),
        ("azimuth", field.azimuth_deg, 0, 360),
        ("horizontal_extent", field.horizontal_extent_deg, 0, 360),
        ("elevation", field.elevation_deg, -90, 90),
        ("vertical_extent", field.vertical_extent_deg, 0, 180),
        ("range", field.range_max_m, 0, 1e9),
    ):
        check_number(name, value, low, high)
    not_detecting = {
        "status_level": "STATUS_LEVEL_INFORMATION_STATUS",
        "status_type": "STATUS_TYPE_NOT_DETECTING",
        "status_value": "standby",
    }
    content = {
        "report_id": Ulids(node.seed, node.sensor, f"status {system} {new}", t_utc_ns)[0],
        "system": f"SYSTEM_{system}",
        "info": f"INFO_{'NEW' if new else 'UNCHANGED'}",
        "active_task_id": active_task_id or None,
        "mode": mode,
        "node_location": {
            "x": node.longitude_deg,
            "y": node.latitude_deg,
            "z": node.height_m,
            "coordinate_system": LAT_LNG,
            "datum": ELLIPSOID,
        },
        "field_of_view": {
            "range_bearing": {
                "azimuth": field.azimuth_deg,
                "horizontal_extent": field.horizontal_extent_deg,
                "elevation": field.elevation_deg,
                "vertical_extent": field.vertical_extent_deg,
                "range": field.range_max_m,
                "coordinate_system": DEG_M,
                "datum": TRUE_NORTH,
            }
        },
        "status": [not_detecting] if mode == STANDBY else [],
    }
    return serialised(node.node_id, t_utc_ns, status_report=content)


MAX_RANGE_M = 1e9
MAX_ERROR_DEG = 360.0
JUST_BELOW_360 = 359.99999999999994  # the last float64 before it


@dataclass(frozen=True, kw_only=True)
class Positions(Columns):
    """Where plots are on the Earth, with the errors of that; NaN for those without a place.

    A plot that has none is told as range and bearing, as far as it has these.
    """

    longitude_deg: Floats
    latitude_deg: Floats
    height_m: Floats
    sigma_longitude_deg: Floats
    sigma_latitude_deg: Floats
    sigma_height_m: Floats


class Locations:
    """The places of some plots, ready to be written one after the other."""

    def __init__(self, plots: Plots, positions: Positions | None) -> None:
        """Raises `EncodeError`."""
        self._polar = _checked(
            ("azimuth", plots.azimuth_deg, 0.0, JUST_BELOW_360),
            ("elevation", plots.elevation_deg, -90.0, 90.0),
            ("range", plots.range_m, 0.0, MAX_RANGE_M),
            ("azimuth_error", plots.sigma_azimuth_deg, 0.0, MAX_ERROR_DEG),
            ("elevation_error", plots.sigma_elevation_deg, 0.0, MAX_ERROR_DEG),
            ("range_error", plots.sigma_range_m, 0.0, MAX_RANGE_M),
        )
        self._geodetic = positions and _checked(
            ("x", positions.longitude_deg, -180.0, 180.0),
            ("y", positions.latitude_deg, -90.0, 90.0),
            ("z", positions.height_m, -MAX_RANGE_M, MAX_RANGE_M),
            ("x_error", positions.sigma_longitude_deg, 0.0, MAX_ERROR_DEG),
            ("y_error", positions.sigma_latitude_deg, 0.0, MAX_ERROR_DEG),
            ("z_error", positions.sigma_height_m, 0.0, MAX_RANGE_M),
        )

    def write(self, i: int, report: DetectionReport) -> None:
        """Give a report the place of plot i, whatever it had before."""
        if self._geodetic and self._geodetic[0][1][i] is not None:
            location = report.location
            location.coordinate_system, location.datum = LAT_LNG, ELLIPSOID
            _write(location, self._geodetic, i)
        else:
            bearing = report.range_bearing
            bearing.coordinate_system, bearing.datum = DEG_M, TRUE_NORTH
            _write(bearing, self._polar, i)


_Values = list[tuple[str, list[float | None]]]


def _checked(*columns: tuple[str, Floats, float, float]) -> _Values:
    return [(column[0], measured(*column)) for column in columns]


def _write(place: Location | RangeBearing, columns: _Values, i: int) -> None:
    for name, values in columns:
        value = values[i]
        if value is None:
            place.ClearField(name)
        else:
            setattr(place, name, value)


SNR, AGE, BISTATIC_RANGE, TRANSMITTER = "SNR", "age", "bistatic range", "transmitter"
# Types of object_info; as track_info a consumer would take the plot for a track.
RANGE_RATE, BISTATIC_RANGE_RATE = "range rate", "bistatic range rate"

MAX_SNR = 1e30
MAX_RATE_M_S = 1e9
# Of metres and metres a second in texts of object_info, whose errors hold this rounding.
RANGE_DECIMALS, RATE_DECIMALS = 2, 3


class DetectionEncoder:
    """Serialises the plots of a sensor. Numbers are checked, for the message classes check none."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._classes = frozenset(node.classes)
        self._message = envelope(node.node_id, 0)
        self._report = self._message.detection_report
        check_number("class confidence", node.class_confidence, 0, 1)
        if node.above is not None:
            check_text("class", node.above)
        if node.detection_confidence is not None:
            check_number("detection_confidence", node.detection_confidence, 0, 1)
            self._report.detection_confidence = node.detection_confidence
        if node.band_hz is not None:
            low_hz, high_hz = node.band_hz
            check_number("start_frequency", low_hz, 0, high_hz)
            check_number("stop_frequency", high_hz, low_hz, 1e15)
        self._kind: tuple[str, float] | None = None

    def messages(
        self,
        t_utc_ns: int,
        plots: Plots,
        positions: Positions | None = None,
        confidence: Floats | None = None,
    ) -> list[bytes]:
        """Serialised SapientMessages, one a plot, all stamped that time; raises `EncodeError`.

        `confidence` is that of each detection, where the node has none for all.
        """
        if not len(plots):
            return []
        confidences = None
        if confidence is not None:
            confidences = measured("detection_confidence", confidence, 0, 1)
        if 2 * len(plots) > MAX_IDS:
            raise EncodeError(f"{len(plots)} plots at one time", field="report_id")
        set_stamp(self._message, t_utc_ns)
        ids = Ulids(self._node.seed, self._node.sensor, "detections", stamp_ns(t_utc_ns))
        locations = Locations(plots, positions)
        infos = self._infos(t_utc_ns, plots)
        amplitudes_dbm: Sequence[float | None] = [None] * len(plots)
        if self._node.band_hz is not None:
            amplitudes_dbm = measured("amplitude", plots.amplitude_dbm, -1000, 1000)
        # Confidences that the sensor states, and the scene's for what it states none of.
        usual, probabilities = self._node.class_confidence, plots.kind_probability
        stated: Sequence[float | None] = [None] * len(plots)
        if probabilities is not None:
            stated = measured("class confidence", probabilities, 0, 1)
        report = self._report
        encoded = []
        for i, (kind, identity) in enumerate(zip(plots.kind, plots.identity, strict=True)):
            report.report_id = ids[2 * i]
            report.object_id = ids[2 * i + 1]
            if confidences is not None and (found := confidences[i]) is not None:
                report.detection_confidence = found
            locations.write(i, report)
            self._classify(kind, usual if (sure := stated[i]) is None else sure)
            self._fill_infos(infos, i)
            if identity:
                report.id = identity
            else:
                report.ClearField("id")
            self._fill_signal(amplitudes_dbm[i])
            encoded.append(self._message.SerializeToString())
        return encoded

    def _classify(self, kind: str, confidence: float) -> None:
        """The sensor's own class below the scene's, or either alone; only what is registered."""
        if kind not in self._classes:
            kind, confidence = "", self._node.class_confidence
        if (kind, confidence) == self._kind:
            return
        self._kind = kind, confidence
        del self._report.classification[:]
        above = self._node.above
        if not above and not kind:
            return
        sure = self._node.class_confidence if above else confidence
        found = self._report.classification.add(type=above or kind, confidence=sure)
        if above and kind:
            found.sub_class.add(type=kind, confidence=confidence, level=1)

    def _infos(self, t_utc_ns: int, plots: Plots) -> list[_Info]:
        """The columns of object_info that have anything in them."""
        snr = measured(SNR, plots.snr, 0, MAX_SNR)
        bistatic_m = measured(BISTATIC_RANGE, plots.bistatic_range_m, 0, MAX_RANGE_M)
        sigma_m = with_rounding(plots.sigma_bistatic_range_m, 10.0**-RANGE_DECIMALS)
        sigmas_m = measured("bistatic range error", sigma_m, 0, MAX_RANGE_M)
        infos = [
            _Info(SNR, [f"{10 * math.log10(ratio):.2f}" if ratio else "" for ratio in snr]),
            _Info(BISTATIC_RANGE, _texts(bistatic_m, RANGE_DECIMALS), sigmas_m),
        ]
        if plots.range_rate_m_s is not None:
            rates_m_s = measured(RANGE_RATE, plots.range_rate_m_s, -MAX_RATE_M_S, MAX_RATE_M_S)
            texts = _texts(rates_m_s, RATE_DECIMALS)
            errors = None
            if plots.sigma_range_rate_m_s is not None:
                sigma_m_s = with_rounding(plots.sigma_range_rate_m_s, 10.0**-RATE_DECIMALS)
                errors = measured("range rate error", sigma_m_s, 0, MAX_RATE_M_S)
            rate = BISTATIC_RANGE_RATE if self._node.transmitters else RANGE_RATE
            infos.append(_Info(rate, texts, errors))
        if self._node.transmitters:
            names = [self._node.transmitters[channel] for channel in plots.channel.tolist()]
            infos.append(_Info(TRANSMITTER, names))
        if self._node.tells_age:
            stamp = stamp_ns(t_utc_ns)
            ages_s = [max(stamp - t_ns, 0) / 1e9 for t_ns in plots.t_utc_ns.tolist()]
            infos.append(_Info(AGE, [f"{age_s:.6f}" for age_s in ages_s]))
        return [info for info in infos if any(info.texts)]

    def _fill_infos(self, infos: list[_Info], i: int) -> None:
        told = self._report.object_info
        present = [info for info in infos if info.texts[i]]
        if len(told) != len(present):
            del told[:]
            for _ in present:
                told.add()
        for entry, info in zip(told, present, strict=True):
            entry.type, entry.value = info.type, info.texts[i]
            error = None if info.errors is None else info.errors[i]
            if error is None:
                entry.ClearField("error")
            else:
                entry.error = error

    def _fill_signal(self, amplitude_dbm: float | None) -> None:
        """Amplitude and frequency, which is known as well as the band is narrow."""
        if self._node.band_hz is None:
            return
        del self._report.signal[:]
        if amplitude_dbm is None:
            return
        low_hz, high_hz = self._node.band_hz
        self._report.signal.add(
            amplitude=amplitude_dbm,
            start_frequency=low_hz,
            centre_frequency=(low_hz + high_hz) / 2,
            stop_frequency=high_hz,
        )


def _texts(values: list[float | None], decimals: int) -> list[str]:
    return ["" if value is None else f"{value:.{decimals}f}" for value in values]


@dataclass(frozen=True, slots=True)
class _Info:
    """A type of object_info: its text for each plot, "" where there is none."""

    type: str
    texts: list[str]
    errors: list[float | None] | None = None
