"""Horizons of a recording: slopes of ground and walls about the places of its sensors."""

from __future__ import annotations

import zlib
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

# Of horizons in a recording: octets, parts of the circle, and what no edge is as far as.
MOST_OCTETS, MOST_PARTS, FURTHER_M = 1 << 30, 3600, 4e6
STEP = np.dtype([("place", "<u4"), ("azimuth", "<u4"), ("distance_m", "<f4"), ("slope", "<f4")])


class RecordedHorizon(NamedTuple):
    """Steps about a place, by azimuth and distance: each is the highest from there on."""

    latitude_deg: float
    longitude_deg: float
    height_m: float
    parts: int  # Of the circle
    steps: NDArray[Any]  # Of `STEP`


def read_horizons(path: Path) -> list[RecordedHorizon]:
    """Horizons as a recording has them; none of what is damaged, since anybody may have made it."""
    unpacked = zlib.decompressobj()
    try:
        told = unpacked.decompress(path.read_bytes(), MOST_OCTETS)
        count = int(np.frombuffer(told, "<u4", 1)[0])
        heads = np.frombuffer(told, "<f8", 4 * count, 4).reshape(-1, 4)
        steps = np.frombuffer(told, STEP, offset=4 + heads.nbytes)
    except (ValueError, zlib.error):
        return []
    lat, lon, _, parts = heads.T
    at_all = (np.abs(lat) <= 90) & (np.abs(lon) <= 360) & (parts >= 1) & (parts <= MOST_PARTS)
    edges = (steps["distance_m"] > 0) & (steps["distance_m"] < FURTHER_M)
    edges &= (steps["place"] < count) & np.isfinite(steps["slope"])
    if not (np.isfinite(heads).all() and at_all.all() and edges.all() and unpacked.eof):
        return []
    steps = steps[np.lexsort((steps["distance_m"], steps["azimuth"], steps["place"]))]
    first = np.searchsorted(steps["place"], np.arange(count + 1)).tolist()
    return [
        RecordedHorizon(lat, lon, height_m, int(parts), steps[start:end])
        for (lat, lon, height_m, parts), (start, end) in zip(
            heads.tolist(), pairwise(first), strict=True
        )
    ]
