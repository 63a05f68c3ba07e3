"""Tracks in XML: GPX, and KML with its times, whose points another process takes out of it."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from plotfeed.feeds.telemetry.flights.flight import FlightOptions, Log, utc_ns
from plotfeed.feeds.telemetry.flights.table import REFERENCE_WORDS
from plotfeed.feeds.telemetry.foreign_files import read_apart
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError


def read_gpx(text: str, options: FlightOptions, log: Log) -> None:
    """Take every track point that has a time and an elevation."""
    found = _points(text, log)
    reference = options.altitude_reference
    if reference is None:
        reference = AltitudeReference.MEAN_SEA_LEVEL
        log.assume("elevations are above mean sea level (--altitude-reference)")
    for number, point in enumerate(found["gpx"], start=1):
        where, height = f"track point {number}", options.stated_height
        latitude, longitude, elevation, time = point
        try:
            if elevation is not None:
                height = float(elevation), reference
            if time is None:
                log.skip(where, "no time")
            elif height is None:
                log.skip(where, "no elevation")
            else:
                t_utc_ns = utc_ns(datetime.fromisoformat(time), options.utc_offset_h)
                log.take(where, t_utc_ns, (float(latitude), float(longitude)), height)
        except (ValueError, TypeError, OverflowError):
            log.skip(where, "no time, position or elevation that can be read")


def _points(text: str, log: Log) -> Mapping[str, Any]:
    """What there is of points; those before the cut where the file is cut short."""
    found: Mapping[str, Any] = read_apart("GPX or KML", text.encode())
    if found["cut"]:
        octet, why, left = found["cut"]
        log.skip(f"octet {octet}", f"cut short ({why}): {left} left")
    return found


# What altitudes of KML are above; in other modes, of which one is the usual, there are none.
_MODES = {
    "absolute": AltitudeReference.MEAN_SEA_LEVEL,
    "relativeToGround": AltitudeReference.ABOVE_TAKEOFF,
}


def read_kml(text: str, options: FlightOptions, log: Log) -> None:
    """Take every point of a gx:Track that has a time, and every placemark that has one."""
    found = _points(text, log)
    for before, whens, places in found["uneven"]:
        log.skip(f"point {before + 1}", f"{whens} times of {places} coordinates")
    if not found["kml"]:
        raise PlotfeedError(
            "no positions with times: expected a gx:Track, or placemarks with a TimeStamp; "
            "a LineString says where and not when"
        )
    for number, (when, place, mode) in enumerate(found["kml"], start=1):
        where = f"point {number}"
        try:
            t_utc_ns = utc_ns(datetime.fromisoformat(when.strip()), options.utc_offset_h)
            longitude_deg, latitude_deg, *more = map(float, place)
        except (ValueError, OverflowError):
            log.skip(where, "no time or position that can be read")
            continue
        height = options.stated_height
        if more and mode in _MODES:
            height = more[0], options.altitude_reference or _MODES[mode]
        if height is None:
            log.skip(where, f"no height: altitudeMode is {mode or 'clampToGround'}; give height_m")
            continue
        log.state(f"height in metres, {REFERENCE_WORDS[height[1]]}: altitudeMode {mode or 'none'}")
        if mode == "relativeToGround" and options.altitude_reference is None:
            log.assume("heights above the ground are taken as above take-off (altitude_reference)")
        log.take(where, t_utc_ns, (latitude_deg, longitude_deg), height)
