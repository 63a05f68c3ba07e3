"""Files from strangers: what is taken of each kind at most, and reading the heavy ones apart.

What others' libraries read (rasters and ULog), or XML (GPX and KML), is read by another process:
without our sockets and secrets, with limits of the system where it has them. It hands back texts
and arrays.
"""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
import warnings
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, BinaryIO

from plotfeed.feeds.console.posix import confine_process
from plotfeed.proto.errors import PlotfeedError


@dataclass(frozen=True, slots=True)
class FileLimits:
    """What is taken of a kind of file at most; a greater one is refused with the number.

    Both numbers are 0 where a file is read in pieces, and each of them is bounded.
    """

    octets: int
    count: int  # Of what it holds: samples, points, records or corners
    depth: int = 0  # Of what is in each other
    memory_mib: int = 0  # Of the process that reads it; 0 where that is ours
    seconds: int = 0  # That it may read


MIB = 1 << 20
FILE_LIMITS: Mapping[str, FileLimits] = {
    # 14 tiles of 1 arc second.
    "GeoTIFF": FileLimits(1024 * MIB, 200_000_000, memory_mib=4096, seconds=120),
    # A tile of 1/3 arc second, of which there are none larger.
    "SRTM tile": FileLimits(2 * 10_801**2, 10_801**2),
    "GeoJSON": FileLimits(128 * MIB, 4_000_000),
    "basemap": FileLimits(32 * MIB, 300_000, 8),
    "GPX or KML": FileLimits(64 * MIB, 4_000_000, 64, memory_mib=2048, seconds=60),
    "ULog": FileLimits(256 * MIB, 1000, 8, memory_mib=2048, seconds=60),
    "other flight": FileLimits(256 * MIB, 2_000_000),
    "recording": FileLimits(0, 0, memory_mib=2048, seconds=24 * 3600),
}
# Octets of content for each of a file's, and in any case: what grows more is made to use us up.
MOST_UNPACKED, SPARE_OCTETS = 256, 64 * MIB
# All that a process needs to know of ours: of tokens and passwords it is told none.
_ENVIRONMENT = (
    *("PATH", "PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "LD_LIBRARY_PATH", "SYSTEMROOT"),
    *("HOME", "USERPROFILE", "TMPDIR", "TEMP", "TMP", "LANG", "LC_ALL"),
)
_CONFINED = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",  # no file beside the one that is named
    "GDAL_PAM_ENABLED": "NO",
    "CPL_VSIL_CURL_ALLOWED_EXTENSIONS": ".none",
    "GDAL_HTTP_PROXY": "127.0.0.1:9",
    "PROJ_NETWORK": "OFF",
    "OPENBLAS_NUM_THREADS": "1",
}
_START = "from plotfeed.feeds.telemetry.foreign_files import main; main()"


def process_apart(start: str, *arguments: str) -> dict[str, Any]:
    """Words and environment, as `subprocess` takes them, of a process that runs Python's `start`.

    It is to confine itself, and to write what it finds; what it complains of is thrown away.
    """
    environment = {name: os.environ[name] for name in _ENVIRONMENT if name in os.environ}
    return {
        "args": [sys.executable, "-P", "-c", start, *arguments],
        "stderr": subprocess.DEVNULL,
        "env": environment | _CONFINED,
        "start_new_session": True,  # Ctrl-C is for us: who reads for us ends with us
    }


def broken_or_beyond(kind: str) -> str:
    """Why a process that read that kind has ended without a word, in a line."""
    limits = FILE_LIMITS[kind]
    return (
        f"reading it takes more than {limits.memory_mib} MiB or {limits.seconds} s of a "
        "processor, or breaks it"
    )


def why_not(kind: str, what: str, error: Exception) -> str:
    """Why a process that reads that kind finds nothing, in a line, by what its reader raised."""
    if isinstance(error, PlotfeedError):
        return str(error)
    if isinstance(error, MemoryError):
        return f"reading it takes more than {FILE_LIMITS[kind].memory_mib} MiB"
    line = " ".join(str(error).split())[:200] or type(error).__name__
    return f"not a {what} that can be read: {line}"


def file_octets(path: Path, kind: str) -> bytes:
    """All octets of a file of that kind; raises `PlotfeedError`."""
    most = FILE_LIMITS[kind].octets
    try:
        with path.open("rb") as file:
            is_larger = path.stat().st_size > most
            data = b"" if is_larger else file.read(most + 1)
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else None
        raise PlotfeedError(f"cannot be read: {why or error}") from error
    if is_larger or len(data) > most:
        raise PlotfeedError(f"larger than {most} octets, the most that is read")
    return data


def read_apart(kind: str, source: bytes | Path) -> Any:
    """What another process finds in octets, or in a file, of that kind; raises `PlotfeedError`.

    It is a tree of lists, texts, numbers and arrays, as the kind's function of `READERS` makes it.
    """
    limits = FILE_LIMITS[kind]
    path, data = ("", source) if isinstance(source, bytes) else (str(source.absolute()), b"")
    octets = len(source) if isinstance(source, bytes) else source.stat().st_size
    if octets > limits.octets:
        raise PlotfeedError(f"larger than {limits.octets} octets, the most that is read")
    with TemporaryFile() as out:
        try:
            started = process_apart(_START, kind, path)
            done = subprocess.run(
                **started, input=data, stdout=out, timeout=limits.seconds, check=False
            )
        except subprocess.TimeoutExpired:
            raise PlotfeedError(f"reading it takes more than {limits.seconds} s") from None
        out.seek(0)
        found = _found(out) if done.returncode == 0 else {}
    if "found" in found:
        return found["found"]
    raise PlotfeedError(found.get("error") or broken_or_beyond(kind))


def _found(file: BinaryIO) -> dict[str, Any]:
    """What a process wrote: a line of JSON, and behind it the octets of the arrays in it."""
    import numpy as np

    def array(tree: dict[str, Any]) -> Any:
        if tree.keys() != {"dtype", "shape"}:
            return tree
        shape = [int(n) for n in tree["shape"]]
        return np.fromfile(file, np.dtype(tree["dtype"]), int(np.prod(shape))).reshape(shape)

    try:
        found = json.loads(file.readline(), object_hook=array)
    except (ValueError, TypeError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


MARKUP, ULOG = FILE_LIMITS["GPX or KML"], FILE_LIMITS["ULog"]


class _Markup:
    """Takes points out of GPX and KML as a parser comes to them, and keeps nothing else."""

    def __init__(self) -> None:
        # Of GPX: texts of latitude, longitude, elevation and time.
        self.gpx: list[list[str | None]] = []
        # Of KML: texts of time and coordinates, these apart, and the altitude mode.
        self.kml: list[tuple[str, list[str], str]] = []
        # Of tracks with more times than places, or fewer: points before it, and both numbers.
        self.uneven: list[tuple[int, int, int]] = []
        self._open: list[str] = []
        self._elements = 0
        self._text: list[str] = []
        self._point: list[str | None] = []
        self._track: dict[str, list[str]] = {}
        # Texts of the placemark that is open, without track.
        self._mark: dict[str, str] | None = None

    def begin(self, name: str, attributes: dict[str, str]) -> None:
        """An element, with its prefix."""
        name = name.rpartition(":")[2]
        self._open.append(name)
        self._text.clear()
        self._elements += 1
        if len(self._open) > MARKUP.depth or self._elements > MARKUP.count:
            most = f"{MARKUP.depth} elements in each other, and {MARKUP.count} in all"
            raise PlotfeedError(f"at most {most}, are read")
        if name == "trkpt":
            self._point = [attributes.get("lat"), attributes.get("lon"), None, None]
        elif name == "Track":
            self._track, self._mark = {"when": [], "coord": [], "altitudeMode": []}, None
        elif name == "Placemark":
            self._mark = {}

    def end(self, _name: str) -> None:
        """The element that was begun last has ended."""
        name, text = self._open.pop(), "".join(self._text).strip()
        within = self._open[-1] if self._open else ""
        self._text.clear()
        if within == "trkpt" and name in {"ele", "time"}:
            self._point[3 if name == "time" else 2] = text
        elif name == "trkpt":
            self.gpx.append(self._point)
        elif within == "Track" and name in self._track:
            self._track[name].append(text)
        elif name == "Track":
            whens, places, modes = self._track.values()
            if len(whens) != len(places):
                self.uneven.append((len(self.kml), len(whens), len(places)))
            for when, place in zip(whens, places, strict=False):
                self.kml.append((when, place.split(), modes[0] if modes else ""))
        elif self._mark is not None and (name == "when" or within == "Point"):
            self._mark.setdefault(name, text)
        elif name == "Placemark" and self._mark is not None:
            mark = self._mark
            if mark.get("when") and "coordinates" in mark:
                at = mark["coordinates"].split(",")
                self.kml.append((mark["when"], at, mark.get("altitudeMode", "")))
            self._mark = None

    def more(self, text: str) -> None:
        """Text within an element."""
        self._text.append(text)

    def no_document_type(self, *_: object) -> None:
        """Raise `PlotfeedError` at one."""
        raise PlotfeedError("XML here has no document type; entities are not expanded")


def read_markup(data: Any) -> Mapping[str, Any]:
    """Points of GPX and KML, as texts; where it is cut short, those before that."""
    from xml.parsers import expat

    found, parser = _Markup(), expat.ParserCreate("utf-8")
    parser.StartElementHandler, parser.EndElementHandler = found.begin, found.end
    parser.CharacterDataHandler = found.more
    parser.StartDoctypeDeclHandler = found.no_document_type
    cut: list[Any] = []
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        if not (found.gpx or found.kml):
            raise
        cut = [parser.ErrorByteIndex, str(error), len(data) - parser.ErrorByteIndex]
    return {"gpx": found.gpx, "kml": found.kml, "uneven": found.uneven, "cut": cut}


ULOG_START = b"ULog\x01\x12\x35"
HEADER_OCTETS, MESSAGE_HEAD_OCTETS = 16, 3
# Of messages, as https://docs.px4.io/main/en/dev_log/ulog_file_format.html lists them.
KINDS = frozenset(bytes([octet]) for octet in b"BFIMPQARDLCSO")
ESTIMATE = "vehicle_global_position"
RECEIVERS = ("vehicle_gps_position", "sensor_gps")
TOPICS = (ESTIMATE, *RECEIVERS)
OLD_PLACE, PLACE = ("lat", "lon", "alt"), ("latitude_deg", "longitude_deg", "altitude_msl_m")
_FIELD = re.compile(r"\s*(\w+)(?:\[(\d+)\])?\s")


def read_ulog(data: Any) -> Mapping[str, Any]:
    """Columns of the first instance of each topic that has positions, and where damage begins."""
    from pyulog import ULog

    whole, end = _wanted_messages(data)
    with redirect_stdout(io.StringIO()):  # the library prints what it thinks of a file
        found = ULog(io.BytesIO(whole), list(TOPICS))
    topics: dict[str, Any] = {}
    for each in found.data_list:
        rows = each.data
        has_place = any({"timestamp", *names} <= rows.keys() for names in (OLD_PLACE, PLACE))
        if has_place and len(rows["timestamp"]) and each.name not in topics:
            topics[each.name] = rows
    return {"topics": topics, "end": end}


def _wanted_messages(data: bytes) -> tuple[bytes, int]:
    """The log with its whole messages of wanted topics alone; where the first damaged one is.

    The library seeks in what is damaged, for ever where it is cut short, and is slow in the rest.
    """
    parts, at, wanted = [data[:HEADER_OCTETS]], HEADER_OCTETS, set[bytes]()
    formats: dict[str, str] = {}
    while at + MESSAGE_HEAD_OCTETS <= len(data):
        kind = data[at + 2 : at + 3]
        body = at + MESSAGE_HEAD_OCTETS
        end = body + int.from_bytes(data[at : at + 2], "little")
        if kind not in KINDS or end > len(data):
            break
        if kind == b"B" and any(data[body + 8 : body + 16].lstrip(b"\x01")):
            raise PlotfeedError("a ULog file with flags that nobody knows: it cannot be read")
        if kind == b"F":
            name, _, fields = data[body:end].decode("latin-1").partition(":")
            formats[name] = fields
            parts.append(data[at:end])
        elif kind == b"A" and data[body + 3 : end].decode("latin-1") in TOPICS:
            wanted.add(data[body + 1 : body + 3])
            parts.append(data[at:end])
        elif kind == b"D" and data[body : body + 2] in wanted:
            parts.append(data[at:end])
        at = end

    @cache
    def fields_of(name: str, depth: int) -> int:
        """How many fields a type has with those in it; raises `PlotfeedError` at too many."""
        number = 0
        for told in filter(None, map(_FIELD.match, formats.get(name, "").split(";"))):
            is_plain = told[1] not in formats
            inner = 1 if is_plain or not depth else fields_of(told[1], depth - 1)
            number += max(inner, 1) * int(told[2] or 1)
            if number > ULOG.count or not (is_plain or depth):
                most = f"{ULOG.count} fields, in {ULOG.depth} types in each other"
                raise PlotfeedError(f"a ULog file with a topic of more than {most}")
        return number

    for topic in TOPICS:
        fields_of(topic, ULOG.depth)
    return b"".join(parts), at


def read_geotiff(path: Any) -> Mapping[str, Any]:
    """Heights of the first band of a GeoTIFF by latitude and longitude, whatever its projection.

    NaN where there are none; and its transform, from columns and rows to degrees.
    """
    import numpy as np
    import rasterio
    from rasterio.vrt import WarpedVRT

    limits, octets = FILE_LIMITS["GeoTIFF"], Path(path).stat().st_size
    with (
        warnings.catch_warnings(action="ignore"),  # of a file without a place, which then raises
        rasterio.open(path, driver="GTiff") as source,
        WarpedVRT(source, crs="EPSG:4326", resampling=rasterio.enums.Resampling.bilinear) as on,
    ):
        samples = max(on.width * on.height, source.width * source.height)
        if samples > limits.count:
            size = f"{on.width} by {on.height}"
            raise PlotfeedError(f"{size} samples: at most {limits.count} are taken")
        unpacked = samples * np.dtype(source.dtypes[0]).itemsize
        if unpacked > SPARE_OCTETS + MOST_UNPACKED * octets:
            raise PlotfeedError(f"it would grow to more than {MOST_UNPACKED} times its octets")
        heights = on.read(1, masked=True)
        real = np.result_type(heights.dtype, np.float32)  # whole numbers have no NaN
        return {
            "heights_m": heights.astype(real, copy=False).filled(np.nan),
            "place": list(on.transform)[:6],
        }


READERS: Mapping[str, Callable[[Any], Mapping[str, Any]]] = {
    "GPX or KML": read_markup,
    "ULog": read_ulog,
    "GeoTIFF": read_geotiff,
}


def found_in(kind: str, source: bytes | str) -> dict[str, Any]:
    """What the reader of that kind finds, as `found`; or why it finds nothing, as `error`."""
    try:
        return {"found": READERS[kind](source)}
    except Exception as error:  # noqa: BLE001 - of the libraries, which raise what they like
        return {"error": why_not(kind, f"{kind} file", error)}


def main() -> None:
    """Read the octets that come in, or the file that is named, and write what is found."""
    kind, path = sys.argv[1:]
    confine_process(FILE_LIMITS[kind].memory_mib * MIB, FILE_LIMITS[kind].seconds)
    arrays: list[Any] = []

    def described(array: Any) -> dict[str, Any]:
        arrays.append(array)
        return {"dtype": array.dtype.str, "shape": array.shape}

    found = found_in(kind, path or sys.stdin.buffer.read())
    sys.stdout.buffer.write(json.dumps(found, default=described).encode() + b"\n")
    for array in arrays:
        sys.stdout.buffer.write(array.tobytes())
    sys.stdout.buffer.flush()
