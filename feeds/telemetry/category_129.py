"""Telemetry reports from ASTERIX 129, which tells a time of day and an altitude over the sea.

Pure, as the reading of other telemetry is: what time it is comes with the call.
"""

from __future__ import annotations

import math

from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.asterix.encode_129 import UasReport, read_129
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import NS

CATEGORY = 129
HEADER_OCTETS = 3
DAY_NS = 86_400 * NS
HALF_OF_POSITIONS = math.sqrt(2 * math.log(2))
"""Radius that holds half of a circular normal distribution, in standard deviations."""


def is_block_129(payload: bytes) -> bool:
    """Whether a payload looks like one data block of the category, and nothing else."""
    return (
        len(payload) > HEADER_OCTETS
        and payload[0] == CATEGORY
        and int.from_bytes(payload[1:HEADER_OCTETS], "big") == len(payload)
    )


def report_129(payload: bytes, now_utc_ns: int | None) -> PositionReport:
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
    return max((_report(one, now_utc_ns) for one in found), key=lambda report: report.t_utc_ns)


def _report(uas: UasReport, now_utc_ns: int) -> PositionReport:
    velocity = (uas.velocity_east_m_s, uas.velocity_north_m_s, uas.climb_m_s)
    accuracy_m = None
    if not math.isnan(uas.accuracy_m):
        accuracy_m = uas.accuracy_m / HALF_OF_POSITIONS
    return PositionReport(
        t_utc_ns=nearest_utc_ns(uas.t_of_day_s, now_utc_ns),
        latitude_deg=uas.latitude_deg,
        longitude_deg=uas.longitude_deg,
        altitude_m=_altitude_m(uas),
        altitude_reference=AltitudeReference.MEAN_SEA_LEVEL,
        velocity_enu_m_s=None if all(map(math.isnan, velocity)) else velocity,
        horizontal_accuracy_m=accuracy_m,
    )


def _altitude_m(uas: UasReport) -> float:
    """What I129/090 says; a height above ground is none, where nobody knows the ground."""
    if not math.isnan(uas.altitude_m):
        return uas.altitude_m
    if math.isnan(uas.height_m):
        raise Refused(Reason.MISSING, "I129/090, the altitude above mean sea level, is missing")
    detail = "I129/100 is a height above ground; expected I129/090, above mean sea level"
    raise Refused(Reason.ALTITUDE, detail)


def nearest_utc_ns(t_of_day_s: float, now_utc_ns: int) -> int:
    """The time nearest to now that has this time of day."""
    of_day_ns = round(t_of_day_s * NS)
    days = (now_utc_ns - of_day_ns + DAY_NS // 2) // DAY_NS
    return of_day_ns + days * DAY_NS
