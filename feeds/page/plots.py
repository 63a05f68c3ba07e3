"""Plots for the page: placed, and kept while they fade for whoever joins late."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from plotfeed.feeds.page.frames import Kind, PlotFlag, section
from plotfeed.feeds.page.placements import Placements
from plotfeed.models.state import Floats, Ints, Plots
from plotfeed.proto.batch import decibels

KEPT_NS = 60_000_000_000
"""Plots that arrived longer ago are seen no more, however slowly a page lets them fade."""
MAX_KEPT = 30_000
"""Plots for whoever joins late; older ones give way."""
MAX_WAITING = 100_000
"""Plots between two updates; what comes on top is not shown."""
MAX_MERGED = 255


class _Arrived(NamedTuple):
    sensor: int
    plots: Plots
    sent_utc_ns: int
    """0 for what no message brought."""


@dataclass(frozen=True, slots=True)
class _Kept:
    at_utc_ns: int
    rows: int
    public: bytes
    truth: bytes


class PlotStore:
    """Plots of a scene, from when it is known what became of them until they have faded."""

    def __init__(self, placements: Placements) -> None:
        self._placements = placements
        self._waiting: list[_Arrived] = []
        self._rows_waiting = 0
        self._kept: deque[_Kept] = deque()
        self._rows_kept = 0
        self._next_number = 0

    def take(self, sensor: int, plots: Plots, sent_utc_ns: int | None) -> None:
        """Plots of a sensor by number, and when a message brought them; None if none did."""
        if len(plots) and self._rows_waiting < MAX_WAITING:
            self._waiting.append(_Arrived(sensor, plots, sent_utc_ns or 0))
            self._rows_waiting += len(plots)

    def sections(self, now_utc_ns: int) -> tuple[bytes, bytes]:
        """What is new since the last call: for everybody, and for who sees the truth besides."""
        waiting, self._waiting = self._waiting, []
        rows, self._rows_waiting = self._rows_waiting, 0
        brought = [part for part in waiting if part.sent_utc_ns]
        lost = [part for part in waiting if not part.sent_utc_ns]
        public = truth = b""
        if brought:
            columns = self._columns(brought)
            public = section(Kind.PLOTS, columns, self._next_number)
            truth = section(Kind.PLOT_TRUTHS, columns, self._next_number)
            self._next_number += len(columns["sensor"])
        if lost:
            truth += section(Kind.LOST_PLOTS, self._columns(lost))
        if waiting:
            self._keep(_Kept(now_utc_ns, rows, public, truth))
        self._forget_before(now_utc_ns - KEPT_NS)
        return public, truth

    def kept(self) -> tuple[bytes, bytes]:
        """The same for all plots that have not faded."""
        return b"".join(k.public for k in self._kept), b"".join(k.truth for k in self._kept)

    def _columns(self, parts: Sequence[_Arrived]) -> dict[str, Floats | Ints]:
        """Columns of every layout of plots, (n,)."""
        plots = Plots.joined([part.plots for part in parts])
        lengths = [len(part.plots) for part in parts]
        sensor = np.repeat(np.array([part.sensor for part in parts]), lengths)
        sent_utc_ns = np.repeat(np.array([part.sent_utc_ns for part in parts]), lengths)
        east_m, north_m = self._placements.places_m(
            sensor, plots.azimuth_deg, plots.elevation_deg, plots.range_m
        )
        true_east_m, true_north_m = self._placements.places_m(
            sensor, plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m
        )
        return {
            "t_utc_ms": plots.t_utc_ns / 1e6,
            "east_m": east_m,
            "north_m": north_m,
            "range_m": plots.range_m,
            "azimuth_deg": plots.azimuth_deg,
            "elevation_deg": plots.elevation_deg,
            "height_m": plots.height_m,
            "snr_db": decibels(plots.snr),
            "latency_ms": np.where(sent_utc_ns, (sent_utc_ns - plots.t_utc_ns) / 1e6, np.nan),
            "sensor": sensor,
            "flags": _flags(plots),
            "true_east_m": true_east_m,
            "true_north_m": true_north_m,
            "true_range_m": plots.true_range_m,
            "true_azimuth_deg": plots.true_azimuth_deg,
            "true_elevation_deg": plots.true_elevation_deg,
            "drone": plots.drone,
            "merged": _merged(plots),
        }

    def _keep(self, kept: _Kept) -> None:
        self._kept.append(kept)
        self._rows_kept += kept.rows
        while self._rows_kept > MAX_KEPT and len(self._kept) > 1:
            self._rows_kept -= self._kept.popleft().rows

    def _forget_before(self, t_utc_ns: int) -> None:
        while self._kept and self._kept[0].at_utc_ns < t_utc_ns:
            self._rows_kept -= self._kept.popleft().rows


def _flags(plots: Plots) -> Ints:
    nowhere = np.isnan(plots.azimuth_deg)
    bearing = np.isnan(plots.range_m) & ~nowhere
    flags: Ints = bearing * int(PlotFlag.BEARING) + nowhere * int(PlotFlag.NOWHERE)
    return flags


def _merged(plots: Plots) -> Ints:
    """How many more drones are behind each plot; (n,)."""
    others = plots.merged_drones
    if others is None:
        return np.zeros(len(plots), np.int64)
    return np.fromiter((min(len(o), MAX_MERGED) for o in others), np.int64, len(plots))
