"""Telemetry reports from bytes and to bytes, protobuf or JSON, and from ASTERIX 129.

Pure: no sockets, no clock. Bytes give a `PositionReport` or raise `Refused`, whatever they are.
"""

from __future__ import annotations

import json
import math
from enum import Enum, auto
from functools import lru_cache
from typing import Any

from google.protobuf import json_format
from google.protobuf.message import DecodeError as ProtobufDecodeError

from plotfeed.feeds.telemetry.position_report import (
    PositionReport,
    Reason,
    Refused,
    check,
    check_finite,
)
from plotfeed.models.state import AltitudeReference, Emitter
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.decode_129 import CATEGORY, UasReport, is_block_129, read_129
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import NS, nearest_utc_ns

MAX_OCTETS = 4096
HALF_OF_POSITIONS = math.sqrt(2 * math.log(2))
"""Radius that holds half of a circular normal distribution, in standard deviations."""
VELOCITY_FIELDS = ("velocity_east_m_s", "velocity_north_m_s", "velocity_up_m_s")
OPTIONAL_FIELDS = (
    "horizontal_accuracy_m",
    "vertical_accuracy_m",
    "velocity_accuracy_m_s",
    "rcs_m2",
    "sound_power_db",
    "size_m",
)
EMITTER_FIELDS = ("frequency_hz", "bandwidth_hz", "eirp_dbm", "kind", "identity")


class Kind(Enum):
    """How a report is written."""

    PROTOBUF = auto()
    JSON = auto()
    ASTERIX = auto()


_KINDS = {
    "application/x-protobuf": Kind.PROTOBUF,
    "application/protobuf": Kind.PROTOBUF,
    "application/vnd.google.protobuf": Kind.PROTOBUF,
    "application/x-google-protobuf": Kind.PROTOBUF,
    "application/octet-stream": Kind.PROTOBUF,
    "application/json": Kind.JSON,
    "text/json": Kind.JSON,
    "application/x-asterix": Kind.ASTERIX,
    "application/asterix": Kind.ASTERIX,
}
"""Of media types; what ends in +json or +protobuf is likewise."""
JSON_SPACE = b" \t\r\n"
_REFERENCE_TO_PB = {
    AltitudeReference.ELLIPSOID: pb.ELLIPSOID,
    AltitudeReference.MEAN_SEA_LEVEL: pb.MEAN_SEA_LEVEL,
    AltitudeReference.ABOVE_TAKEOFF: pb.ABOVE_TAKEOFF,
}
REFERENCE_FROM_PB = {number: reference for reference, number in _REFERENCE_TO_PB.items()}


def decode(
    payload: bytes,
    content_type: str | None = None,
    *,
    max_octets: int = MAX_OCTETS,
    now_utc_ns: int | None = None,
) -> PositionReport:
    """The report in a payload, of the kind that its content type says; raises `Refused`.

    Without a content type, which MQTT 3.1.1 cannot carry, an opening brace tells JSON, and the
    category and length of a single data block ASTERIX 129. That one needs `now_utc_ns`.
    """
    if len(payload) > max_octets:
        detail = f"payload of {len(payload)} octets; at most {max_octets} are taken"
        raise Refused(Reason.OVERSIZED, detail)
    match _kind(payload, content_type):
        case Kind.ASTERIX:
            report = _from_129(payload, now_utc_ns)
        case Kind.JSON:
            report = _report(_from_json(payload))
        case Kind.PROTOBUF:
            report = _report(_from_protobuf(payload))
    check(report)
    return report


def encode_protobuf(report: PositionReport) -> bytes:
    """The report as a serialised `plotfeed.v1.Telemetry`."""
    return _message(report).SerializeToString(deterministic=True)


def encode_json(report: PositionReport) -> bytes:
    """The report in protobuf's JSON mapping, with the field names of the schema; UTF-8."""
    text = json_format.MessageToJson(
        _message(report), preserving_proto_field_name=True, indent=None
    )
    return text.encode()


def _kind(payload: bytes, content_type: str | None) -> Kind:
    kind = kind_of_media(content_type or "")
    if kind is not None:
        return kind
    if payload.lstrip(JSON_SPACE).startswith(b"{"):
        return Kind.JSON
    return Kind.ASTERIX if is_block_129(payload) else Kind.PROTOBUF


@lru_cache(maxsize=256)
def kind_of_media(content_type: str) -> Kind | None:
    """What a content type says; None if it says nothing. Raises `Refused`."""
    media_type, _, parameters = content_type.lower().partition(";")
    media_type = media_type.strip()
    if not media_type:
        return None
    kind = _KINDS.get(media_type)
    if media_type.endswith(("+json", "+protobuf")):
        kind = Kind.JSON if media_type.endswith("+json") else Kind.PROTOBUF
    if kind is None:
        detail = (
            f"content type {media_type!r}; expected application/x-protobuf, application/json or "
            f"application/x-asterix; cat={CATEGORY}"
        )
        raise Refused(Reason.CONTENT_TYPE, detail)
    if kind is Kind.ASTERIX and parameters.replace(" ", "") not in ("", f"cat={CATEGORY}"):
        raise Refused(Reason.CONTENT_TYPE, f"ASTERIX of {parameters!r}; expected cat={CATEGORY}")
    return kind


def _from_protobuf(payload: bytes) -> pb.Telemetry:
    try:
        return pb.Telemetry.FromString(payload)
    except (ProtobufDecodeError, ValueError) as error:
        detail = "payload is not a protobuf message plotfeed.v1.Telemetry"
        raise Refused(Reason.UNDECODABLE, detail) from error


def _from_json(payload: bytes) -> pb.Telemetry:
    try:
        fields = json.loads(
            payload.decode(), parse_float=_finite, parse_constant=_finite, object_pairs_hook=_unique
        )
    except (ValueError, RecursionError) as error:
        raise Refused(Reason.UNDECODABLE, f"payload is not JSON: {error}") from error
    if not isinstance(fields, dict):
        raise Refused(Reason.UNDECODABLE, "payload is JSON but not an object")
    try:
        return json_format.ParseDict(fields, pb.Telemetry())
    except Exception as error:  # ParseError mostly, but OverflowError and others slip through
        detail = f"payload is not a Telemetry object: {str(error).partition('Available')[0]}"
        raise Refused(Reason.UNDECODABLE, detail) from error


def _finite(text: str) -> float:
    value = float(text)
    check_finite("a number", value)
    return value


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) < len(pairs):
        raise ValueError("a key occurs twice")
    if any(isinstance(value, bool) for value in fields.values()):
        raise ValueError("true or false where no field takes it")
    return fields


def _report(message: pb.Telemetry) -> PositionReport:
    reference = REFERENCE_FROM_PB.get(message.altitude_reference)
    if reference is None:
        expected = ", ".join(r.name for r in AltitudeReference)
        raise Refused(Reason.MISSING, f"altitude_reference is missing; expected one of {expected}")
    return PositionReport(
        t_utc_ns=_time_ns(message),
        latitude_deg=_required(message, "latitude_deg"),
        longitude_deg=_required(message, "longitude_deg"),
        altitude_m=_required(message, "altitude_m"),
        altitude_reference=reference,
        velocity_enu_m_s=_velocity(message),
        **{name: _optional(message, name) for name in OPTIONAL_FIELDS},
        emitters=tuple(
            Emitter(**{name: getattr(e, name) for name in EMITTER_FIELDS}) for e in message.emitters
        ),
        target_class=message.target_class,
    )


def _time_ns(message: pb.Telemetry) -> int:
    if not message.HasField("time_utc"):
        raise Refused(Reason.MISSING, "time_utc is missing")
    seconds, nanos = message.time_utc.seconds, message.time_utc.nanos
    if not 0 <= nanos < NS:
        detail = f"time_utc.nanos is {nanos}; expected 0 to {NS - 1}"
        raise Refused(Reason.OUT_OF_RANGE, detail)
    return seconds * NS + nanos


def _optional(message: pb.Telemetry, name: Any) -> float | None:
    if not message.HasField(name):
        return None
    value: float = getattr(message, name)
    # Here and not in `check`, because NaN in a report's velocity stands for "not known".
    check_finite(name, value)
    return value


def _required(message: pb.Telemetry, name: str) -> float:
    value = _optional(message, name)
    if value is None:
        raise Refused(Reason.MISSING, f"{name} is missing")
    return value


def _velocity(message: pb.Telemetry) -> tuple[float, float, float] | None:
    values = [_optional(message, name) for name in VELOCITY_FIELDS]
    if all(v is None for v in values):
        return None
    east, north, up = (math.nan if v is None else v for v in values)
    return east, north, up


def _message(report: PositionReport) -> pb.Telemetry:
    message = pb.Telemetry(
        latitude_deg=report.latitude_deg,
        longitude_deg=report.longitude_deg,
        altitude_m=report.altitude_m,
        altitude_reference=_REFERENCE_TO_PB[report.altitude_reference],
        target_class=report.target_class,
    )
    message.time_utc.seconds, message.time_utc.nanos = divmod(report.t_utc_ns, NS)
    for name in OPTIONAL_FIELDS:
        if (value := getattr(report, name)) is not None:
            setattr(message, name, value)
    for name, value in zip(VELOCITY_FIELDS, report.velocity_enu_m_s or (), strict=False):
        if not math.isnan(value):
            setattr(message, name, value)
    for e in report.emitters:
        message.emitters.add(**{name: getattr(e, name) for name in EMITTER_FIELDS})
    return message


def _from_129(payload: bytes, now_utc_ns: int | None) -> PositionReport:
    """The latest report in data blocks of one aircraft; raises `Refused`.

    Its day is the one that brings it nearest to now.
    """
    if now_utc_ns is None:
        detail = "ASTERIX tells a time of day, and nobody said what day it is"
        raise Refused(Reason.MISSING, detail)
    try:
        found = read_129(payload)
    except DecodeError as error:
        detail = f"payload is not ASTERIX category 129: {error}"
        raise Refused(Reason.UNDECODABLE, detail) from error
    if not found:
        raise Refused(Reason.UNDECODABLE, "payload holds no report of ASTERIX category 129")
    aircraft = {report.identity for report in found}
    if len(aircraft) > 1:
        detail = f"reports of {len(aircraft)} aircraft in one message; expected those of one"
        raise Refused(Reason.NAME, detail)
    return max((_report_of(one, now_utc_ns) for one in found), key=lambda report: report.t_utc_ns)


def _report_of(uas: UasReport, now_utc_ns: int) -> PositionReport:
    velocity = (uas.velocity_east_m_s, uas.velocity_north_m_s, uas.climb_m_s)
    accuracy_m = uas.accuracy_m / HALF_OF_POSITIONS
    return PositionReport(
        t_utc_ns=nearest_utc_ns(round(uas.t_of_day_s * NS), now_utc_ns),
        latitude_deg=uas.latitude_deg,
        longitude_deg=uas.longitude_deg,
        altitude_m=_altitude_m(uas),
        altitude_reference=AltitudeReference.MEAN_SEA_LEVEL,
        velocity_enu_m_s=None if all(map(math.isnan, velocity)) else velocity,
        horizontal_accuracy_m=None if math.isnan(accuracy_m) else accuracy_m,
    )


def _altitude_m(uas: UasReport) -> float:
    """What I129/090 says; a height above ground is none, where nobody knows the ground."""
    if not math.isnan(uas.altitude_m):
        return uas.altitude_m
    if math.isnan(uas.height_m):
        raise Refused(Reason.MISSING, "I129/090, the altitude above mean sea level, is missing")
    detail = "I129/100 is a height above ground; expected I129/090, above mean sea level"
    raise Refused(Reason.ALTITUDE, detail)
