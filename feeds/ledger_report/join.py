"""Plots joined with what is true of them: by sensor, scan and sector, and there by their order."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plotfeed.feeds.ledger_report.errors_tally import ErrorsTally
from plotfeed.feeds.ledger_report.measured import VALUES, Measured, Sector
from plotfeed.models.state import Bools, Floats, Ints
from plotfeed.proto import plotfeed_pb2 as pb

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
        self._plots: OrderedDict[Sector, dict[int, Measured]] = OrderedDict()
        self._truths: OrderedDict[Sector, tuple[Truth, ErrorsTally]] = OrderedDict()
        self._waiting_plots = self._waiting_truths = 0

    def add_plots(self, sector: Sector, found: Measured) -> None:
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

    def add_truth(self, sector: Sector, truth: Truth, errors: ErrorsTally) -> None:
        """Take what is true of a sector's plots; their errors are counted where it says."""
        if not len(truth) or sector in self._truths:
            return
        self._truths[sector] = truth, errors
        self._waiting_truths += len(truth)
        self._meet(sector)
        while self._waiting_truths > MAX_WAITING_PLOTS and self._truths:
            _, (given_up, _) = self._truths.popitem(last=False)
            self._waiting_truths -= len(given_up)

    def _meet(self, sector: Sector) -> None:
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
