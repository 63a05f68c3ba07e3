"""Aircraft that an autopilot has heard by its own receiver of ADS-B, and tells of in ADSB_VEHICLE.

MAVLink, common message 246 and the enumerations ADSB_FLAGS, ADSB_ALTITUDE_TYPE, ADSB_EMITTER_TYPE.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from plotfeed.feeds.telemetry.live.aircraft_kinds import OF_EMITTER_MAVLINK, SMALL, as_reported
from plotfeed.feeds.telemetry.live.heard import HeardReport
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.utc import NS

ADSB_VEHICLE = 246
HAS_PLACE, HAS_ALTITUDE, HAS_COURSE, HAS_SPEED, HAS_CLIMB = 1, 2, 4, 8, 128
HAS_ALL_OF_PLACE = HAS_PLACE | HAS_ALTITUDE
HAS_VELOCITY = HAS_COURSE | HAS_SPEED
# By altitude type: of pressure with the QNH of the autopilot, and of GNSS.
REFERENCES = {0: AltitudeReference.MEAN_SEA_LEVEL, 1: AltitudeReference.ELLIPSOID}
OLD_S = 5  # What was heard that long ago says no more where an aircraft is


def aircraft_in(message: Any, now_utc_ns: int) -> Iterator[HeardReport]:
    """The report of an ADSB_VEHICLE; none where it has no place, no altitude, or is old.

    The aircraft is called by its ICAO address, as other sources of ADS-B have it.
    """
    reference = REFERENCES.get(message.altitude_type)
    has_place = message.flags & HAS_ALL_OF_PLACE == HAS_ALL_OF_PLACE
    if not has_place or reference is None or message.tslc > OLD_S:
        return
    report = PositionReport(
        t_utc_ns=now_utc_ns - message.tslc * NS,
        latitude_deg=message.lat * 1e-7,
        longitude_deg=message.lon * 1e-7,
        altitude_m=message.altitude * 1e-3,
        altitude_reference=reference,
        velocity_enu_m_s=_velocity(message),
        **as_reported(OF_EMITTER_MAVLINK.get(message.emitter_type, SMALL)),
    )
    yield HeardReport.checked(f"{message.ICAO_address:06x}", report)


def _velocity(message: Any) -> tuple[float, float, float] | None:
    """East, north and up; None without a speed over ground."""
    if message.flags & HAS_VELOCITY != HAS_VELOCITY:
        return None
    speed_m_s, course = message.hor_velocity * 0.01, math.radians(message.heading * 0.01)
    climb_m_s = message.ver_velocity * 0.01 if message.flags & HAS_CLIMB else math.nan
    return speed_m_s * math.sin(course), speed_m_s * math.cos(course), climb_m_s
