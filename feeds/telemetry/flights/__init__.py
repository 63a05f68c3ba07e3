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
)
from plotfeed.feeds.telemetry.flights.flight import (
    MAX_OCTETS,
    Flight,
    FlightOptions,
    GpsOrder,
    Log,
)
from plotfeed.feeds.telemetry.flights.markup import read_gpx, read_kml
from plotfeed.feeds.telemetry.flights.nmea import LOOKS_LIKE, read_nmea
from plotfeed.feeds.telemetry.flights.smoothed import smoothed
from plotfeed.feeds.telemetry.flights.srt import read_srt
from plotfeed.feeds.telemetry.flights.table import read_table
from plotfeed.feeds.telemetry.flights.ulog import ULOG_START, read_ulog
from plotfeed.proto.errors import PlotfeedError

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
FIRST_SCRAMBLED, FIRST_ENCRYPTED = 7, 13
"""Versions of DJI's binary flight records."""
EXPORTERS = "Airdata, PhantomHelp or Flight Reader"


def read(
    path: str | Path, options: FlightOptions | None = None, *, max_octets: int = MAX_OCTETS
) -> Flight:
    """The flight in a log: DJI SRT, CSV, ArduPilot .bin, MAVLink .tlog, ULog, GPX, KML or NMEA.

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
    kind = path.suffix.lower()
    if start.startswith(RECORD_START):
        kind = ".bin"
    elif data.startswith(ULOG_START):
        kind = ".ulg"
    elif start.startswith((b"<?xml", b"<gpx", b"<kml")):
        kind = ".kml" if b"<kml" in start else ".gpx"
    elif LOOKS_LIKE.match(start):
        kind = ".nmea"
    elif (why := _of_dji(data)) is not None:
        raise PlotfeedError(why)
    elif b"-->" in start:
        kind = ".srt"
    elif kind not in BY_SUFFIX and looks_like_tlog(data):
        kind = ".tlog"
    if kind in BY_SUFFIX:
        return BY_SUFFIX[kind]
    raise PlotfeedError(f"unknown kind of file; expected one of {' '.join(BY_SUFFIX)}")


def _of_dji(data: bytes) -> str | None:
    """Why a binary flight record of a DJI app cannot be read; None for what is none.

    It begins with where its details are, 8 octets little-endian, their length, 2, and a version.
    """
    details, version = int.from_bytes(data[:8], "little"), data[10] if len(data) > 10 else 0
    if not (0 < version < 32 and 12 < details <= len(data) and 0 in data[:8]):
        return None
    how = "not read here"
    if version >= FIRST_ENCRYPTED:
        how = "encrypted, with a key that DJI gives to who asks for it"
    elif version >= FIRST_SCRAMBLED:
        how = "scrambled"
    return (
        f"a flight record of a DJI app, version {version}, {how}: "
        f"have {EXPORTERS} make a CSV of it, and give that"
    )


__all__ = ["Flight", "FlightOptions", "GpsOrder", "read", "smoothed"]
