"""Telemetry reports from bytes in a few microseconds, where they are as reports nearly always are.

Whatever is not, or might be refused, gives None: `decode_reports.decode` has the last word on it,
and the words of refusals. What is given here is what that gives, to the last bit.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import lru_cache
from math import inf, isfinite, nan
from typing import Any, NamedTuple

from plotfeed.feeds.telemetry.decode_reports import (
    EMITTER_FIELDS,
    JSON_SPACE,
    MAX_OCTETS,
    REFERENCE_FROM_PB,
    Kind,
    kind_of_media,
)
from plotfeed.feeds.telemetry.position_report import (
    LATEST_UTC_NS,
    LIMITS,
    MAX_SPEED_M_S,
    PositionReport,
    is_class,
)
from plotfeed.models.state import AltitudeReference, Emitter
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.decode_129 import CATEGORY
from plotfeed.proto.utc import NS


class ReportRow(NamedTuple):
    """A `PositionReport` with NaN for all that is not stated; of both accuracies the worse."""

    t_utc_ns: int
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    altitude_reference: AltitudeReference
    velocity_east_m_s: float
    velocity_north_m_s: float
    velocity_up_m_s: float
    sigma_m: float
    rcs_m2: float
    sound_power_db: float
    size_m: float
    emitters: tuple[Emitter, ...]
    target_class: str

    @classmethod
    def of(cls, report: PositionReport) -> ReportRow:
        """The row of a report."""
        accuracies = (report.horizontal_accuracy_m, report.vertical_accuracy_m)
        return cls(
            report.t_utc_ns,
            report.latitude_deg,
            report.longitude_deg,
            report.altitude_m,
            report.altitude_reference,
            *(report.velocity_enu_m_s or (nan, nan, nan)),
            max((a for a in accuracies if a is not None), default=nan),
            nan if report.rcs_m2 is None else report.rcs_m2,
            nan if report.sound_power_db is None else report.sound_power_db,
            nan if report.size_m is None else report.size_m,
            report.emitters,
            report.target_class,
        )


SURELY_TAKEN_M2_S2 = (0.99 * MAX_SPEED_M_S) ** 2
"""Squares of speeds that are above are looked at more exactly."""
SOUTH_DEG, NORTH_DEG = LIMITS["latitude_deg"]
WEST_DEG, EAST_DEG = LIMITS["longitude_deg"]
LOWEST_M, HIGHEST_M = LIMITS["altitude_m"]
ASTERIX_129 = bytes([CATEGORY])


def fast_decode(payload: bytes, content_type: str | None) -> ReportRow | None:
    """The report in a payload; None for what is refused, or takes a closer look."""
    if len(payload) > MAX_OCTETS:
        return None
    try:
        kind = kind_of_media(content_type) if content_type else None
        if kind is None:
            if payload.lstrip(JSON_SPACE)[:1] == b"{":
                kind = Kind.JSON
            elif payload[:1] != ASTERIX_129:
                kind = Kind.PROTOBUF
        if kind is Kind.PROTOBUF:
            return _of_protobuf(payload)
        return _of_json(payload) if kind is Kind.JSON else None
    except Exception:  # noqa: BLE001 - whatever it is, `decode` finds the words for it
        return None


def _of_protobuf(payload: bytes) -> ReportRow | None:
    message = pb.Telemetry.FromString(payload)
    has = message.HasField
    latitude, longitude = message.latitude_deg, message.longitude_deg
    altitude = message.altitude_m
    # A field that is absent reads as zero, which is rare enough to be asked about.
    if not (latitude and longitude and altitude) and not (
        has("latitude_deg") and has("longitude_deg") and has("altitude_m")
    ):
        return None
    east, north = message.velocity_east_m_s, message.velocity_north_m_s
    up = message.velocity_up_m_s
    horizontal, vertical = message.horizontal_accuracy_m, message.vertical_accuracy_m
    rcs_m2, sound_power_db, size_m = message.rcs_m2, message.sound_power_db, message.size_m
    if not (
        0.0 <= horizontal < inf
        and 0.0 <= vertical < inf
        and 0.0 <= message.velocity_accuracy_m_s < inf
        and 0.0 <= rcs_m2 < inf
        and 0.0 <= size_m < inf
        and -inf < sound_power_db < inf
        and east * east + north * north + up * up < SURELY_TAKEN_M2_S2
    ):
        return None
    if not rcs_m2 or not size_m:
        if (not rcs_m2 and has("rcs_m2")) or (not size_m and has("size_m")):
            return None
        rcs_m2, size_m = rcs_m2 or nan, size_m or nan
    target_class = message.target_class
    if target_class and not is_class(target_class):
        return None
    sigma_m = max(horizontal, vertical)
    if not sigma_m and not has("horizontal_accuracy_m") and not has("vertical_accuracy_m"):
        sigma_m = nan
    time_utc, emitters = message.time_utc, message.emitters
    nanos = time_utc.nanos
    if not 0 <= nanos < NS:
        return None
    return _row(
        time_utc.seconds * NS + nanos,
        latitude,
        longitude,
        altitude,
        REFERENCE_FROM_PB[message.altitude_reference],
        east if east or has("velocity_east_m_s") else nan,
        north if north or has("velocity_north_m_s") else nan,
        up if up or has("velocity_up_m_s") else nan,
        sigma_m,
        rcs_m2,
        sound_power_db if sound_power_db or has("sound_power_db") else nan,
        size_m,
        tuple([_emitter(*[getattr(e, n) for n in EMITTER_FIELDS]) for e in emitters])
        if emitters
        else (),
        target_class,
    )


def _fields(message: Any) -> dict[str, tuple[str, type]]:
    """Names and types of a message's fields, by either spelling that JSON may have."""
    others: dict[str, type] = {"time_utc": str, "altitude_reference": str, "emitters": list}
    others |= {"kind": str, "identity": str, "target_class": str}
    return {
        spelling: (field.name, others.get(field.name, float))
        for field in message.DESCRIPTOR.fields
        for spelling in (field.name, field.json_name)
    }


REPORT_FIELDS, FIELDS_OF_EMITTERS = _fields(pb.Telemetry), _fields(pb.Emitter)
NOT_NEGATIVE = {"horizontal_accuracy_m", "vertical_accuracy_m", "velocity_accuracy_m_s"}
REFERENCES = {
    pb.AltitudeReference.Name(number): found for number, found in REFERENCE_FROM_PB.items()
}
SPACE = JSON_SPACE.decode()
SECONDS = re.compile(r"\d{4}-\d\d-\d\dT([01]\d|2[0-3]):\d\d:\d\d", re.ASCII)


def _no_constant(text: str) -> float:
    raise ValueError(text)


_OBJECTS_AS_PAIRS = json.JSONDecoder(object_pairs_hook=list, parse_constant=_no_constant)


def _of_json(payload: bytes) -> ReportRow | None:
    text = payload.decode().strip(SPACE)
    pairs, end = _OBJECTS_AS_PAIRS.raw_decode(text)
    if end != len(text) or text[0] != "{":
        return None
    values = _values(pairs, REPORT_FIELDS)
    get = values.get
    latitude, longitude = values["latitude_deg"], values["longitude_deg"]
    altitude = values["altitude_m"]
    east, north = get("velocity_east_m_s", nan), get("velocity_north_m_s", nan)
    up = get("velocity_up_m_s", nan)
    horizontal, vertical = get("horizontal_accuracy_m", nan), get("vertical_accuracy_m", nan)
    rcs_m2, sound_power_db = get("rcs_m2", nan), get("sound_power_db", nan)
    size_m, target_class = get("size_m", nan), get("target_class", "")
    # What is stated is never NaN here; what is too large for a number is infinite.
    if (
        sum([v * v for v in (east, north, up) if v == v]) >= SURELY_TAKEN_M2_S2  # noqa: PLR0124
        or not all(0.0 <= values[name] < inf for name in values.keys() & NOT_NEGATIVE)
        or rcs_m2 <= 0.0
        or size_m <= 0.0
        or inf in (rcs_m2, size_m, abs(sound_power_db))
        or not is_class(target_class)
    ):
        return None
    return _row(
        _utc_ns(values["time_utc"]),
        latitude,
        longitude,
        altitude,
        REFERENCES[values["altitude_reference"]],
        east,
        north,
        up,
        vertical if vertical > horizontal or horizontal != horizontal else horizontal,  # noqa: PLR0124
        rcs_m2,
        sound_power_db,
        size_m,
        _emitters_of_pairs(values["emitters"]) if "emitters" in values else (),
        target_class,
    )


def _values(pairs: Any, fields: dict[str, tuple[str, type]]) -> dict[str, Any]:
    """Values by the names of fields, each of its type; raises `Exception` where in doubt."""
    values: dict[str, Any] = {}
    for spelling, value in pairs:
        name, kind = fields[spelling]
        if type(value) is kind:
            values[name] = value
        elif kind is float and type(value) is int:
            values[name] = float(value)
        else:
            raise ValueError(name)
    if len(values) < len(pairs):
        raise ValueError("a key occurs twice")
    return values


def _emitters_of_pairs(found: Sequence[Any]) -> tuple[Emitter, ...]:
    if not found:
        raise ValueError("an empty list, or an empty object")
    emitters = []
    for pairs in found:
        if type(pairs) is not list or not pairs or type(pairs[0]) is not tuple:
            raise ValueError("not an object")
        values = _values(pairs, FIELDS_OF_EMITTERS)
        for name in ("kind", "identity"):
            values.get(name, "").encode()
        emitters.append(
            _emitter(
                values.get("frequency_hz", 0.0),
                values.get("bandwidth_hz", 0.0),
                values.get("eirp_dbm", 0.0),
                values.get("kind", ""),
                values.get("identity", ""),
            )
        )
    return tuple(emitters)


def _emitter(
    frequency_hz: float, bandwidth_hz: float, eirp_dbm: float, kind: str, identity: str
) -> Emitter:
    if not (0.0 < frequency_hz < inf and 0.0 <= bandwidth_hz < inf and isfinite(eirp_dbm)):
        raise ValueError("out of range")
    return Emitter(
        frequency_hz=frequency_hz,
        bandwidth_hz=bandwidth_hz,
        eirp_dbm=eirp_dbm,
        kind=kind,
        identity=identity,
    )


def _utc_ns(text: str) -> int:
    """The time that a text of RFC 3339 says, in UTC; raises `Exception` where in doubt."""
    if text[-1] != "Z":
        raise ValueError("not in UTC")
    fraction = text[20:-1]
    nanos = 0
    if len(text) > 20:
        if (
            text[19] != "."
            or len(fraction) > 9
            or not (fraction.isascii() and fraction.isdecimal())
        ):
            raise ValueError("no fraction of a second")
        nanos = int(fraction) * 10 ** (9 - len(fraction))
    return _seconds(text[:19]) * NS + nanos


@lru_cache(maxsize=64)
def _seconds(text: str) -> int:
    if SECONDS.fullmatch(text) is None:
        raise ValueError("not to the second")
    return round(datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp())


def _row(
    t_utc_ns: int, latitude: float, longitude: float, altitude: float, *others: Any
) -> ReportRow | None:
    if (
        0 < t_utc_ns <= LATEST_UTC_NS
        and SOUTH_DEG <= latitude <= NORTH_DEG
        and WEST_DEG <= longitude <= EAST_DEG
        and LOWEST_M <= altitude <= HIGHEST_M
    ):
        return tuple.__new__(ReportRow, (t_utc_ns, latitude, longitude, altitude, *others))
    return None
