"""Errors of one sensor's plots: what was measured beside what its scene asked it to measure."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from plotfeed.feeds.recording.recorded_session import (
    SectorKey,
    Truth,
    WaitingPlots,
    name_in,
    sector_plots,
    target_of,
)
from plotfeed.feeds.report.asked_sensors import AskedSensor
from plotfeed.feeds.report.expected_plots import (
    QUANTITIES,
    Comparison,
    TrueEchoes,
    TruePlots,
    compared,
)
from plotfeed.models.tail_chances import p_of_normal, p_of_squares
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.replay.recorded import Recorded

AT_ONCE = 1024
STEP = 0.25
FURTHEST = 6.0
"""In standard deviations; what is further counts with the last cells."""
EDGES = np.arange(-FURTHEST, FURTHEST + STEP, STEP)
FEWEST = 20
"""Plots, or as many as tell as much, from which on sums of errors are judged."""
FINEST = 0.05
"""Share of a format's step below which noise is lost in it."""
ROUNDING = 1e-12
"""Variance below which there is no noise but that of arithmetic."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorFigures:
    """Errors of one quantity, over the plots of drones that were joined with their truth."""

    quantity: str
    unit: str
    plots: int
    mean: float
    """Measured less what was to be expected."""
    rms: float
    stated: int
    """Plots that state a standard deviation."""
    stated_rms: float
    """Root of the mean of the variances that they state."""
    compared: int
    """Plots of which it is known how errors scatter; what follows is of these."""
    normalised_mean: float
    """Of errors over their standard deviations, steps of the format included; 0 is asked."""
    normalised_rms: float
    """1 is asked."""
    within_2: float
    """Share within two standard deviations; 0.954 is asked."""
    z_mean: float
    z_rms: float
    p_mean: float
    """Probability of such a mean, or one further off, by chance."""
    p_rms: float
    off: int
    """Plots further off than any noise leaves them."""
    histogram: Sequence[int]
    """Normalised errors between the report's `normalised_edges`, what is beyond in the last."""


class SectorTruth(NamedTuple):
    """What is true of the plots of drones in a sector, and what their sensor was asked for."""

    whole: Truth
    """Of all its plots, false alarms too."""
    echoes: TrueEchoes
    plots: TruePlots
    asked: AskedSensor | None

    @classmethod
    def of(cls, entry: pb.Ledger, asked: AskedSensor | None) -> SectorTruth:
        """The truth as an entry of the ledger has it."""
        looks: dict[str, list[pb.Look]] = {}
        if any(p.merged_drones for p in entry.plots) or any(
            look.HasField("emitted_utc_ns") for look in entry.looks[:1]
        ):
            for look in entry.looks:
                looks.setdefault(name_in(look), []).append(look)
        echoes: list[tuple[float, ...]] = []
        plots: list[tuple[float, ...]] = []
        times_ns: list[int] = []
        for plot in entry.plots:
            if not target_of(plot):
                continue
            n = len(times_ns)
            drones = (name_in(plot), *plot.merged_drones)
            times_ns.append(plot.time_utc_ns)
            rate_m_s = plot.range_rate_m_s if plot.HasField("range_rate_m_s") else math.nan
            plots.append((len(drones), rate_m_s))
            echoes += _echoes(n, plot, drones, looks)
        table = np.array(echoes, np.float64).reshape(-1, 6).T
        of_plots = np.array(plots, np.float64).reshape(-1, 2).T
        return cls(
            Truth.of(entry.plots),
            TrueEchoes(
                plot=table[0].astype(np.int64),
                channel=table[1].astype(np.int64),
                azimuth_deg=table[2],
                elevation_deg=table[3],
                range_m=table[4],
                weight=table[5],
            ),
            TruePlots(
                t_utc_ns=np.array(times_ns, np.int64),
                drones=of_plots[0].astype(np.int64),
                range_rate_m_s=of_plots[1],
            ),
            asked,
        )


def _echoes(
    n: int, plot: pb.PlotTruth, drones: Sequence[str], looks: Mapping[str, Sequence[pb.Look]]
) -> list[tuple[float, ...]]:
    """Where the drones in the n-th plot were: by the looks, where the plot's truth is another."""
    if len(drones) > 1:
        return [
            (n, look.channel, *_place(look), 10 ** (look.snr_db / 10))
            for drone in drones
            for look in looks.get(drone, ())
        ]
    for look in looks.get(name_in(plot), ()):
        if look.HasField("emitted_utc_ns") and look.time_utc_ns == plot.time_utc_ns:
            return [(n, -1, *_place(look), 1.0)]
    return [(n, -1, *_place(plot), 1.0)]


def _place(of: pb.Look | pb.PlotTruth) -> tuple[float, float, float]:
    return of.azimuth_deg, of.elevation_deg, of.range_m


class ErrorsTally:
    """Errors of one sensor's plots."""

    def __init__(self) -> None:
        self.joined = 0
        """Plots with their truth, false alarms left out."""
        self.contradicted = 0
        """Plots of drones in sectors of which others were recorded than the ledger has."""
        self.left_out = 0
        """Plots of which it is not known what they were to say."""
        self.times_off = 0
        """Plots whose time is not the one that was asked for."""
        self._gathered: dict[tuple[int, int], list[tuple[SectorTruth, MeasuredPlots]]] = {}
        self._waiting = 0
        n = len(QUANTITIES)
        self._sums = np.zeros((n, 11))
        self._off = np.zeros(n, np.int64)
        self._histograms = np.zeros((n, len(EDGES) - 1), np.int64)

    def add(self, truth: SectorTruth, measured: MeasuredPlots) -> None:
        """Take the plots of drones in a sector."""
        if not len(measured):
            return
        self.joined += len(measured)
        key = id(truth.asked), int(measured.category[0])
        self._gathered.setdefault(key, []).append((truth, measured))
        self._waiting += len(measured)
        if self._waiting >= AT_ONCE:
            self.count()

    def count(self) -> None:
        """Count what has been gathered."""
        with np.errstate(all="ignore"):  # whatever numbers others have recorded
            for parts in self._gathered.values():
                self._count(_compared(parts))
        self._gathered.clear()
        self._waiting = 0

    def _count(self, found: Comparison) -> None:
        self.left_out += found.left_out
        self.times_off += found.off.get("time", 0)
        for i, name in enumerate(QUANTITIES):
            if name not in found.errors:
                continue
            error, law, stated = found.errors[name], found.expected[name], found.stated[name]
            self._off[i] += found.off.get(name, 0)
            there = np.isfinite(error)
            noisy = law.variance > max((FINEST * law.step) ** 2, ROUNDING)
            judged = there & noisy & np.isfinite(law.variance) & np.isfinite(law.kurtosis)
            normalised = (error / np.sqrt(law.variance))[judged]
            kurtosis, told = law.kurtosis[judged], stated[there & (stated >= 0) & (stated < 1e300)]
            error = error[there]
            self._sums[i] += (
                len(error),
                error.sum(),
                error @ error,
                len(told),
                told @ told,
                len(normalised),
                normalised.sum(),
                normalised @ normalised,
                (np.abs(normalised) <= 2).sum(),
                kurtosis.sum(),
                (kurtosis - 1).sum(),
            )
            cells = np.clip((normalised + FURTHEST) / STEP, 0, len(EDGES) - 2).astype(np.int64)
            self._histograms[i] += np.bincount(cells, minlength=len(EDGES) - 1)

    def figures(self) -> list[ErrorFigures]:
        """Figures of every quantity that was measured."""
        return [
            self._figures(i, name, unit)
            for i, (name, (_, unit)) in enumerate(QUANTITIES.items())
            if self._sums[i, 0]
        ]

    def _figures(self, i: int, name: str, unit: str) -> ErrorFigures:
        n, error, error2, stated, sigma2, *normalised = self._sums[i].tolist()
        of, total, squares, within, kurtosis, spread = normalised

        def mean(of_all: float) -> float:
            return of_all / of if of else math.nan

        # As many normal numbers vary as much: of those the fourth moment is 3.
        enough = of >= FEWEST and 3 * of**2 >= FEWEST * kurtosis
        spreads = enough and spread > 1e-6 * of  # what is told as one of two steps does not
        return ErrorFigures(
            quantity=name,
            unit=unit,
            plots=round(n),
            mean=error / n,
            rms=math.sqrt(error2 / n),
            stated=round(stated),
            stated_rms=math.sqrt(sigma2 / stated) if stated else math.nan,
            compared=round(of),
            normalised_mean=mean(total),
            normalised_rms=math.sqrt(mean(squares)),
            within_2=mean(within),
            z_mean=total / math.sqrt(of) if enough else math.nan,
            z_rms=(squares - of) / math.sqrt(spread) if spreads else math.nan,
            p_mean=p_of_normal(total / math.sqrt(of)) if enough else math.nan,
            p_rms=p_of_squares(squares, of, spread) if spreads else math.nan,
            off=int(self._off[i]),
            histogram=self._histograms[i].tolist(),
        )


def _compared(parts: Sequence[tuple[SectorTruth, MeasuredPlots]]) -> Comparison:
    """Plots of one sensor in several sectors, as it was while its keys stayed the same."""
    first = np.cumsum([0, *(len(truth.plots) for truth, _ in parts)]).tolist()
    echoes = [
        truth.echoes.but(plot=truth.echoes.plot + at)
        for (truth, _), at in zip(parts, first, strict=False)
    ]
    return compared(
        parts[0][0].asked,
        TrueEchoes.joined(echoes),
        TruePlots.joined([truth.plots for truth, _ in parts]),
        MeasuredPlots.joined([measured for _, measured in parts]),
    )


MAX_WAITING_TRUTHS = 200_000
"""Plots whose truth waits for what was measured; then the oldest are given up."""


class MeasuredBesideTruth:
    """Holds what has come of a sector until all of it is there; the ledger comes last as a rule."""

    def __init__(self) -> None:
        self._plots = WaitingPlots()
        self._truths: OrderedDict[SectorKey, tuple[SectorTruth, ErrorsTally]] = OrderedDict()
        self._waiting = 0

    def add_message(self, message: Recorded, prefix: str, sensor: str) -> None:
        """Take the plots of a message; one that cannot be read or placed is passed over."""
        found = sector_plots(message, prefix, sensor)
        if found is not None:
            self._plots.add(found)
            self._meet(found.key)

    def add_truth(self, sector: SectorKey, truth: SectorTruth, errors: ErrorsTally) -> None:
        """Take what is true of a sector's plots; their errors are counted where it says."""
        if not len(truth.whole) or sector in self._truths:
            return
        self._truths[sector] = truth, errors
        self._waiting += len(truth.whole)
        self._meet(sector)
        while self._waiting > MAX_WAITING_TRUTHS and self._truths:
            _, (given_up, _) = self._truths.popitem(last=False)
            self._waiting -= len(given_up.whole)

    def end(self) -> None:
        """Nothing more comes: of sectors with some of their plots it is known that they differ."""
        for sector, (truth, errors) in self._truths.items():
            if self._plots.count(sector):
                errors.contradicted += len(truth.plots)

    def _meet(self, sector: SectorKey) -> None:
        """Count errors if all are there, and that they contradict their truth if they do."""
        if sector not in self._truths:
            return
        truth, errors = self._truths[sector]
        if self._plots.count(sector) < len(truth.whole):
            return
        del self._truths[sector]
        self._waiting -= len(truth.whole)
        plots = self._plots.take(sector, truth.whole)
        if plots is None:
            errors.contradicted += len(truth.plots)
        else:
            errors.add(truth, plots.rows(truth.whole.of_drone))
