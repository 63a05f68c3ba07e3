"""GPX tracks, through gpxpy (`plotfeed[gpx]`)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from plotfeed.feeds.flights.flight import FlightOptions, Log, utc_ns
from plotfeed.feeds.report import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

_POINT_END = "</trkpt>"
_CUT_TAIL = "</trkseg></trk></gpx>"


def read_gpx(text: str, options: FlightOptions, log: Log) -> None:
    """Take every track point that has a time and an elevation."""
    reference = options.altitude_reference
    if reference is None:
        reference = AltitudeReference.MEAN_SEA_LEVEL
        log.assume("elevations are above mean sea level (--altitude-reference)")
    for number, point in enumerate(_points(text, log), start=1):
        where = f"track point {number}"
        if point.time is None:
            log.skip(where, "no time")
        elif point.elevation is None:
            log.skip(where, "no elevation")
        else:
            log.take(
                where,
                t_utc_ns=utc_ns(point.time, options.utc_offset_h),
                latitude_deg=point.latitude,
                longitude_deg=point.longitude,
                altitude_m=point.elevation,
                altitude_reference=reference,
            )


def _points(text: str, log: Log) -> Iterator[Any]:
    """All track points in their order; those before the cut where the file is cut short."""
    if re.search(r"<!(DOCTYPE|ENTITY)", text):
        raise PlotfeedError("a GPX file has no document type; entities are not expanded")
    try:
        gpx = _parse(text)
    except PlotfeedError as error:
        whole, end, cut = text.rpartition(_POINT_END)
        if not end:
            raise
        gpx = _parse(whole + end + _CUT_TAIL)
        log.skip(f"octet {len((whole + end).encode())}", f"cut short ({error}): {len(cut)} left")
    for track in gpx.tracks:
        for segment in track.segments:
            yield from segment.points


def _parse(text: str) -> Any:
    try:
        import gpxpy  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise PlotfeedError("GPX needs gpxpy: pip install 'plotfeed[gpx]'") from error
    try:
        return gpxpy.parse(text)
    except Exception as error:  # gpxpy lets its XML library's errors through
        line = " ".join(str(error).split())[:200]
        raise PlotfeedError(f"not a GPX file that can be read: {line}") from error
