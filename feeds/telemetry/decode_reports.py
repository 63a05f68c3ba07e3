"""Telemetry reports from bytes and to bytes, protobuf or JSON, and from ASTERIX 129.

Pure: no sockets, no clock. Bytes give a report or raise `Refused`, whatever they are.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from datetime import datetime
from enum import Enum
from functools import lru_cache
from math import inf, isfinite, nan
from operator import attrgetter, itemgetter
from typing import Any

from google.protobuf import json_format
from google.protobuf.message import DecodeError as ProtobufDecodeError

from plotfeed.feeds.telemetry.position_report import (
    LATEST_UTC_NS,
    LIMITS,
    MAX_SPEED_M_S,
    NUMBERS,
    POSITION,
    REFERENCES,
    VELOCITY,
    PositionReport,
    Reason,
    Refused,
    check,
    check_finite,
    emitters_in,
    is_class,
)
from plotfeed.models.state import AltitudeReference, Emitter
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.decode_cooperative import CATEGORY, UasReport, is_block_129, read_129
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import NS, nearest_utc_ns

MAX_OCTETS = 4096
# Radius that holds half of a circular normal distribution, in standard deviations.
HALF_OF_POSITIONS = math.sqrt(2 * math.log(2))
Kind = Enum("Kind", ["PROTOBUF", "JSON", "ASTERIX"])  # How a report is written
# Of media types; what ends in +json or +protobuf is likewise.
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
_TIME = re.compile(r"(\d{4}-\d\d-\d\dT(?:[01]\d|2[0-3]):\d\d:\d\d)(?:\.(\d{1,9}))?Z", re.ASCII)
SOUTH_DEG, NORTH_DEG = LIMITS["latitude_deg"]
WEST_DEG, EAST_DEG = LIMITS["longitude_deg"]
LOWEST_M, HIGHEST_M = LIMITS["altitude_m"]
_NUMBERS_OF, _NUMBERS_IN = attrgetter(*NUMBERS), itemgetter(*NUMBERS)
JSON_SPACE = " \t\r\n"


def decode(
    payload: bytes, content_type: str | None = None, *, now_utc_ns: int | None = None
) -> PositionReport:
    """The report in a payload, of the kind that its content type says; raises `Refused`.

    Without a content type, which MQTT 3.1.1 cannot carry, an opening brace tells JSON, and the
    category and length of a single data block ASTERIX 129. That one needs `now_utc_ns`.
    """
    if len(payload) > MAX_OCTETS:
        detail = f"payload of {len(payload)} octets; at most {MAX_OCTETS} are taken"
        raise Refused(Reason.OVERSIZED, detail)
    if (kind := _kind(payload, content_type)) is Kind.ASTERIX:
        report = _from_129(payload, now_utc_ns)
    else:
        read = _from_json if kind is Kind.JSON else _from_protobuf
        report = PositionReport.of(read(payload))
    check(report)
    return report


def fast_decode(payload: bytes, content_type: str | None) -> PositionReport | None:
    """The report in a payload in a few microseconds, where it is as it nearly always is.

    None for what is refused, or takes a closer look: `decode` has the last word on it, and the
    words of refusals. What is given here is what that gives, to the last bit.
    """
    try:
        kind = _kind(payload, content_type)
        if kind is Kind.ASTERIX or len(payload) > MAX_OCTETS:
            return None
        if kind is Kind.JSON:
            return _report_of_json(payload)
        said = pb.Telemetry.FromString(payload)
        time_utc, reference, name = said.time_utc, said.altitude_reference, said.target_class
        t_utc_ns = time_utc.seconds * NS + nanos if 0 <= (nanos := time_utc.nanos) < NS else 0
        emitters = emitters_in(said) if said.emitters else ()
        return _report(t_utc_ns, _NUMBERS_OF(said), reference, emitters, name, has=said.HasField)
    except Exception:  # noqa: BLE001 - whatever it is, `decode` finds the words for it
        return None


def _report(
    t_utc_ns: int,
    numbers: tuple[float, ...],
    reference: int | str,
    emitters: tuple[Emitter, ...],
    target_class: str,
    *,
    has: Callable[[Any], bool],
) -> PositionReport | None:
    """The report of what is said, zeros where it `has` not said it; None where in doubt."""
    latitude, longitude, altitude, east, north, up = numbers[:6]
    horizontal, vertical, velocity_accuracy, rcs_m2, sound_power_db, size_m = numbers[6:]
    if not (
        0 < t_utc_ns <= LATEST_UTC_NS
        and SOUTH_DEG <= latitude <= NORTH_DEG
        and WEST_DEG <= longitude <= EAST_DEG
        and LOWEST_M <= altitude <= HIGHEST_M
        and math.hypot(east, north, up) <= MAX_SPEED_M_S
        and isfinite(horizontal + vertical + velocity_accuracy + rcs_m2 + sound_power_db + size_m)
        and horizontal >= 0.0 <= vertical
        and velocity_accuracy >= 0.0
        # A field that is absent reads as zero, which is rare enough to be asked about.
        and ((latitude and longitude and altitude) or all(map(has, POSITION)))
        and (rcs_m2 > 0.0 or not (rcs_m2 or has("rcs_m2")))
        and (size_m > 0.0 or not (size_m or has("size_m")))
        and (not target_class or is_class(target_class))
    ):
        return None
    for e in emitters:
        if not (0 < e.frequency_hz < inf and 0 <= e.bandwidth_hz < inf and isfinite(e.eirp_dbm)):
            return None
    velocity = numbers[3:6]
    if not (east and north and up):
        stated = zip(VELOCITY, velocity, strict=True)
        velocity = tuple([v if v or has(name) else nan for name, v in stated])
    if not (horizontal or has("horizontal_accuracy_m")):
        horizontal = nan
    if not (vertical or has("vertical_accuracy_m")):
        vertical = nan
    if not (velocity_accuracy or has("velocity_accuracy_m_s")):
        velocity_accuracy = nan
    if not (sound_power_db or has("sound_power_db")):
        sound_power_db = nan
    place = (t_utc_ns, latitude, longitude, altitude, REFERENCES[reference], velocity)
    sigmas = (horizontal, vertical, velocity_accuracy)
    looks = (rcs_m2 or nan, sound_power_db, size_m or nan, emitters, target_class)
    return tuple.__new__(PositionReport, (*place, *sigmas, *looks))


def _kinds(message: Any) -> dict[str, tuple[str, type]]:
    """Name and type, as JSON has it, of each of a message's fields, by either of its spellings."""
    return {
        spelling: (f.name, type(f.default_value) if type(f.default_value) in (float, list) else str)
        for f in message.DESCRIPTOR.fields
        for spelling in (f.name, f.json_name)
    }


def _values(pairs: Any, kinds: dict[str, tuple[str, type]]) -> dict[str, Any]:
    """Values by the names of fields, each of its type; raises `Exception` where in doubt."""
    values: dict[str, Any] = {}
    for spelling, value in pairs:
        name, kind = kinds[spelling]
        if type(value) is kind:
            values[name] = value
        elif kind is float and type(value) is int:
            values[name] = float(value)
        else:
            raise ValueError(name)
    if len(values) < len(pairs) or type(pairs) is not tuple:
        raise ValueError("a key occurs twice, or no object")
    return values


_REPORT, _EMITTER = _kinds(pb.Telemetry), _kinds(pb.Emitter)
_NO_REPORT = {name: kind() for name, kind in _REPORT.values()}
_NO_EMITTER = {name: kind() for name, kind in _EMITTER.values()}


def _report_of_json(payload: bytes) -> PositionReport | None:
    text = payload.decode().strip(JSON_SPACE)
    pairs, end = _PAIRS.raw_decode(text)
    values = _values(pairs, _REPORT)
    said = _NO_REPORT | values
    emitters = tuple([Emitter(**_NO_EMITTER | _values(e, _EMITTER)) for e in said["emitters"]])
    for emitter in emitters:
        (emitter.kind + emitter.identity).encode()
    if end < len(text) or (match := _TIME.fullmatch(said["time_utc"])) is None:
        return None
    seconds, fraction = match.groups("")
    t_utc_ns = _seconds(seconds) * NS + int(fraction.ljust(9, "0"))
    reference, name = said["altitude_reference"], said["target_class"]
    return _report(t_utc_ns, _NUMBERS_IN(said), reference, emitters, name, has=values.__contains__)


@lru_cache(maxsize=64)
def _seconds(text: str) -> int:
    return round(datetime.fromisoformat(text + "Z").timestamp())


def encode_protobuf(report: PositionReport) -> bytes:
    """The report as a serialised `plotfeed.v1.Telemetry`."""
    return report.message().SerializeToString(deterministic=True)


def encode_json(report: PositionReport) -> bytes:
    """The report in protobuf's JSON mapping, with the field names of the schema; UTF-8."""
    return json_format.MessageToJson(
        report.message(), preserving_proto_field_name=True, indent=None
    ).encode()


def _kind(payload: bytes, content_type: str | None) -> Kind:
    kind = kind_of_media(content_type or "")
    if kind is not None:
        return kind
    if payload.lstrip(JSON_SPACE.encode()).startswith(b"{"):
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
    return check_finite("a number", float(text))


_PAIRS = json.JSONDecoder(object_pairs_hook=tuple, parse_constant=_finite)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) < len(pairs):
        raise ValueError("a key occurs twice")
    if bool in map(type, fields.values()):
        raise ValueError("true or false where no field takes it")
    return fields


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
    return PositionReport(
        t_utc_ns=nearest_utc_ns(round(uas.t_of_day_s * NS), now_utc_ns),
        latitude_deg=uas.latitude_deg,
        longitude_deg=uas.longitude_deg,
        altitude_m=_altitude_m(uas),
        altitude_reference=AltitudeReference.MEAN_SEA_LEVEL,
        velocity_enu_m_s=(uas.velocity_east_m_s, uas.velocity_north_m_s, uas.climb_m_s),
        horizontal_accuracy_m=uas.accuracy_m / HALF_OF_POSITIONS,
    )


def _altitude_m(uas: UasReport) -> float:
    """What I129/090 says; a height above ground is none, where nobody knows the ground."""
    if not math.isnan(uas.altitude_m):
        return uas.altitude_m
    if math.isnan(uas.height_m):
        raise Refused(Reason.MISSING, "I129/090, the altitude above mean sea level, is missing")
    detail = "I129/100 is a height above ground; expected I129/090, above mean sea level"
    raise Refused(Reason.ALTITUDE, detail)
