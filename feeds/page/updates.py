"""Updates: what a browser is told of a session, one WebSocket message each.

An update is little-endian. Its header is `PLF1`, flags (uint32), its number (uint64) and the
session's time in milliseconds of UTC (float64). Sections follow to its end. A section has a header
of its kind, its rows, the number of its first row and the octets of its body (four uint32), and
then its columns one after the other, each filled up with zeros to a multiple of 8 octets, so that a
browser lays typed arrays over them without copying. A reader skips kinds that it does not know.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from enum import IntEnum, IntFlag

import numpy as np
from numpy.typing import ArrayLike

MAGIC = b"PLF1"
HEADER = struct.Struct("<4sIQd")
SECTION = struct.Struct("<4I")
ALIGNMENT = 8
COUNT_MASK = 0xFFFF_FFFF
"""Numbers of rows begin again after this."""


class UpdateFlag(IntFlag):
    """What an update is."""

    SNAPSHOT = 1
    """All that there is to see: what came before is forgotten."""


class SectionKind(IntEnum):
    """What a section holds."""

    NEWS = 1
    """JSON in UTF-8: one object whose keys replace those of earlier news."""
    PLOTS = 2
    """Plots as they were delivered."""
    PLOT_TRUTHS = 3
    """Of the plots with the same numbers: whose they are. Only for who asks for the truth."""
    LOST_PLOTS = 4
    """Plots that no message brought; their latency is NaN. Only for who asks for the truth."""
    DRONES = 5
    """Every drone that there is or lately was. Only for who asks for the truth."""
    TRACKS = 6
    """News of tracks of the tracker under test."""
    TRUE_NEWS = 7
    """As NEWS. Only for who asks for the truth."""


class PlotFlag(IntFlag):
    """What there is to know of a plot beside its numbers."""

    BEARING = 1
    """It has no range: east and north are where its ray leaves the sensor's cover."""
    NOWHERE = 2
    """It has no direction either: something was noticed, and that is all."""


class TrackFlag(IntFlag):
    """The state of a track."""

    TENTATIVE = 1
    COASTED = 2
    ENDED = 4


_PLOT = (
    ("t_utc_ms", "f8"),
    ("east_m", "f4"),
    ("north_m", "f4"),
    ("range_m", "f4"),
    ("azimuth_deg", "f4"),
    ("elevation_deg", "f4"),
    ("height_m", "f4"),
    ("snr_db", "f4"),
    ("latency_ms", "f4"),
    ("sensor", "u2"),
    ("flags", "u1"),
)
_TRUTH = (
    ("true_east_m", "f4"),
    ("true_north_m", "f4"),
    ("true_range_m", "f4"),
    ("true_azimuth_deg", "f4"),
    ("true_elevation_deg", "f4"),
    ("drone", "i4"),
    ("merged", "u1"),
)
LAYOUTS: Mapping[SectionKind, tuple[tuple[str, str], ...]] = {
    SectionKind.PLOTS: _PLOT,
    SectionKind.PLOT_TRUTHS: _TRUTH,
    SectionKind.LOST_PLOTS: (*_PLOT, *_TRUTH),
    SectionKind.DRONES: (
        ("drone", "u4"),
        ("east_m", "f4"),
        ("north_m", "f4"),
        ("up_m", "f4"),
        ("velocity_east_m_s", "f4"),
        ("velocity_north_m_s", "f4"),
        ("gone_ms", "f4"),
    ),
    SectionKind.TRACKS: (
        ("t_utc_ms", "f8"),
        ("track", "u4"),
        ("east_m", "f4"),
        ("north_m", "f4"),
        ("velocity_east_m_s", "f4"),
        ("velocity_north_m_s", "f4"),
        ("flags", "u1"),
    ),
}
"""Columns and their types, as NumPy writes them. East and north are from the site, along its own
horizontal. NaN is for what is not known; `gone_ms` of a drone that is there is 0, `drone` of a
false alarm -1, and `merged` counts the drones besides."""


def header(number: int, now_utc_ns: int, flags: int = 0) -> bytes:
    """The beginning of an update."""
    return HEADER.pack(MAGIC, flags, number, now_utc_ns / 1e6)


def section(kind: SectionKind, columns: Mapping[str, ArrayLike], first: int = 0) -> bytes:
    """Rows of that kind; no octet if there are none."""
    typed = [np.asarray(columns[name], dtype=f"<{dtype}") for name, dtype in LAYOUTS[kind]]
    rows = len(typed[0])
    if not rows:
        return b""
    if any(len(column) != rows for column in typed):
        raise ValueError("columns of a section are equally long")
    body = b"".join(_aligned(column.tobytes() for column in typed))
    return SECTION.pack(kind, rows, first & COUNT_MASK, len(body)) + body


def news(text: bytes, kind: SectionKind = SectionKind.NEWS) -> bytes:
    """A section of JSON; its rows are its octets."""
    body = b"".join(_aligned([text]))
    return SECTION.pack(kind, len(text), 0, len(body)) + body


def _aligned(columns: Iterable[bytes]) -> Iterable[bytes]:
    for column in columns:
        yield column
        yield bytes(-len(column) % ALIGNMENT)
