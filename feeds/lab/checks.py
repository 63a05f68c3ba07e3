"""Counts of looks, plots, errors and false alarms, and verdicts on what is not as asked."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from plotfeed.feeds.lab.asked import AskedSensor
from plotfeed.feeds.lab.evidence import SectorKey, WaitingPlots, are_targets, names_of
from plotfeed.feeds.lab.laws import (
    QUANTITIES,
    Comparison,
    TrueEchoes,
    TruePlots,
    compared,
    share_interval,
    z_score,
)
from plotfeed.feeds.lab.links import LinkFigures
from plotfeed.models.state import Bools, Floats, Ints
from plotfeed.models.tail_chances import p_of_normal, p_of_poisson, p_of_squares, p_of_trials
from plotfeed.proto.ledger import LedgerTables, ToldPlots
from plotfeed.proto.measured_plots import MeasuredPlots


class LookTally:
    """Looks of one sensor, in cells of range that are equally wide."""

    def __init__(self, cell_m: float, most_cells: int, *, at_once: int = 4096) -> None:
        """What is further than the last cell counts with it; so many are counted together."""
        self.cell_m = cell_m
        self._most_cells = most_cells
        self._at_once = at_once
        self._cells = np.zeros((4, 0))
        self._parts: list[tuple[Any, Any, Any]] = []
        self._waiting = 0

    def add(
        self,
        range_m: Floats | Sequence[float],
        pd: Floats | Sequence[float],
        detected: Bools | Sequence[bool],
    ) -> None:
        """Take some looks; (n,) each."""
        if not len(pd):
            return
        self._parts.append((range_m, pd, detected))
        self._waiting += len(pd)
        if self._waiting >= self._at_once:
            self._count()

    def cells(self) -> Floats:
        """Looks, sum of pd, sum of pd (1 - pd) and detections, by range from 0 on; (4, n).

        There are as many cells as have been looked at. Looks without a range or odds tell nothing.
        """
        if self._parts:
            self._count()
        return self._cells

    def _count(self) -> None:
        range_m, pd, detected = (
            np.concatenate(column, dtype=np.float64) for column in zip(*self._parts, strict=True)
        )
        self._parts.clear()
        self._waiting = 0
        good = (range_m >= 0) & (range_m < math.inf) & (pd >= 0) & (pd <= 1)
        range_m, pd, detected = range_m[good], pd[good], detected[good]
        if not len(pd):
            return
        cell = np.minimum(range_m / self.cell_m, self._most_cells - 1).astype(np.int64)
        more = int(cell.max()) + 1 - self._cells.shape[1]
        if more > 0:
            self._cells = np.pad(self._cells, ((0, 0), (0, more)))
        for row, values in enumerate((np.ones(len(pd)), pd, pd * (1 - pd), detected)):
            self._cells[row] += np.bincount(cell, values, self._cells.shape[1])


CELL_M = 25.0
MAX_CELLS = 40_000
"""Up to 1000 km; what is further counts with the last."""
MAX_BINS = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class PdFigures:
    """Looks at some ranges, and how many of them detected."""

    from_m: float
    to_m: float
    looks: int
    asked: float
    """Mean of the looks' own probabilities."""
    delivered: float
    """Share detected, and its 95 % interval."""
    low: float
    high: float
    z: float
    p: float
    """Probability of such a share, or one further off, by chance."""

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the share."""
        return self.low, self.high


def pd_of_all(looks: LookTally) -> PdFigures | None:
    """Figures of all ranges; None without a look."""
    cells = looks.cells()
    at = np.flatnonzero(cells[0])
    return _pd_figures(cells, int(at[0]), int(at[-1]) + 1) if len(at) else None


def pd_by_range(looks: LookTally) -> list[PdFigures]:
    """Figures of at most `MAX_BINS` equal bins over the ranges looked at; none is empty."""
    cells = looks.cells()
    at = np.flatnonzero(cells[0])
    if not len(at):
        return []
    first, end = int(at[0]), int(at[-1]) + 1
    step = round(_round_up((end - first) * CELL_M / MAX_BINS) / CELL_M)
    edges = range(first // step * step, end + step, step)
    found = (_pd_figures(cells, low, high) for low, high in pairwise(edges))
    return [figures for figures in found if figures.looks]


def _pd_figures(cells: Floats, first: int, end: int) -> PdFigures:
    count, sum_pd, *_ = of_cells = cells[:, first:end]
    looks, pd, variance, detected = of_cells.sum(axis=1).tolist()
    mean_pd = np.divide(sum_pd, count, out=np.zeros_like(count), where=count > 0)
    low, high = share_interval(round(detected), round(looks))
    return PdFigures(
        from_m=first * CELL_M,
        to_m=end * CELL_M,
        looks=round(looks),
        asked=pd / looks if looks else math.nan,
        delivered=detected / looks if looks else math.nan,
        low=low,
        high=high,
        z=z_score(detected - pd, variance),
        p=p_of_trials(count, mean_pd, round(detected)) if looks else math.nan,
    )


def _round_up(width_m: float) -> float:
    """A width of 1, 2 or 5 times a power of ten, where cells fit into it, and at least a cell."""
    unit = 10.0 ** math.floor(math.log10(max(width_m, CELL_M)))
    for times in (1, 2, 5, 10, 20, 50):
        step = times * unit
        if step >= width_m and step % CELL_M == 0:
            return step
    return 10 * CELL_M * math.ceil(width_m / (10 * CELL_M))


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmFigures:
    """False alarms of one sensor; NaN where no scene says what was asked."""

    count: int
    scans: float = math.nan
    """That the ledger tells of, parts of them counted as such."""
    asked: float = math.nan
    """By the scene, in all of these scans."""
    asked_per_scan: float = math.nan
    delivered_per_scan: float = math.nan
    z: float = math.nan
    p: float = math.nan
    """Probability of such a number, or one further off, by chance."""


def alarm_figures(count: int, told: int, mean: float, sectors: int) -> AlarmFigures:
    """False alarms in so many sectors that are `told`, of which there are `sectors` a scan.

    `mean` were to be expected; of 0 sectors a scan nothing is known of what was asked.
    """
    if not sectors:
        return AlarmFigures(count=count)
    scans = told / sectors
    return AlarmFigures(
        count=count,
        scans=scans,
        asked=mean,
        asked_per_scan=mean / scans if scans else math.nan,
        delivered_per_scan=count / scans if scans else math.nan,
        z=z_score(count - mean, mean),  # binomial over very many cells
        p=math.nan if math.isnan(mean) else p_of_poisson(count, mean),
    )


MOST_RUNS = 1000


def lacking_of(numbers: Ints) -> list[range]:
    """Numbers of sectors between those that are there, run by run; of so many runs."""
    there = np.unique(numbers)
    gaps = np.flatnonzero(np.diff(there) > 1)[:MOST_RUNS]
    return [range(int(there[i]) + 1, int(there[i + 1])) for i in gaps]


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

    t_utc_ns: Ints
    """Times of all its plots, false alarms too."""
    are_targets: Bools
    """Which of these are of what was looked at; of those alone are the others."""
    echoes: TrueEchoes
    plots: TruePlots
    asked: AskedSensor | None


def sector_truths(
    told: LedgerTables, asked: Sequence[AskedSensor | None]
) -> Iterator[tuple[int, SectorTruth]]:
    """What is true of the plots of each entry that has any, by the number of the entry."""
    every = told.plots
    is_target = are_targets(names_of(every))
    some = every.rows(is_target)
    echoes = _echoes(told, some)
    merged = np.fromiter(map(len, some.merged_drones), np.int64, len(some))
    plots = TruePlots(t_utc_ns=some.t_utc_ns, drones=1 + merged, range_rate_m_s=some.range_rate_m_s)
    entries = np.unique(every.entry)
    ends = [np.append(np.searchsorted(c, entries), len(c)) for c in (every.entry, some.entry)]
    ends.append(np.searchsorted(echoes.plot, ends[1]))
    for i, entry in enumerate(entries.tolist()):
        all_of, targets, of_echoes = ((int(c[i]), int(c[i + 1])) for c in ends)
        own = echoes.between(*of_echoes)
        yield (
            entry,
            SectorTruth(
                every.t_utc_ns[slice(*all_of)],
                is_target[slice(*all_of)],
                own.but(plot=own.plot - targets[0]),
                plots.between(*targets),
                asked[entry],
            ),
        )


def _echoes(told: LedgerTables, plots: ToldPlots) -> TrueEchoes:
    """Where the drones in plots were: by the looks, where a plot's truth is another."""
    looks, names, look_names = told.looks, names_of(plots), names_of(told.looks)
    place = np.stack([plots.azimuth_deg, plots.elevation_deg, plots.range_m])
    looked = np.stack([looks.azimuth_deg, looks.elevation_deg, looks.range_m])
    if looks.emitted_utc_ns.any():
        columns = (looks.entry.tolist(), look_names.tolist(), looks.t_utc_ns.tolist())
        heard = np.flatnonzero(looks.emitted_utc_ns).tolist()
        row_of = {tuple(column[row] for column in columns): row for row in reversed(heard)}
        keys = zip(plots.entry.tolist(), names.tolist(), plots.t_utc_ns.tolist(), strict=True)
        for n, key in enumerate(keys):
            if key in row_of:
                place[:, n] = looked[:, row_of[key]]
    is_merged = np.array([bool(each) for each in plots.merged_drones], np.bool_)
    alone = np.flatnonzero(~is_merged)
    number, row = [alone], [np.zeros(0, np.int64)]
    for n in np.flatnonzero(is_merged).tolist():
        first, end = np.searchsorted(looks.entry, [plots.entry[n], plots.entry[n] + 1])
        for drone in (names[n], *plots.merged_drones[n]):
            row.append(first + np.flatnonzero(look_names[first:end] == drone))
            number.append(np.full(len(row[-1]), n))
    rows, numbers = np.concatenate(row), np.concatenate(number)
    order = np.argsort(numbers, kind="stable")
    azimuth_deg, elevation_deg, range_m = np.column_stack([place[:, alone], looked[:, rows]])
    found = TrueEchoes(
        plot=numbers,
        channel=np.append(np.full(len(alone), -1), looks.channel[rows]),
        azimuth_deg=azimuth_deg,
        elevation_deg=elevation_deg,
        range_m=range_m,
        weight=np.append(np.ones(len(alone)), 10 ** (looks.snr_db[rows] / 10)),
    )
    return found if len(alone) == len(plots) else found.rows(order)


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


MAX_WAITING_TRUTHS = 50_000
"""Sectors whose truth waits for what was measured; then the oldest are given up."""
AwaitedPlots = tuple[SectorKey, SectorTruth, ErrorsTally]
"""What is true of the plots of a sector, and where their errors are counted."""


def settled_errors(
    waiting: WaitingPlots, awaited: Sequence[AwaitedPlots], *, at_end: bool = False
) -> list[AwaitedPlots]:
    """Count the errors of sectors whose plots are all there; what is left, of the others.

    At the end it is known that those with some of their plots contradict their truth.
    """
    left = []
    for sector, truth, errors in awaited:
        there = waiting.count(sector)
        if there < len(truth.t_utc_ns):
            errors.contradicted += len(truth.plots) if at_end and there else 0
            left.append((sector, truth, errors))
            continue
        plots = waiting.take(sector, truth.t_utc_ns)
        if plots is None:
            errors.contradicted += len(truth.plots)
        else:
            errors.add(truth, plots.rows(truth.are_targets))
    return left[-MAX_WAITING_TRUTHS:]


FALSE_VERDICTS = 1e-3
"""Share of right recordings in which something is called wrong: one in a thousand."""


class Judged(NamedTuple):
    """A figure that can be judged."""

    sensor: str
    link: int
    """Number of the sensor's link, 0 if it is not about a link."""
    quantity: str
    what: str
    """How it is off, with both figures."""
    p: float
    """Probability of this, or of what is further off, by chance."""
    has_chance: bool = True
    """Whether it could come by chance at all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Something that is not as it was asked."""

    sensor: str
    link: int
    """Number of the sensor's link, 0 if it is not about a link."""
    quantity: str
    what: str
    p: float
    """0 for what never comes by chance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdicts:
    """What is wrong, of so many figures that were judged."""

    wrong: Sequence[Verdict]
    judged: int
    false_rate: float
    """Share of right recordings in which anything is called wrong."""


def verdicts(figures: Iterable[Judged]) -> Verdicts:
    """Judge all figures of a recording together."""
    judged = [figure for figure in figures if not math.isnan(figure.p)]
    below = FALSE_VERDICTS / max(sum(figure.has_chance for figure in judged), 1)
    wrong = [
        Verdict(sensor=f.sensor, link=f.link, quantity=f.quantity, what=f.what, p=f.p)
        for f in judged
        if f.p < below
    ]
    return Verdicts(wrong=wrong, judged=len(judged), false_rate=FALSE_VERDICTS)


def of_link(link: LinkFigures) -> Iterator[Judged]:
    """Delays as the link drew them, losses, bursts, copies, flipped bits and the order."""

    def judged(quantity: str, what: str, p: float) -> Judged:
        return Judged(link.sensor, link.number, quantity, what, p, 0 < p < 1)

    fit, delivered, asked = link.fit, link.delivered, link.asked
    if asked is not None:
        told = f"mean {delivered.mean_ms:.3f} ms, asked {asked.mean_ms:.3f}"
        yield judged("delay", f"{told}; distance {fit.link_distance:.4f}", fit.link_p_value)
        yield judged("delay", f"{fit.other} messages; {told}", 0.0 if fit.other else 1.0)
    for quantity, share in (
        ("loss", link.loss),
        ("duplicates", link.duplicates),
        ("flipped bits", link.corrupted),
        ("order", link.overtook),
    ):
        told = f"{100 * share.delivered:.2f} %, asked {100 * share.asked:.2f}"
        yield judged(quantity, told, share.p)
    bursts = link.bursts
    told = f"mean {bursts.delivered_mean:.3f}, asked {bursts.asked_mean:.3f}"
    yield judged("bursts of losses", told, bursts.p)


def of_looks(sensor: str, figures: Iterable[PdFigures]) -> Iterator[Judged]:
    """Detection, at some ranges."""
    for at in figures:
        where = f"{at.from_m / 1000:.2f}-{at.to_m / 1000:.2f} km"
        told = f"{at.delivered:.3f} at {where}, asked {at.asked:.3f}"
        yield Judged(sensor, 0, "detection", told, at.p)


def of_errors(sensor: str, figures: Iterable[ErrorFigures]) -> Iterator[Judged]:
    """What was measured: means, spreads, and values that no noise makes."""
    for of in figures:
        mean = f"mean error {of.mean:.4g} {of.unit}, z {of.z_mean:+.1f}"
        yield Judged(sensor, 0, of.quantity, mean, of.p_mean)
        rms = f"rms error over sigma {of.normalised_rms:.3f}, z {of.z_rms:+.1f}"
        yield Judged(sensor, 0, of.quantity, rms, of.p_rms)
        yield of_count(sensor, of.quantity, of.off, f"of {of.plots} plots off by more than noise")


def of_alarms(sensor: str, alarms: AlarmFigures) -> Judged:
    """False alarms."""
    told = f"{alarms.count}, asked {alarms.asked:.1f}"
    return Judged(sensor, 0, "false alarms", told, alarms.p)


def of_count(sensor: str, quantity: str, count: int, what: str) -> Judged:
    """What never is where all is right."""
    return Judged(sensor, 0, quantity, f"{count} {what}", 0.0 if count else 1.0, False)
