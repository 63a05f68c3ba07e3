"""What a drone says of itself at one time: limits of what is taken, heights above the ellipsoid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.models.state import AltitudeReference, Emitter, Floats
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

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

    def message(self) -> pb.Telemetry:
        """The report as a message."""
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
