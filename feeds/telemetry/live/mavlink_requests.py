"""What an autopilot is asked: MAVLink frames of a ground station that only listens."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

from plotfeed.feeds.telemetry.live.mavlink_reports import (
    GLOBAL_POSITION_INT,
    GPS_RAW_INT,
    HOME_POSITION,
    SYSTEM_TIME,
)

GROUND_STATION, ITS_COMPONENT = 255, 190
SLOW_US = 1_000_000  # Between two of what hardly changes
ALL_SYSTEMS, AUTOPILOT = 0, 1


@cache
def _station() -> tuple[Any, Any]:
    from pymavlink.dialects.v20 import common

    return common, common.MAVLink(None, srcSystem=GROUND_STATION, srcComponent=ITS_COMPONENT)


def heartbeat() -> bytes:
    """The sign that a ground station is there: some autopilots send to nobody else."""
    common, station = _station()
    message = station.heartbeat_encode(
        common.MAV_TYPE_GCS, common.MAV_AUTOPILOT_INVALID, 0, 0, common.MAV_STATE_ACTIVE
    )
    return bytes(message.pack(station))


def requests(every_us: int) -> Iterator[bytes]:
    """SET_MESSAGE_INTERVAL, command 511, for each message that is wanted, to all autopilots."""
    common, station = _station()
    intervals = {
        GLOBAL_POSITION_INT: every_us,
        GPS_RAW_INT: every_us,
        SYSTEM_TIME: SLOW_US,
        HOME_POSITION: SLOW_US,
    }
    for number, interval_us in intervals.items():
        message = station.command_long_encode(
            ALL_SYSTEMS,
            AUTOPILOT,
            common.MAV_CMD_SET_MESSAGE_INTERVAL,
            0,
            *(number, interval_us, 0, 0, 0, 0, 0),
        )
        yield bytes(message.pack(station))
