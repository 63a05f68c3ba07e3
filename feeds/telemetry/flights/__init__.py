"""Flights from files: which reader, within which size, and which files no reader can read.

Each reader takes what it finds in a file into a `Log`, which gives the `Flight`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from plotfeed.feeds.telemetry.flights.autopilot_logs import (
    RECORD_START,
    looks_like_tlog,
    read_dataflash,
    read_tlog,
    read_ulog,
)
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions, GpsOrder, Log
from plotfeed.feeds.telemetry.flights.markup import read_gpx, read_kml
from plotfeed.feeds.telemetry.flights.nmea import LOOKS_LIKE, read_nmea
from plotfeed.feeds.telemetry.flights.smoothed import smoothed
from plotfeed.feeds.telemetry.flights.srt import read_srt
from plotfeed.feeds.telemetry.flights.table import read_table
from plotfeed.feeds.telemetry.foreign_files import ULOG_START, file_octets
from plotfeed.proto.errors import PlotfeedError

EXPORTERS = "Airdata, PhantomHelp or Flight Reader"
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
    ".kml": _of_text(read_kml),
    ".ulg": read_ulog,
    ".nmea": _of_text(read_nmea),
}


def read(path: str | Path, options: FlightOptions | None = None) -> Flight:
    """The flight in a log of DJI, ArduPilot, MAVLink, PX4, a receiver, or in a table, GPX or KML.

    The options say what the file does not. Records that are damaged, out of order or implausible
    are listed in `skipped`; raises `PlotfeedError` if nothing is left or the file cannot be
    understood.
    """
    options = options or FlightOptions()
    path = Path(path)
    try:
        if not abs(options.utc_offset_h) <= 24:
            raise PlotfeedError(f"UTC offset is {options.utc_offset_h:g} h; expected -24 to 24")
        data = file_octets(path, "other flight")
        if not data.strip():
            raise PlotfeedError("empty file")
        log = Log()
        _reader(path, data)(data, options, log)
        return log.flight(path.stem, options.max_speed_m_s)
    except PlotfeedError as error:
        raise PlotfeedError(" ".join(f"{path}: {error}".split())) from error
    except Exception as error:  # of strangers' data, whatever it is
        broken = f"{path}: no reader foresaw what is in it: {type(error).__name__}"
        raise PlotfeedError(broken) from error


def _reader(path: Path, data: bytes) -> Reader:
    """The reader that the file's beginning asks for where it is unmistakable, else its name."""
    start = data[:1024].lstrip(b"\xef\xbb\xbf \t\r\n")
    kind = path.suffix.lower()
    if start.startswith(RECORD_START):
        kind = ".bin"
    elif data.startswith(ULOG_START):
        kind = ".ulg"
    elif start.startswith((b"<?xml", b"<gpx", b"<kml")):
        kind = ".kml" if b"<kml" in start else ".gpx"
    elif LOOKS_LIKE.match(start):
        kind = ".nmea"
    elif version := _dji_version(data):
        raise PlotfeedError(
            f"a flight record of a DJI app, version {version}, which plotfeed does not read: "
            f"have {EXPORTERS} make a CSV of it, and give that"
        )
    elif b"-->" in start:
        kind = ".srt"
    elif kind not in BY_SUFFIX and looks_like_tlog(data):
        kind = ".tlog"
    if kind in BY_SUFFIX:
        return BY_SUFFIX[kind]
    raise PlotfeedError(f"unknown kind of file; expected one of {' '.join(BY_SUFFIX)}")


def _dji_version(data: bytes) -> int:
    """The version of a binary flight record of a DJI app; 0 for anything else.

    It begins with where its details are, 8 octets little-endian, their length, 2, and the version;
    an encrypted one, from version 13 on, may leave that place 0.
    """
    details, version = int.from_bytes(data[:8], "little"), data[10] if len(data) > 10 else 0
    if not (0 < version < 32 and 0 in data[:8]):
        return 0
    return version if 12 < details <= len(data) or (details == 0 and version >= 13) else 0


__all__ = ["Flight", "FlightOptions", "GpsOrder", "read", "smoothed"]
