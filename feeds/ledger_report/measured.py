"""Plots as they were recorded: where they were measured to be, and how well by their own account.

Those of a sector can be told from others by the batch itself, or by the user properties of MQTT 5
that go with ASTERIX.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.message import DecodeError

from plotfeed.feeds.ledger_report.errors_tally import QUANTITIES
from plotfeed.models.state import Floats, Ints
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.plots_csv import rows_of
from plotfeed.replay.recorded import Recorded

KINDS = ("plots", "asterix/015", "asterix/048", "asterix/205")
"""Last levels of topics with plots, the most exact first."""
VALUES = ("range_m", "azimuth_deg", "elevation_deg")
SIGMAS = tuple(f"sigma_{name}" for name in VALUES)
NO_TIMES = np.zeros(0, np.int64)


class Sector(NamedTuple):
    """Which plots are meant."""

    prefix: str
    """Of the session's topics."""
    sensor: str
    scan: int
    sector: int


@dataclass(frozen=True, slots=True)
class Measured:
    """Plots of a sector, or those of them in one data block, in the order of their times."""

    block: int
    values: Floats
    """Slant range in metres, azimuth and elevation in degrees; (n, 3), NaN for none."""
    sigmas: Floats
    t_utc_ns: Ints
    """(n,); empty where times are not known exactly."""


def measured(message: Recorded, prefix: str, sensor: str) -> tuple[Sector, Measured] | None:
    """The plots of a message of that sensor; None if it cannot be read or placed."""
    if message.topic.endswith("/plots"):
        return _of_batch(message.payload, prefix, sensor)
    return _of_asterix(message, prefix, sensor)


def _of_batch(payload: bytes, prefix: str, sensor: str) -> tuple[Sector, Measured] | None:
    try:
        batch = pb.PlotBatch.FromString(payload)
    except DecodeError:
        return None
    plots = batch.plots
    values = [[_known(plot, name) for name in VALUES] for plot in plots]
    sigmas = [[_known(plot, name) for name in SIGMAS] for plot in plots]
    t_utc_ns = np.array([plot.time_utc_ns for plot in plots], np.int64)
    found = Measured(0, _table(values), _table(sigmas), t_utc_ns)
    return Sector(prefix, sensor, batch.scan, batch.sector), found


def _known(plot: pb.Plot, name: str) -> float:
    return getattr(plot, name) if plot.HasField(name) else math.nan


def _of_asterix(message: Recorded, prefix: str, sensor: str) -> tuple[Sector, Measured] | None:
    properties = dict(message.properties)
    rows = rows_of(message)
    try:
        sector = Sector(prefix, sensor, int(properties["scan"]), int(properties["sector"]))
        block = int(properties["id"].rpartition("-")[2])
    except (KeyError, ValueError):
        return None
    if rows is None:
        return None
    values, sigmas = _columns(rows, VALUES), _columns(rows, SIGMAS)
    return sector, Measured(block, values, sigmas, NO_TIMES)


def _columns(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> Floats:
    return _table([[_number(row.get(name)) for name in names] for row in rows])


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def _table(rows: Sequence[Sequence[float]]) -> Floats:
    return np.array(rows, np.float64).reshape(-1, len(QUANTITIES))
