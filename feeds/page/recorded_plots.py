"""Rows of recorded messages as the structures of arrays that a page shows.

Files come from anywhere: what no sensor could have measured is taken for not measured. Rows of many
sectors become columns at once, which is several times faster.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.message import DecodeError

from plotfeed.feeds.replay_settings import Moment
from plotfeed.models.state import FALSE_ALARM, Floats, Ints, Looks, Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.plots_csv import rows_of
from plotfeed.replay.recorded import Recorded

UNKNOWN_DRONE = -2
"""Of a plot of which nothing says whose it is; pages know it."""
MOST_M, MOST_DEG, MOST_DB = 1e7, 360.0, 300.0
NAN = float("nan")


class PlotRow(NamedTuple):
    """A plot as it was measured; NaN for what was not."""

    t_utc_ns: int
    range_m: float
    azimuth_deg: float
    elevation_deg: float
    height_m: float
    snr_db: float


class DroneNumbers:
    """Drones by their names, in the order in which they were first told of."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self._numbers: dict[str, int] = {}

    def of(self, name: str) -> int:
        """Its number."""
        number = self._numbers.get(name)
        if number is None:
            number = self._numbers[name] = len(self.names)
            self.names.append(name)
        return number


def rows_in(message: Recorded) -> list[PlotRow]:
    """The plots in a message; heights are told by protobuf alone, above the ellipsoid."""
    if message.topic.endswith("/plots"):
        try:
            batch = pb.PlotBatch.FromString(message.payload)
        except DecodeError:
            return []
        return [_of_protobuf(plot) for plot in batch.plots]
    return [_of_asterix(row, message) for row in rows_of(message) or []]


def plots_of(
    rows: Sequence[PlotRow], truths: Sequence[pb.PlotTruth], drones: DroneNumbers
) -> Plots:
    """Rows as columns, and whose they are as the ledger says in the same order."""
    merged = np.empty(len(truths), np.object_)
    merged[:] = [tuple(map(drones.of, truth.merged_drones)) for truth in truths]
    return Plots.of(
        t_utc_ns=_ints(truth.time_utc_ns for truth in truths),
        drone=_ints(drones.of(t.drone) if t.drone else FALSE_ALARM for t in truths),
        merged_drones=merged,
        true_range_m=_within(MOST_M, (t.range_m if t.drone else NAN for t in truths)),
        true_azimuth_deg=_within(MOST_DEG, (t.azimuth_deg if t.drone else NAN for t in truths)),
        true_elevation_deg=_within(MOST_DEG, (t.elevation_deg if t.drone else NAN for t in truths)),
        **_measured(rows),
    )


def nobody_s(rows: Sequence[PlotRow]) -> Plots:
    """Rows as columns, where nothing says whose they are."""
    drone = np.full(len(rows), UNKNOWN_DRONE)
    return Plots.of(t_utc_ns=_ints(row.t_utc_ns for row in rows), drone=drone, **_measured(rows))


def looks_of(looks: Sequence[pb.Look], drones: DroneNumbers) -> Looks:
    """What the ledger says that sensors looked at."""
    return Looks(
        drone=_ints(drones.of(look.drone) for look in looks),
        channel=_ints(look.channel for look in looks),
        t_utc_ns=_ints(look.time_utc_ns for look in looks),
        range_m=np.nan_to_num(_within(MOST_M, (look.range_m for look in looks))),
        azimuth_deg=_within(MOST_DEG, (look.azimuth_deg for look in looks)),
        elevation_deg=_within(MOST_DEG, (look.elevation_deg for look in looks)),
        snr=_ratio(look.snr_db for look in looks),
        pd=np.nan_to_num(_within(1.0, (look.pd for look in looks))).clip(0.0),
        detected=np.array([look.detected for look in looks], np.bool_),
    )


def _of_protobuf(plot: pb.Plot) -> PlotRow:
    has = plot.HasField
    return PlotRow(
        plot.time_utc_ns,
        plot.range_m if has("range_m") else NAN,
        plot.azimuth_deg if has("azimuth_deg") else NAN,
        plot.elevation_deg if has("elevation_deg") else NAN,
        plot.height_m if has("height_m") else NAN,
        plot.snr_db if has("snr_db") else NAN,
    )


def _of_asterix(row: dict[str, Any], message: Recorded) -> PlotRow:
    """Of the time that its record says, or at which the message was due."""
    utc_ns = Moment.parse(row["time_utc"]).utc_ns if row.get("time_utc") else None
    return PlotRow(
        message.publish_time_ns if utc_ns is None else utc_ns,
        row.get("range_m", NAN),
        row.get("azimuth_deg", NAN),
        row.get("elevation_deg", NAN),
        NAN,
        row.get("snr_db", NAN),
    )


def _measured(rows: Sequence[PlotRow]) -> dict[str, Floats]:
    return {
        "range_m": _within(MOST_M, (row.range_m for row in rows)),
        "azimuth_deg": _within(MOST_DEG, (row.azimuth_deg for row in rows)),
        "elevation_deg": _within(MOST_DEG, (row.elevation_deg for row in rows)),
        "height_m": _within(MOST_M, (row.height_m for row in rows)),
        "snr": _ratio(row.snr_db for row in rows),
    }


def _ints(values: Iterable[int]) -> Ints:
    return np.fromiter(values, np.int64)


def _within(most: float, values: Iterable[float]) -> Floats:
    column = np.fromiter(values, np.float64)
    return np.where(np.abs(column) <= most, column, np.nan)


def _ratio(decibels: Iterable[float]) -> Floats:
    ratio: Floats = 10.0 ** (_within(MOST_DB, decibels) / 10.0)
    return ratio
