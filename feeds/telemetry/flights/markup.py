"""Tracks in XML: GPX, and KML with its times, parsed without document types and entities."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from typing import Any

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.telemetry.flights.flight import FlightOptions, Log, utc_ns
from plotfeed.feeds.telemetry.flights.table import REFERENCE_WORDS
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

_POINT_END = "</trkpt>"
_CUT_TAIL = "</trkseg></trk></gpx>"


def read_gpx(text: str, options: FlightOptions, log: Log) -> None:
    """Take every track point that has a time and an elevation."""
    reference = options.altitude_reference
    if reference is None:
        reference = AltitudeReference.MEAN_SEA_LEVEL
        log.assume("elevations are above mean sea level (altitude_reference)")
    for number, point in enumerate(_points(text, log), start=1):
        where, height = f"track point {number}", options.stated_height
        if point.elevation is not None:
            height = point.elevation, reference
        if point.time is None:
            log.skip(where, "no time")
        elif height is None:
            log.skip(where, "no elevation")
        else:
            t_utc_ns = utc_ns(point.time, options.utc_offset_h)
            log.take(where, t_utc_ns, (point.latitude, point.longitude), height)


def _points(text: str, log: Log) -> Iterator[Any]:
    """All track points in their order; those before the cut where the file is cut short."""
    try:
        gpx = _parse_gpx(text)
    except _DocumentTypeError:
        raise
    except PlotfeedError as error:
        whole, end, cut = text.rpartition(_POINT_END)
        if not end:
            raise
        gpx = _parse_gpx(whole + end + _CUT_TAIL)
        log.skip(f"octet {len((whole + end).encode())}", f"cut short ({error}): {len(cut)} left")
    for track in gpx.tracks:
        for segment in track.segments:
            yield from segment.points


class _DocumentTypeError(PlotfeedError):
    """XML that would define what it then uses, and grow without end."""


def _parse_gpx(text: str) -> Any:
    need_extra("gpxpy", "GPX", "gpx")
    import gpxpy

    _element(text, "GPX")  # gpxpy's own parser takes whatever comes
    try:
        return gpxpy.parse(text)
    except Exception as error:  # gpxpy lets its XML library's errors through
        raise PlotfeedError(_not_read("GPX", error)) from error


def _element(text: str, kind: str) -> Any:
    """The root of an XML document; raises `PlotfeedError`."""
    need_extra("defusedxml", kind, "gpx")
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        return fromstring(text, forbid_dtd=True)
    except DefusedXmlException:
        raise _DocumentTypeError(
            f"a {kind} file has no document type; entities are not expanded"
        ) from None
    except Exception as error:  # of the XML library, of which there are several kinds
        raise PlotfeedError(_not_read(kind, error)) from error


def _not_read(kind: str, error: Exception) -> str:
    return f"not a {kind} file that can be read: {' '.join(str(error).split())[:200]}"


# What altitudes of KML are above; in other modes, of which one is the usual, there are none.
_MODES = {
    "absolute": AltitudeReference.MEAN_SEA_LEVEL,
    "relativeToGround": AltitudeReference.ABOVE_TAKEOFF,
}


def read_kml(text: str, options: FlightOptions, log: Log) -> None:
    """Take every point of a gx:Track that has a time, and every placemark that has one."""
    root = _element(text, "KML")
    taken = 0
    for element in root.iter():
        name = _local(element)
        if name == "Track":
            taken += _take_track(element, options, log, taken)
        elif name == "Placemark" and not any(_local(e) == "Track" for e in element.iter()):
            taken += _take_placemark(element, options, log, taken)
    if not taken:
        raise PlotfeedError(
            "no positions with times: expected a gx:Track, or placemarks with a TimeStamp; "
            "a LineString says where and not when"
        )


def _take_track(track: Any, options: FlightOptions, log: Log, before: int) -> int:
    """The n-th time belongs to the n-th coordinate, and either may be empty."""
    whens = [e.text or "" for e in track if _local(e) == "when"]
    places = [e.text or "" for e in track if _local(e) == "coord"]
    mode = next((e.text or "" for e in track if _local(e) == "altitudeMode"), "")
    if len(whens) != len(places):
        log.skip(f"point {before + 1}", f"{len(whens)} times of {len(places)} coordinates")
    for number, (when, place) in enumerate(zip(whens, places, strict=False), start=before + 1):
        _take_point(f"point {number}", when, place.split(), mode.strip(), options, log)
    return max(len(whens), len(places))


def _take_placemark(mark: Any, options: FlightOptions, log: Log, before: int) -> int:
    when = next((e.text or "" for e in mark.iter() if _local(e) == "when"), "")
    point = next((e for e in mark.iter() if _local(e) == "Point"), None)
    if not when or point is None:
        return 0
    text = next((e.text or "" for e in point if _local(e) == "coordinates"), "")
    mode = next((e.text or "" for e in point if _local(e) == "altitudeMode"), "")
    places = text.strip().split(",")
    _take_point(f"point {before + 1}", when, places, mode.strip(), options, log)
    return 1


def _take_point(  # noqa: PLR0917
    where: str, when: str, place: list[str], mode: str, options: FlightOptions, log: Log
) -> None:
    """A time beside longitude, latitude and altitude."""
    try:
        t_utc_ns = utc_ns(datetime.fromisoformat(when.strip()), options.utc_offset_h)
        longitude_deg, latitude_deg, *more = (float(number) for number in place)
    except (ValueError, OverflowError):
        log.skip(where, "no time or position that can be read")
        return
    reference = options.altitude_reference or _MODES.get(mode)
    altitude_m = more[0] if more and mode in _MODES else None
    if altitude_m is None and options.stated_height is not None:
        altitude_m, reference = options.stated_height
    if altitude_m is None or reference is None:
        log.skip(where, f"no height: altitudeMode is {mode or 'clampToGround'}; give height_m")
        return
    log.state(f"height in metres, {REFERENCE_WORDS[reference]}: altitudeMode {mode or 'none'}")
    if mode == "relativeToGround" and options.altitude_reference is None:
        log.assume("heights above the ground are taken as above take-off (altitude_reference)")
    log.take(where, t_utc_ns, (latitude_deg, longitude_deg), (altitude_m, reference))


def _local(element: Any) -> str:
    """An element's name without its namespace."""
    return str(element.tag).rpartition("}")[2]
