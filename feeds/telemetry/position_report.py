"""What a drone says of itself at one time: limits of what is taken, heights above the ellipsoid."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.models.state import AltitudeReference, Emitter, Floats
from plotfeed.proto.errors import PlotfeedError

MAX_SPEED_M_S = 1000.0
LATEST_UTC_NS = 2**63 - 1  # year 2262: the last that int64 holds
LIMITS = {
    "latitude_deg": (-90.0, 90.0),
    "longitude_deg": (-180.0, 180.0),
    "altitude_m": (-1000.0, 100_000.0),
    "horizontal_accuracy_m": (0.0, math.inf),
    "vertical_accuracy_m": (0.0, math.inf),
    "velocity_accuracy_m_s": (0.0, math.inf),
    "sound_power_db": (-math.inf, math.inf),
}
"""Least and greatest value taken, both included."""
POSITIVE = ("rcs_m2", "size_m")
"""Values of which none is 0 or less."""
CLASS_NAMES = "1 to 64 printable characters without space, /, + and #"

MAX_DETAIL = 300
"""Characters of a refusal's text: it quotes what others sent."""


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

    `is_told` says that it was told of another report already, and need only be counted.
    """

    def __init__(self, reason: Reason, detail: str, *, is_told: bool = False) -> None:
        self.is_told = is_told
        line = " ".join(detail.split())
        self.reason = reason
        self.detail = line if len(line) <= MAX_DETAIL else line[: MAX_DETAIL - 1] + "…"
        super().__init__(self.detail)


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionReport:
    """One sample of a drone's state. WGS-84 degrees; accuracies are one standard deviation.

    Velocity is east, north, up in m/s, NaN for a component that is not known.
    """

    t_utc_ns: int
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    altitude_reference: AltitudeReference
    velocity_enu_m_s: tuple[float, float, float] | None = None
    horizontal_accuracy_m: float | None = None
    vertical_accuracy_m: float | None = None
    velocity_accuracy_m_s: float | None = None
    rcs_m2: float | None = None
    sound_power_db: float | None = None
    emitters: tuple[Emitter, ...] = ()
    target_class: str = ""
    """What it is to sensors that recognise it; empty where nobody says it."""
    size_m: float | None = None


@lru_cache(maxsize=256)
def is_class(name: str) -> bool:
    """Whether that names a class as scenes may, or is empty."""
    return len(name) <= 64 and name.isprintable() and not any(c in name for c in "/+# ")


def check(report: PositionReport) -> None:
    """Raise `Refused` if a value is not finite or outside the limits above."""
    if not 0 <= report.t_utc_ns <= LATEST_UTC_NS:
        detail = f"time_utc is {report.t_utc_ns} ns since 1970; expected 0 to {LATEST_UTC_NS}"
        raise Refused(Reason.OUT_OF_RANGE, detail)
    for name, (least, greatest) in LIMITS.items():
        value = getattr(report, name)
        if value is not None:
            _check_value(name, value, least, greatest)
    for name in POSITIVE:
        if (value := getattr(report, name)) is not None:
            _check_positive(name, value)
    if not is_class(report.target_class):
        detail = f"target_class is {report.target_class!a}; expected {CLASS_NAMES}"
        raise Refused(Reason.NAME, detail)
    for emitter in report.emitters:
        _check_emitter(emitter)
    if report.velocity_enu_m_s is not None:
        _check_speed(report.velocity_enu_m_s)


def _check_value(name: str, value: float, least: float, greatest: float) -> None:
    check_finite(name, value)
    if not least <= value <= greatest:
        expected = f"expected {least:g} or more"
        if greatest < math.inf:
            expected = f"expected {least:g} to {greatest:g}"
        raise Refused(Reason.OUT_OF_RANGE, f"{name} is {value:g}; {expected}")


def check_finite(name: str, value: float) -> None:
    """Raise `Refused` by that name if the value is NaN or infinite."""
    if not math.isfinite(value):
        raise Refused(Reason.NOT_FINITE, f"{name} is {value}; expected a finite number")


def _check_positive(name: str, value: float) -> None:
    check_finite(name, value)
    if value <= 0:
        raise Refused(Reason.OUT_OF_RANGE, f"{name} is {value:g}; expected more than 0")


def _check_emitter(emitter: Emitter) -> None:
    _check_positive("emitters.frequency_hz", emitter.frequency_hz)
    _check_value("emitters.bandwidth_hz", emitter.bandwidth_hz, 0.0, math.inf)
    check_finite("emitters.eirp_dbm", emitter.eirp_dbm)


def _check_speed(velocity_enu_m_s: Iterable[float]) -> None:
    speed_m_s = math.hypot(*(v for v in velocity_enu_m_s if not math.isnan(v)))
    check_finite("speed", speed_m_s)
    if speed_m_s > MAX_SPEED_M_S:
        detail = f"speed is {speed_m_s:g} m/s; expected at most {MAX_SPEED_M_S:g}"
        raise Refused(Reason.OUT_OF_RANGE, detail)


@dataclass(frozen=True, slots=True)
class AltitudeDatum:
    """What altitudes are counted from, beside the ellipsoid."""

    takeoff_height_m: float | None = None
    """Of the take-off point above the ellipsoid; None where nobody says it."""
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
