"""What a drone says of itself at one time: limits of what is taken, heights above the ellipsoid."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Any, Protocol

from plotfeed.models.state import AltitudeReference, Emitter
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
    TOO_MANY_DRONES = "too_many_drones"
    NAME = "name"
    FLOOD = "flood"
    CONTROL = "control"


class Refused(PlotfeedError):  # noqa: N818 - what happened to a report, not what broke
    """A report that was not taken. `detail` is one line: what was wrong and what was expected."""

    def __init__(self, reason: Reason, detail: str) -> None:
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


def check(report: PositionReport) -> None:
    """Raise `Refused` if a value is not finite or outside the limits above."""
    if not 0 <= report.t_utc_ns <= LATEST_UTC_NS:
        detail = f"time_utc is {report.t_utc_ns} ns since 1970; expected 0 to {LATEST_UTC_NS}"
        raise Refused(Reason.OUT_OF_RANGE, detail)
    for name, (least, greatest) in LIMITS.items():
        value = getattr(report, name)
        if value is not None:
            _check_value(name, value, least, greatest)
    if report.rcs_m2 is not None:
        _check_positive("rcs_m2", report.rcs_m2)
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


class Altitude(Protocol):
    """What of a report tells its height."""

    @property
    def latitude_deg(self) -> float:
        """WGS-84."""

    @property
    def longitude_deg(self) -> float:
        """WGS-84."""

    @property
    def altitude_m(self) -> float:
        """Above what the reference says."""

    @property
    def altitude_reference(self) -> AltitudeReference:
        """What the altitude is measured from."""


EGM96_GRIDS = ("us_nga_egm96_15.tif", "egm96_15.gtx")
"""The names that PROJ knows the EGM96 geoid by, 15 minutes of arc."""


@dataclass(frozen=True, slots=True)
class AltitudeDatum:
    """What a scene declares of its heights, metres; None where it declares nothing."""

    takeoff_height_m: float | None = None
    """Of the take-off point above the ellipsoid."""
    geoid_undulation_m: float | None = None
    """Of the geoid above the ellipsoid."""

    def height_m(self, report: Altitude) -> float:
        """The report's height above the WGS-84 ellipsoid, metres; raises `Refused`."""
        match report.altitude_reference:
            case AltitudeReference.ELLIPSOID:
                return report.altitude_m
            case AltitudeReference.ABOVE_TAKEOFF:
                if self.takeoff_height_m is None:
                    detail = (
                        "altitude is above take-off, and the scene lacks telemetry.takeoff_height_m"
                    )
                    raise Refused(Reason.ALTITUDE, detail)
                return report.altitude_m + self.takeoff_height_m
            case AltitudeReference.MEAN_SEA_LEVEL:
                if self.geoid_undulation_m is not None:
                    return report.altitude_m + self.geoid_undulation_m
                undulation_m = egm96_undulation_m(report.latitude_deg, report.longitude_deg)
                return report.altitude_m + undulation_m


def egm96_undulation_m(latitude_deg: float, longitude_deg: float) -> float:
    """Height of the EGM96 geoid above the ellipsoid, from an installed grid; raises `Refused`."""
    transformer = _egm96()
    if transformer is None:
        detail = (
            "altitude is above mean sea level: set telemetry.geoid_undulation_m in the scene, or "
            "install plotfeed[geoid] and the grid us_nga_egm96_15.tif (projsync --file "
            "us_nga_egm96_15.tif)"
        )
        raise Refused(Reason.ALTITUDE, detail)
    undulation_m = float(transformer.transform(longitude_deg, latitude_deg, 0.0)[2])
    if not math.isfinite(undulation_m):
        detail = (
            f"the EGM96 grid has no value at latitude {latitude_deg:g}, longitude "
            f"{longitude_deg:g}; set telemetry.geoid_undulation_m in the scene"
        )
        raise Refused(Reason.ALTITUDE, detail)
    return undulation_m


@cache
def _egm96() -> Any | None:
    """A transformer from heights above the geoid to above the ellipsoid; None without a grid."""
    try:
        import pyproj
    except ImportError:
        return None
    pyproj.network.set_network_enabled(active=False)  # type: ignore[attr-defined]
    for grid in EGM96_GRIDS:
        pipeline = (
            "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
            f"+step +proj=vgridshift +grids={grid} +multiplier=1 "
            "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
        )
        try:
            return pyproj.Transformer.from_pipeline(pipeline)
        except pyproj.exceptions.ProjError:
            continue
    return None
