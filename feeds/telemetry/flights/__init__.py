"""Flights from files: which reader, within which size; GPX tracks.

Each reader takes what it finds in a file into a `Log`, which gives the `Flight`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from plotfeed.feeds.telemetry.flights.autopilot_logs import (
    RECORD_START,
    looks_like_tlog,
    read_dataflash,
    read_tlog,
)
from plotfeed.feeds.telemetry.flights.flight import (
    MAX_OCTETS,
    Flight,
    FlightOptions,
    GpsOrder,
    Log,
    utc_ns,
)
from plotfeed.feeds.telemetry.flights.smoothed import smoothed
from plotfeed.feeds.telemetry.flights.srt import read_srt
from plotfeed.feeds.telemetry.flights.table import read_table
from plotfeed.models.state import AltitudeReference
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
    try:
        gpx = _parse(text)
    except _DocumentTypeError:
        raise
    except PlotfeedError as error:
        whole, end, cut = text.rpartition(_POINT_END)
        if not end:
            raise
        gpx = _parse(whole + end + _CUT_TAIL)
        log.skip(f"octet {len((whole + end).encode())}", f"cut short ({error}): {len(cut)} left")
    for track in gpx.tracks:
        for segment in track.segments:
            yield from segment.points


class _DocumentTypeError(PlotfeedError):
    """XML that would define what it then uses, and grow without end."""


def _parse(text: str) -> Any:
    try:
        import gpxpy
        from defusedxml import DefusedXmlException
        from defusedxml.ElementTree import fromstring
    except ImportError as error:
        raise PlotfeedError(
            "GPX needs gpxpy and defusedxml: pip install 'plotfeed[gpx]'"
        ) from error
    try:
        fromstring(text, forbid_dtd=True)  # gpxpy's own parser takes whatever comes
        return gpxpy.parse(text)
    except DefusedXmlException:
        raise _DocumentTypeError(
            "a GPX file has no document type; entities are not expanded"
        ) from None
    except Exception as error:  # gpxpy lets its XML library's errors through
        line = " ".join(str(error).split())[:200]
        raise PlotfeedError(f"not a GPX file that can be read: {line}") from error


Reader = Callable[[bytes, FlightOptions, Log], None]


def _of_text(read_text: Callable[[str, FlightOptions, Log], None]) -> Reader:
    """A reader of octets by one of text: what is not UTF-8 is replaced and then no number."""
    return lambda data, options, log: read_text(data.decode("utf-8-sig", "replace"), options, log)


BY_SUFFIX: Mapping[str, Reader] = {
    ".srt": _of_text(read_srt),
    ".csv": _of_text(read_table),
    ".tsv": _of_text(read_table),
    ".txt": _of_text(read_table),
    ".bin": read_dataflash,
    ".tlog": read_tlog,
    ".gpx": _of_text(read_gpx),
}


def read(
    path: str | Path, options: FlightOptions | None = None, *, max_octets: int = MAX_OCTETS
) -> Flight:
    """The flight in a log: DJI SRT, CSV, ArduPilot .bin, MAVLink .tlog or GPX.

    The options say what the file does not. Records that are damaged, out of order or implausible
    are listed in `skipped`; raises `PlotfeedError` if nothing is left or the file cannot be
    understood.
    """
    options = options or FlightOptions()
    path = Path(path)
    try:
        if not abs(options.utc_offset_h) <= 24:
            raise PlotfeedError(f"UTC offset is {options.utc_offset_h:g} h; expected -24 to 24")
        data = _octets(path, max_octets)
        log = Log()
        _reader(path, data)(data, options, log)
        return log.flight(path.stem, options.max_speed_m_s)
    except PlotfeedError as error:
        raise PlotfeedError(" ".join(f"{path}: {error}".split())) from error


def _octets(path: Path, max_octets: int) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(max_octets + 1)
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else None
        raise PlotfeedError(f"cannot be read: {why or error}") from error
    if len(data) > max_octets:
        raise PlotfeedError(f"larger than {max_octets} octets, the most that is read")
    if not data.strip():
        raise PlotfeedError("empty file")
    return data


def _reader(path: Path, data: bytes) -> Reader:
    """The reader that the file's beginning asks for where it is unmistakable, else its name."""
    start = data[:1024].lstrip(b"\xef\xbb\xbf \t\r\n")
    if start.startswith(RECORD_START):
        return read_dataflash
    if start.startswith((b"<?xml", b"<gpx")):
        return BY_SUFFIX[".gpx"]
    if b"-->" in start:
        return BY_SUFFIX[".srt"]
    if (by_name := BY_SUFFIX.get(path.suffix.lower())) is not None:
        return by_name
    if looks_like_tlog(data):
        return read_tlog
    raise PlotfeedError(f"unknown kind of file; expected one of {' '.join(BY_SUFFIX)}")


__all__ = ["Flight", "FlightOptions", "GpsOrder", "read", "smoothed"]
