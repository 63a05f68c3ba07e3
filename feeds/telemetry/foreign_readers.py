"""Readers that run in a process of their own, and nothing but them: rasters, ULog, GPX and KML.

Each takes the octets or the path of a file, and gives what `read_apart` hands on.
"""

from __future__ import annotations

import io
import json
import re
import sys
import warnings
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from plotfeed.feeds.console.posix import confine_process
from plotfeed.feeds.telemetry.foreign_files import (
    FILE_LIMITS,
    MIB,
    MOST_UNPACKED,
    SPARE_OCTETS,
    why_not,
)
from plotfeed.proto.errors import PlotfeedError

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


def read_markup(data: Any) -> Mapping[str, Any]:
    """Points of GPX and KML, as texts; where it is cut short, those before that."""
    from xml.parsers import expat

    found, parser = _Markup(), expat.ParserCreate("utf-8")
    parser.StartElementHandler, parser.EndElementHandler = found.begin, found.end
    parser.CharacterDataHandler = found.more
    parser.StartDoctypeDeclHandler = _no_document_type
    cut: list[Any] = []
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        if not (found.gpx or found.kml):
            raise
        cut = [parser.ErrorByteIndex, str(error), len(data) - parser.ErrorByteIndex]
    return {"gpx": found.gpx, "kml": found.kml, "uneven": found.uneven, "cut": cut}


def _no_document_type(*_: object) -> None:
    raise PlotfeedError("XML here has no document type; entities are not expanded")


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
    known: dict[tuple[str, int], int] = {}
    for topic in TOPICS:
        _fields_of(topic, ULOG.depth, formats, known)
    return b"".join(parts), at


def _fields_of(
    name: str, depth: int, formats: Mapping[str, str], known: dict[tuple[str, int], int]
) -> int:
    """How many fields a type has with those in it; raises `PlotfeedError` where it is too many."""
    if (name, depth) not in known:
        number = 0
        for told in filter(None, map(_FIELD.match, formats.get(name, "").split(";"))):
            is_plain = told[1] not in formats
            inner = 1 if is_plain or not depth else _fields_of(told[1], depth - 1, formats, known)
            number += max(inner, 1) * int(told[2] or 1)
            if number > ULOG.count or not (is_plain or depth):
                most = f"{ULOG.count} fields, in {ULOG.depth} types in each other"
                raise PlotfeedError(f"a ULog file with a topic of more than {most}")
        known[name, depth] = number
    return known[name, depth]


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
