"""Recorded plots joined with what is true of them: by sensor, scan and sector."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from plotfeed.feeds.report.error_tally import ErrorsTally
from plotfeed.models.state import Bools, Floats, Ints
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.measured_plots import MeasuredPlots, batch_in, plots_of_batch
from plotfeed.replay.plots_csv import plots_in
from plotfeed.replay.recorded import Recorded

KINDS = ("plots", "asterix/015", "asterix/048", "asterix/205")
"""Last levels of topics with plots, the most exact first."""
VALUES = ("range_m", "azimuth_deg", "elevation_deg")
SIGMAS = tuple(f"sigma_{name}" for name in VALUES)
NO_TIMES = np.zeros(0, np.int64)


class SectorKey(NamedTuple):
    """Which plots are meant."""

    prefix: str
    """Of the session's topics."""
    sensor: str
    scan: int
    sector: int


@dataclass(frozen=True, slots=True)
class RecordedPlots:
    """Plots of a sector, or those of them in one data block, in the order of their times."""

    block: int
    values: Floats
    """Slant range in metres, azimuth and elevation in degrees; (n, 3), NaN for none."""
    sigmas: Floats
    t_utc_ns: Ints
    """(n,); empty where times are not known exactly."""


def measured(message: Recorded, prefix: str, sensor: str) -> tuple[SectorKey, RecordedPlots] | None:
    """The plots of a message of that sensor; None if it cannot be read or placed."""
    if message.topic.endswith("/plots"):
        return _of_batch(message.payload, prefix, sensor)
    return _of_asterix(message, prefix, sensor)


def _of_batch(payload: bytes, prefix: str, sensor: str) -> tuple[SectorKey, RecordedPlots] | None:
    try:
        batch = batch_in(payload)
    except DecodeError:
        return None
    plots = plots_of_batch(batch)
    sector = SectorKey(prefix, sensor, batch.scan, batch.sector)
    return sector, _recorded(0, plots, plots.t_utc_ns.astype(np.int64))


def _of_asterix(
    message: Recorded, prefix: str, sensor: str
) -> tuple[SectorKey, RecordedPlots] | None:
    properties = dict(message.properties)
    plots = plots_in(message)
    try:
        sector = SectorKey(prefix, sensor, int(properties["scan"]), int(properties["sector"]))
        block = int(properties["id"].rpartition("-")[2])
    except (KeyError, ValueError):
        return None
    return None if plots is None else (sector, _recorded(block, plots, NO_TIMES))


def _recorded(block: int, plots: MeasuredPlots, t_utc_ns: Ints) -> RecordedPlots:
    values, sigmas = ([getattr(plots, name) for name in names] for names in (VALUES, SIGMAS))
    return RecordedPlots(block, np.stack(values, axis=1), np.stack(sigmas, axis=1), t_utc_ns)


MAX_WAITING_PLOTS = 200_000
"""Plots without their truth, and truths without their plots; then the oldest are given up."""


@dataclass(frozen=True, slots=True)
class Truth:
    """Of a sector's plots, in their order."""

    values: Floats
    """Slant range in metres, azimuth and elevation in degrees; (n, 3)."""
    of_drone: Bools
    """(n,); the others are false alarms."""
    t_utc_ns: Ints

    @classmethod
    def of(cls, plots: Sequence[pb.PlotTruth]) -> Truth:
        """As the ledger has it."""
        rows = [
            [getattr(plot, name) if plot.HasField(name) else math.nan for name in VALUES]
            for plot in plots
        ]
        return cls(
            np.array(rows, np.float64).reshape(-1, len(VALUES)),
            np.array([bool(plot.drone) for plot in plots], np.bool_),
            np.array([plot.time_utc_ns for plot in plots], np.int64),
        )

    def __len__(self) -> int:
        return len(self.of_drone)


class Join:
    """Holds what has come of a sector until all of it is there; the ledger comes last as a rule."""

    def __init__(self) -> None:
        self._plots: OrderedDict[SectorKey, dict[int, RecordedPlots]] = OrderedDict()
        self._truths: OrderedDict[SectorKey, tuple[Truth, ErrorsTally]] = OrderedDict()
        self._waiting_plots = self._waiting_truths = 0

    def add_plots(self, sector: SectorKey, found: RecordedPlots) -> None:
        """Take the plots of a message."""
        if not len(found.values):
            return
        blocks = self._plots.setdefault(sector, {})
        if found.block in blocks:  # a duplicate
            return
        blocks[found.block] = found
        self._waiting_plots += len(found.values)
        if sector in self._truths:
            self._meet(sector)
        while self._waiting_plots > MAX_WAITING_PLOTS and self._plots:
            _, given_up = self._plots.popitem(last=False)
            self._waiting_plots -= sum(len(block.values) for block in given_up.values())

    def add_truth(self, sector: SectorKey, truth: Truth, errors: ErrorsTally) -> None:
        """Take what is true of a sector's plots; their errors are counted where it says."""
        if not len(truth) or sector in self._truths:
            return
        self._truths[sector] = truth, errors
        self._waiting_truths += len(truth)
        self._meet(sector)
        while self._waiting_truths > MAX_WAITING_PLOTS and self._truths:
            _, (given_up, _) = self._truths.popitem(last=False)
            self._waiting_truths -= len(given_up)

    def _meet(self, sector: SectorKey) -> None:
        """Join them if all are there; if they contradict each other, they are as good as lost."""
        truth, errors = self._truths[sector]
        blocks = self._plots.get(sector, {})
        count = sum(len(block.values) for block in blocks.values())
        if count < len(truth):
            return
        del self._plots[sector], self._truths[sector]
        self._waiting_plots -= count
        self._waiting_truths -= len(truth)
        if count != len(truth):
            return
        parts = [blocks[number] for number in sorted(blocks)]
        times_ns = np.concatenate([part.t_utc_ns for part in parts])
        if len(times_ns) and not np.array_equal(times_ns, truth.t_utc_ns):
            return
        values = np.concatenate([part.values for part in parts])
        sigmas = np.concatenate([part.sigmas for part in parts])
        true = truth.of_drone
        errors.add(values[true], sigmas[true], truth.values[true])
