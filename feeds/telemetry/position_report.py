"""What a drone says of itself at one time: its report, from bytes and to bytes, and its limits.

Reports come as protobuf or JSON, or in ASTERIX 129. Pure: no sockets, no clock. Bytes give a report
or raise `Refused`, whatever they are.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from enum import Enum, StrEnum
from functools import lru_cache
from math import inf, isfinite, nan
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np
from google.protobuf import json_format
from google.protobuf.message import DecodeError as ProtobufDecodeError
from numpy.typing import ArrayLike

from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.models.state import AltitudeReference, Emitter, Floats
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.decode_cooperative import CATEGORY, UasReport, is_block_129, read_129
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.utc import NS, nearest_utc_ns

MAX_SPEED_M_S = 1000.0
LATEST_UTC_NS = 2**63 - 1  # year 2262: the last that int64 holds
ABOVE_ZERO = math.ulp(0.0)
# Least and greatest value taken, both included; all are finite.
LIMITS = {
    "latitude_deg": (-90.0, 90.0),
    "longitude_deg": (-180.0, 180.0),
    "altitude_m": (-1000.0, 100_000.0),
    "horizontal_accuracy_m": (0.0, math.inf),
    "vertical_accuracy_m": (0.0, math.inf),
    "velocity_accuracy_m_s": (0.0, math.inf),
    "rcs_m2": (ABOVE_ZERO, math.inf),
    "sound_power_db": (-math.inf, math.inf),
    "size_m": (ABOVE_ZERO, math.inf),
}
# As `LIMITS`, of what a drone emits.
EMITTER_LIMITS = {
    "frequency_hz": (ABOVE_ZERO, math.inf),
    "bandwidth_hz": (0.0, math.inf),
    "eirp_dbm": (-math.inf, math.inf),
}
POSITION, OTHERS = tuple(LIMITS)[:3], tuple(LIMITS)[3:]
VELOCITY = ("velocity_east_m_s", "velocity_north_m_s", "velocity_up_m_s")
# Names that the numbers of a report have in `plotfeed.v1.Telemetry`.
NUMBERS = (*POSITION, *VELOCITY, *OTHERS)
EMITTER_FIELDS = (*EMITTER_LIMITS, "kind", "identity")
# By name and by number in `plotfeed.v1`.
REFERENCES: dict[int | str, AltitudeReference] = {
    key: reference
    for reference in AltitudeReference
    for key in (reference.name, pb.AltitudeReference.Value(reference.name))
}
CLASS_NAMES = "1 to 64 printable characters without space, /, + and #"

MAX_DETAIL = 300  # Characters of a refusal's text: it quotes what others sent


class Reason(StrEnum):
    """Why a report was refused: a few words, for counting."""

    OVERSIZED = "oversized"
    UNDECODABLE = "undecodable"
    CONTENT_TYPE = "content_type"
    MISSING = "missing"
    NOT_FINITE = "not_finite"
    OUT_OF_RANGE = "out_of_range"
    ALTITUDE = "altitude"
    BACKWARDS = "backwards"
    DUPLICATE = "duplicate"
    FUTURE = "future"
    STALE = "stale"
    LATE = "late"
    IMPLAUSIBLE_MOTION = "implausible_motion"
    SECOND_SOURCE = "second_source"
    TOO_MANY_DRONES = "too_many_drones"
    TOO_MANY_NEW_DRONES = "too_many_new_drones"
    NO_POSITION = "no_position"
    NAME = "name"
    FLOOD = "flood"
    CONTROL = "control"


class Refused(PlotfeedError):  # noqa: N818 - what happened to a report, not what broke
    """A report that was not taken. `detail` is one line: what was wrong and what was expected.

    `is_told` says that it was told of another report already, and need only be counted. It may
    stand for a `count` of reports, as of a flood.
    """

    def __init__(
        self, reason: Reason, detail: str, *, is_told: bool = False, count: int = 1
    ) -> None:
        self.reason, self.is_told, self.count = reason, is_told, count
        line = " ".join(detail.split())
        self.detail = line if len(line) <= MAX_DETAIL else line[: MAX_DETAIL - 1] + "…"
        super().__init__(self.detail)


Velocity = tuple[float, float, float]  # East, north and up, m/s; NaN where it is not known
UNKNOWN_VELOCITY: Velocity = (math.nan,) * 3


class PositionReport(NamedTuple):
    """One sample of a drone's state; of numbers that are not stated NaN.

    WGS-84 degrees; accuracies are one standard deviation.
    """

    t_utc_ns: int
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    altitude_reference: AltitudeReference
    velocity_enu_m_s: Velocity = UNKNOWN_VELOCITY
    horizontal_accuracy_m: float = math.nan
    vertical_accuracy_m: float = math.nan
    velocity_accuracy_m_s: float = math.nan
    rcs_m2: float = math.nan
    sound_power_db: float = math.nan
    size_m: float = math.nan
    emitters: tuple[Emitter, ...] = ()
    target_class: str = ""  # What it is to sensors that recognise it; empty where nobody says it

    @property
    def sigma_m(self) -> float:
        """The worse of both accuracies of the position; NaN where none is stated."""
        return float(np.fmax(self.horizontal_accuracy_m, self.vertical_accuracy_m))

    @classmethod
    def of(cls, message: pb.Telemetry) -> PositionReport:
        """The report in a message, not yet checked against limits; raises `Refused`."""
        reference = REFERENCES.get(message.altitude_reference)
        if reference is None:
            expected = ", ".join(r.name for r in AltitudeReference)
            detail = f"altitude_reference is missing; expected one of {expected}"
            raise Refused(Reason.MISSING, detail)
        if not message.HasField("time_utc"):
            raise Refused(Reason.MISSING, "time_utc is missing")
        nanos = message.time_utc.nanos
        if not 0 <= nanos < NS:
            detail = f"time_utc.nanos is {nanos}; expected 0 to {NS - 1}"
            raise Refused(Reason.OUT_OF_RANGE, detail)
        said: dict[str, Any] = {}
        for name in NUMBERS:
            if message.HasField(name):
                # Not in `check`, because NaN in a report's velocity stands for "not known".
                said[name] = check_finite(name, getattr(message, name))
            elif name in POSITION:
                raise Refused(Reason.MISSING, f"{name} is missing")
        east, north, up = (said.pop(name, math.nan) for name in VELOCITY)
        return cls(
            t_utc_ns=message.time_utc.seconds * NS + nanos,
            altitude_reference=reference,
            velocity_enu_m_s=(east, north, up),
            emitters=emitters_in(message),
            target_class=message.target_class,
            **said,
        )

    def to_protobuf(self) -> bytes:
        """The report as a serialised `plotfeed.v1.Telemetry`."""
        return self._message().SerializeToString(deterministic=True)

    def to_json(self) -> bytes:
        """The report in protobuf's JSON mapping, with the field names of the schema; UTF-8."""
        return json_format.MessageToJson(
            self._message(), preserving_proto_field_name=True, indent=None
        ).encode()

    def _message(self) -> pb.Telemetry:
        numbers = {name: getattr(self, name) for name in (*POSITION, *OTHERS)}
        numbers |= zip(VELOCITY, self.velocity_enu_m_s, strict=True)
        message = pb.Telemetry(
            **{name: value for name, value in numbers.items() if not math.isnan(value)},
            altitude_reference=self.altitude_reference.name,
            target_class=self.target_class,
            emitters=[pb.Emitter(**asdict(emitter)) for emitter in self.emitters],
        )
        message.time_utc.seconds, message.time_utc.nanos = divmod(self.t_utc_ns, NS)
        return message


def over_ground(speed_m_s: float, course_deg: float, up_m_s: float = math.nan) -> Velocity:
    """East, north and up of a speed over ground and a course."""
    course = math.radians(course_deg if speed_m_s else 0.0)  # who stands has none
    return speed_m_s * math.sin(course), speed_m_s * math.cos(course), up_m_s


def emitters_in(message: pb.Telemetry) -> tuple[Emitter, ...]:
    """What a drone says that it emits, not yet checked."""
    values = [{name: getattr(e, name) for name in EMITTER_FIELDS} for e in message.emitters]
    return tuple([Emitter(**each) for each in values])


@lru_cache(maxsize=256)
def is_class(name: str) -> bool:
    """Whether that names a class as scenes may, or is empty."""
    return len(name) <= 64 and name.isprintable() and not any(c in name for c in "/+# ")


def check(report: PositionReport) -> None:
    """Raise `Refused` if a value is not finite or outside the limits above."""
    if not 0 <= report.t_utc_ns <= LATEST_UTC_NS:
        detail = f"time_utc is {report.t_utc_ns} ns since 1970; expected 0 to {LATEST_UTC_NS}"
        raise Refused(Reason.OUT_OF_RANGE, detail)
    for name, limits in LIMITS.items():
        if name in POSITION or not math.isnan(getattr(report, name)):
            _check_value(name, getattr(report, name), limits)
    if not is_class(report.target_class):
        detail = f"target_class is {report.target_class!a}; expected {CLASS_NAMES}"
        raise Refused(Reason.NAME, detail)
    for emitter in report.emitters:
        for name, limits in EMITTER_LIMITS.items():
            _check_value(f"emitters.{name}", getattr(emitter, name), limits)
    speed_m_s = math.hypot(*(v for v in report.velocity_enu_m_s if not math.isnan(v)))
    check_finite("speed", speed_m_s)
    if speed_m_s > MAX_SPEED_M_S:
        detail = f"speed is {speed_m_s:g} m/s; expected at most {MAX_SPEED_M_S:g}"
        raise Refused(Reason.OUT_OF_RANGE, detail)


def _check_value(name: str, value: float, limits: tuple[float, float]) -> None:
    check_finite(name, value)
    least, greatest = limits
    if not least <= value <= greatest:
        expected = "more than 0" if least == ABOVE_ZERO else f"{least:g} or more"
        if greatest < math.inf:
            expected = f"{least:g} to {greatest:g}"
        raise Refused(Reason.OUT_OF_RANGE, f"{name} is {value:g}; expected {expected}")


def check_finite(name: str, value: float) -> float:
    """The value; raises `Refused` by that name if it is NaN or infinite."""
    if not math.isfinite(value):
        raise Refused(Reason.NOT_FINITE, f"{name} is {value}; expected a finite number")
    return value


@dataclass(frozen=True, slots=True)
class AltitudeDatum:
    """What altitudes are counted from, beside the ellipsoid."""

    # Of the take-off point above the ellipsoid; None where nobody says it.
    takeoff_height_m: float | None = None
    sea_level: SeaLevel = field(default_factory=SeaLevel)

    def check(self, reference: AltitudeReference) -> None:
        """Raise `Refused` for altitudes that cannot be made heights above the ellipsoid."""
        if reference is AltitudeReference.ABOVE_TAKEOFF and self.takeoff_height_m is None:
            detail = "altitude is above take-off, and the scene lacks telemetry.takeoff_height_m"
            raise Refused(Reason.ALTITUDE, detail)

    def heights_m(
        self,
        latitude_deg: ArrayLike,
        longitude_deg: ArrayLike,
        altitude_m: ArrayLike,
        references: Sequence[AltitudeReference],
    ) -> Floats:
        """Heights above the WGS-84 ellipsoid, metres, of altitudes that were checked; (n,)."""
        heights_m = np.array(altitude_m, np.float64)
        above_takeoff = AltitudeReference.ABOVE_TAKEOFF in references
        if above_takeoff and self.takeoff_height_m is not None:
            which = [r is AltitudeReference.ABOVE_TAKEOFF for r in references]
            heights_m[which] += self.takeoff_height_m
        if AltitudeReference.MEAN_SEA_LEVEL in references:
            which = [r is AltitudeReference.MEAN_SEA_LEVEL for r in references]
            latitude, longitude = np.asarray(latitude_deg), np.asarray(longitude_deg)
            heights_m[which] += self.sea_level.undulation_m(latitude[which], longitude[which])
        return heights_m


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
    elif kind is Kind.JSON:
        report = PositionReport.of(_from_json(payload))
    else:
        try:
            report = PositionReport.of(pb.Telemetry.FromString(payload))
        except (ProtobufDecodeError, ValueError) as error:
            detail = "payload is not a protobuf message plotfeed.v1.Telemetry"
            raise Refused(Reason.UNDECODABLE, detail) from error
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
    """The report of one aircraft; a height above ground is no altitude: nobody knows the ground."""
    if math.isnan(uas.altitude_m):
        if math.isnan(uas.height_m):
            raise Refused(Reason.MISSING, "I129/090, the altitude above mean sea level, is missing")
        detail = "I129/100 is a height above ground; expected I129/090, above mean sea level"
        raise Refused(Reason.ALTITUDE, detail)
    return PositionReport(
        t_utc_ns=nearest_utc_ns(round(uas.t_of_day_s * NS), now_utc_ns),
        latitude_deg=uas.latitude_deg,
        longitude_deg=uas.longitude_deg,
        altitude_m=uas.altitude_m,
        altitude_reference=AltitudeReference.MEAN_SEA_LEVEL,
        velocity_enu_m_s=(uas.velocity_east_m_s, uas.velocity_north_m_s, uas.climb_m_s),
        horizontal_accuracy_m=uas.accuracy_m / HALF_OF_POSITIONS,
    )
