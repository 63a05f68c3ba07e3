"""Residuals of a sensor's plots beside what is expected of it, each named and judged.

Whatever is summed is summed part by part, so that a feed of any length is judged in little memory.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from plotfeed.models.state import Bools, Columns, Floats, Ints
from plotfeed.models.tail_chances import p_of_normal, p_of_poisson, p_of_squares, p_of_trials
from plotfeed.models.verdicts import share_interval

# Plots of targets, or as many as tell as much, from which on errors are judged.
FEWEST = 8
# Lateness that must be seen at 4.6 standard errors, or time is not judged: nine times in ten.
SEEN_LATENESS_S = 1.0
BENEFIT = 4.6
# Where time cannot be judged by itself: lateness that is usual, and standard errors from which on a
# systematic error beside such lateness counts as one.
USUAL_LATENESS_S = 3.0
BESIDE = 3.3
# Standard errors from which on successive errors count as correlated.
CORRELATED = 2.33
MOST_CORRELATED = 0.98
# Share of what tells of lateness that systematic errors do not explain, to be any.
INDEPENDENT = 1e-9


@dataclass(frozen=True, kw_only=True)
class Residuals(Columns):
    """Plots of targets, (n,), and k quantities of each, (n, k).

    `error` is what was measured less what was expected at the time that the plot states, NaN where
    that is not measured; `rate` how fast the truth changed, a second, NaN or 0 where lateness is
    not asked for; `kurtosis` that of errors.
    """

    target: Ints
    t_s: Floats
    error: Floats
    sigma: Floats
    rate: Floats
    kurtosis: Floats


class MeasuredQuantity(NamedTuple):
    """Something that plots measure; `follows` from others, whose noise it shares."""

    name: str
    unit: str
    follows: bool = False


@dataclass(frozen=True, kw_only=True)
class LookOdds(Columns):
    """Looks, (n,): at what, when, with which expected Pd, hit or not; Pd may be off by `off`."""

    target: Ints
    t_s: Floats
    pd: Floats
    hit: Bools
    off: Floats | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """A figure beside what was expected; of a link, `link` is its number, else 0.

    `sigma` is the standard error of what was found, NaN for none; `p` the probability of this or
    more by chance, NaN if it is not judged, for which `why_not` has the reason. It follows from
    `of` plots, looks or messages.
    """

    sensor: str = ""
    link: int = 0
    name: str
    unit: str = ""
    expected: float
    found: float = math.nan
    sigma: float = math.nan
    p: float = math.nan
    of: int = 0
    why_not: str = ""
    wrong: bool = False

    @property
    def is_judged(self) -> bool:
        """Whether chance, or that it never comes by chance, says anything of it."""
        return not math.isnan(self.p)

    @property
    def is_never(self) -> bool:
        """Whether it is of what can never be by chance, and was not."""
        return self.p == 1 and math.isnan(self.sigma)

    @property
    def z(self) -> float:
        """Standard deviations from what is expected, of a normal number as improbable."""
        if math.isnan(self.p):
            return math.nan
        return math.copysign(-float(ndtri(max(self.p, 1e-300) / 2)), self.found - self.expected)


def wrong_at(checks: Sequence[Check], false_rate: float) -> list[bool]:
    """Which checks fail; where all is right any does with that chance at most (Holm 1979).

    What never comes by chance, p = 0, or always, takes no share of that.
    """
    judged = sorted((c.p, i) for i, c in enumerate(checks) if 0 < c.p < 1)
    wrong = [c.p == 0 for c in checks]
    for done, (p, i) in enumerate(judged):
        if p >= false_rate / (len(judged) - done):
            break
        wrong[i] = True
    return wrong


def always_valid(check: Check, false_rate: float, *, at_once: float = 20.0) -> bool:
    """Whether a check that is looked at time and again fails: at that rate however often one looks.

    Robbins' bound (1970) for a sum of n standard normal numbers, sharpest about `at_once` of them:
    |S| >= sqrt((n + r) ln((n + r) / (r a^2))).
    """
    n = check.of
    if math.isnan(check.p) or not n:
        return False
    bound = (n + at_once) / n * math.log((n + at_once) / (at_once * false_rate**2))
    return abs(check.z) >= math.sqrt(bound)


NEAR_STEPS = np.arange(-8, 9)


class Expected(NamedTuple):
    """Means of a quantity, what noise leaves of it (variance and kurtosis), and its step; (n,)."""

    mean: Floats
    variance: Floats
    kurtosis: Floats
    step: float = 0.0


def gauss(mean: Floats, sigma: Floats) -> Expected:
    """The law of a measurement with normal noise."""
    return Expected(mean, sigma**2, np.full(len(mean), 3.0))


def over(values: Floats, weights: Floats) -> Expected:
    """The law of what follows from normal noise: values (n, nodes) at the nodes of a quadrature."""
    mean = values @ weights
    excess = values - mean[:, None]
    variance = excess**2 @ weights
    return Expected(mean, variance, np.asarray(excess**4 @ weights / variance**2))


def in_steps(law: Expected, step: float) -> Expected:
    """The law of values that are rounded to steps: Sheppard's, or a sum where steps are coarse."""
    if not step:
        return law
    mean, variance, kurtosis, _ = law
    uniform = step**2 / 12
    fourth = kurtosis * variance**2 + 6 * variance * uniform + step**4 / 80
    kurtosis = fourth / (variance + uniform) ** 2
    told = Expected(mean.copy(), variance + uniform, kurtosis, step)
    coarse = np.sqrt(variance) < step
    if not coarse.any():
        return told
    middle, sigma = mean[coarse], np.sqrt(variance[coarse])[:, None]
    at = np.rint(middle / step)[:, None] + NEAR_STEPS
    edges = (np.column_stack([at, at[:, -1] + 1]) - 0.5) * step
    law_at = np.diff(ndtr((edges - middle[:, None]) / np.maximum(sigma, 1e-12)), axis=1)
    means = (law_at * at * step).sum(axis=1)
    excess = at * step - means[:, None]
    variances, fourths = ((law_at * excess**power).sum(axis=1) for power in (2, 4))
    told.mean[coarse], told.variance[coarse] = means, variances
    told.kurtosis[coarse] = fourths / variances**2
    return told


class ErrorSums:
    """Sums of errors, of which systematic errors, lateness and spreads follow.

    Errors of a quantity are fitted by a systematic one and by lateness, all quantities together, by
    least squares; those that follow from others tell nothing of lateness.
    """

    def __init__(self, quantities: Sequence[MeasuredQuantity]) -> None:
        self.quantities = quantities
        k = len(quantities)
        # Products of error, 1 and slope by lateness, over sigma: of each plot with itself, and with
        # the one before it of the same target.
        self._own, self._next = np.zeros((k, 3, 3)), np.zeros((k, 3, 3))
        self._kurtosis = np.zeros(k)
        self._pairs = np.zeros(k, np.int64)
        self.count = np.zeros(k, np.int64)
        self.plots = 0

    def add(self, r: Residuals) -> None:
        """Take plots."""
        r = r.rows(np.lexsort((r.t_s, r.target)))
        has = np.isfinite(r.error) & np.isfinite(r.sigma) & (r.sigma > 0)
        share = np.where(has, 1 / np.where(has, r.sigma, 1.0), 0.0)
        slope = np.where(has & np.isfinite(r.rate), -r.rate, 0.0)
        terms = np.stack([np.where(has, r.error, 0.0), np.ones_like(slope), slope]) * share
        for i in range(len(self.quantities)):
            there = has[:, i]
            of, target = terms[:, there, i], r.target[there]
            same = np.flatnonzero(target[1:] == target[:-1])
            self._own[i] += of @ of.T
            self._next[i] += of[:, same] @ of[:, same + 1].T
            self._pairs[i] += len(same)
            self._kurtosis[i] += r.kurtosis[there, i].sum()
            self.count[i] += of.shape[1]
        self.plots += int(has.any(axis=1).sum())

    def usual_sigma(self, i: int) -> float:
        """The standard deviation that is expected of a quantity, the mean by their weights."""
        return math.sqrt(self.count[i] / self._own[i, 1, 1])

    def checks(self, no_time: str = "") -> list[Check]:
        """Systematic errors, lateness, and spreads, of what was measured; of all if nothing was.

        `no_time` says why times tell nothing, if so.
        """
        fit = _Fit(self, with_time=not no_time)
        why, may_be_late = no_time or fit.why_no_time(), None
        if why and not no_time:
            may_be_late = fit.may_be_late()
            fit = _Fit(self, with_time=False)
        there = np.flatnonzero(self.count).tolist() or range(len(self.quantities))
        found = [fit.bias(i, may_be_late is not None and bool(may_be_late[i])) for i in there]
        if self.count.max(initial=0) < FEWEST:
            why = fit.too_few(self.plots)
        late_s, se_s = fit.late_s, fit.se_time_s
        time = Check(name="time", unit="s", expected=0.0, why_not=why, of=self.plots)
        if not why:
            time = replace(time, found=late_s, sigma=se_s, p=p_of_normal(late_s / se_s))
        return [*found, time, *(fit.spread(i) for i in there)]


class _Fit:
    """Errors fitted by a systematic one of each quantity, and by lateness."""

    def __init__(self, sums: ErrorSums, *, with_time: bool) -> None:
        self._sums, own = sums, sums._own
        self._weight = weight = np.where(own[:, 1, 1] > 0, own[:, 1, 1], 1.0)
        self._mean_slope = own[:, 1, 2] / weight if with_time else 0 * weight
        self._error = error = own[:, 0, 1] / weight
        follows = np.array([q.follows for q in sums.quantities], np.bool_)
        # What tells of lateness: slopes, and what of them is left about their means.
        alone = np.where(follows, 0.0, own[:, 2, 2])
        about = np.where(follows, 0.0, own[:, 2, 2] - own[:, 1, 2] ** 2 / weight)
        along = np.where(follows, 0.0, own[:, 0, 2] - own[:, 0, 1] * own[:, 1, 2] / weight)
        self._alone, self._about = float(alone.sum()), float(about.sum())
        self._along = float(along.sum())
        tells = with_time and self._about > INDEPENDENT * self._alone
        self.late_s = self._along / self._about if tells else 0.0
        self.bias_of = error - self.late_s * self._mean_slope
        left = np.stack([np.ones_like(error), -self.bias_of, np.full_like(error, -self.late_s)])
        squares, after = (np.einsum("ai,iab,bi->i", left, m, left) for m in (own, sums._next))
        independent = max(int((~follows & (sums.count > 0)).sum()), 1)
        self._free = np.maximum(sums.count - 1 - (1 / independent if tells else 0.0), 1.0)
        self._squares = np.maximum(squares, 0.0)
        each = zip(squares, after, sums.count.tolist(), sums._pairs.tolist(), strict=True)
        self._rho = np.array([_correlation(*of) for of in each])
        self._inflation = np.maximum(1.0, self._squares / self._free)
        self._inflation = self._inflation * (1 + self._rho) / (1 - self._rho)
        self.se_time_s = (
            math.sqrt(float(self._inflation @ about)) / self._about if tells else math.inf
        )
        of_time = (self._mean_slope * self.se_time_s) ** 2 if tells else 0.0
        self.se_of = np.sqrt(self._inflation / weight + of_time)
        worst = float(self._inflation.max(initial=1.0))
        self._se_alone_s = math.sqrt(worst / self._alone) if self._alone > 0 else math.inf

    def why_no_time(self) -> str:
        """Why lateness is not judged; nothing if it is."""
        if self._se_alone_s * BENEFIT > SEEN_LATENESS_S:
            return "targets hardly move as the sensor sees them"
        if self.se_time_s * BENEFIT > SEEN_LATENESS_S:
            return "on these paths lateness looks like a systematic error"
        return ""

    def may_be_late(self) -> Bools:
        """Which systematic errors usual lateness may be instead, as far as paths tell; (k,)."""
        told = self._about + 1 / USUAL_LATENESS_S**2
        bias = self._error - self._along / told * self._mean_slope
        se2 = self._inflation / self._weight + self._mean_slope**2 / told
        return np.asarray((np.abs(bias) < BESIDE * np.sqrt(se2)) & (self._mean_slope != 0))

    def too_few(self, n: int) -> str:
        """What is said where there are less than needed."""
        return f"{n} plots of targets that it tells apart; {FEWEST} are needed"

    def bias(self, i: int, may_be_late: bool) -> Check:
        """The systematic error of a quantity."""
        quantity = self._sums.quantities[i]
        blank = Check(
            name=quantity.name, unit=quantity.unit, expected=0.0, of=int(self._sums.count[i])
        )
        if not self._is_enough(i):
            return replace(blank, why_not=self.too_few(blank.of))
        found, se = float(self.bias_of[i]), float(self.se_of[i])
        name = f"{quantity.name} or time" if may_be_late else quantity.name
        return replace(blank, name=name, found=found, sigma=se, p=p_of_normal(found / se))

    def spread(self, i: int) -> Check:
        """Errors over what is expected of them."""
        sums, n = self._sums, int(self._sums.count[i])
        blank = Check(name=f"{sums.quantities[i].name} spread", expected=1.0, of=n)
        if not self._is_enough(i):
            return replace(blank, why_not=self.too_few(n))
        free, rho = float(self._free[i]), float(self._rho[i])
        varied = float(sums._kurtosis[i] - n) * free / n
        if varied < 1e-6 * free:  # what is told as one of two steps does not vary
            return replace(blank, why_not="its steps are too coarse")
        variance = varied * (1 + rho**2) / (1 - rho**2)
        squares = float(self._squares[i])
        return replace(
            blank,
            found=math.sqrt(squares / free),
            sigma=math.sqrt(variance) / (2 * free),
            p=p_of_squares(squares, free, variance),
        )

    def _is_enough(self, i: int) -> bool:
        """Whether there are plots enough, or as many normal numbers as vary as much."""
        n = int(self._sums.count[i])
        return n >= FEWEST and 3 * n**2 >= FEWEST * float(self._sums._kurtosis[i])


CELL_M = 25.0
# Up to 1000 km; what is further counts with the last.
MAX_CELLS = 40_000


def _correlation(squares: float, after: float, count: int, pairs: int) -> float:
    """Correlation of successive errors of one target; 0 where it may well be chance."""
    if pairs < FEWEST or not squares > 0:
        return 0.0
    rho = after / squares * count / pairs
    return min(rho, MOST_CORRELATED) if rho * math.sqrt(pairs) > CORRELATED else 0.0


class LookTally:
    """Looks of one sensor, in cells of range that are equally wide."""

    def __init__(self, cell_m: float, most_cells: int, *, at_once: int = 4096) -> None:
        """What is further than the last cell counts with it; so many are counted together."""
        self.cell_m = cell_m
        self._most_cells = most_cells
        self._at_once = at_once
        self._cells = np.zeros((5, 0))
        self._parts: list[tuple[Any, Any, Any, Any]] = []
        self._waiting = 0

    def add(
        self,
        range_m: Floats | Sequence[float],
        pd: Floats | Sequence[float],
        detected: Bools | Sequence[bool],
        off: Floats | None = None,
    ) -> None:
        """Take some looks; (n,) each, `off` of what is not known of their odds."""
        if not len(pd):
            return
        self._parts.append((range_m, pd, detected, np.zeros(len(pd)) if off is None else off))
        self._waiting += len(pd)
        if self._waiting >= self._at_once:
            self._count()

    def cells(self) -> Floats:
        """Looks, sums of pd and pd (1 - pd), detections and sum of `off`, by range from 0; (5, n).

        There are as many cells as have been looked at. Looks without a range or odds tell nothing.
        """
        if self._parts:
            self._count()
        return self._cells

    def _count(self) -> None:
        range_m, pd, detected, off = (
            np.concatenate(column, dtype=np.float64) for column in zip(*self._parts, strict=True)
        )
        self._parts.clear()
        self._waiting = 0
        good = (range_m >= 0) & (range_m < math.inf) & (pd >= 0) & (pd <= 1)
        range_m, pd, detected, off = range_m[good], pd[good], detected[good], off[good]
        if not len(pd):
            return
        cell = np.minimum(range_m / self.cell_m, self._most_cells - 1).astype(np.int64)
        more = int(cell.max()) + 1 - self._cells.shape[1]
        if more > 0:
            self._cells = np.pad(self._cells, ((0, 0), (0, more)))
        for row, values in enumerate((np.ones(len(pd)), pd, pd * (1 - pd), detected, off)):
            self._cells[row] += np.bincount(cell, values, self._cells.shape[1])


def nearer(hits: int, expected: float, off: float) -> int:
    """Hits as near to what is expected as that may be off."""
    if hits < expected:
        return min(math.ceil(hits + off), max(hits, math.floor(expected)))
    return max(math.floor(hits - off), min(hits, math.ceil(expected)))


MAX_BINS = 12


class PdFigures:
    """Looks at some ranges, and how many of them detected."""

    def __init__(self, cells: Floats, from_m: float, to_m: float) -> None:
        """`cells` are those of a `LookTally` there."""
        count, sum_pd, *_ = cells
        looks, pd, _, detected, off = cells.sum(axis=1).tolist()
        mean_pd = np.divide(sum_pd, count, out=np.zeros_like(count), where=count > 0)
        self.from_m, self.to_m, self.looks = from_m, to_m, round(looks)
        self.expected = pd / looks  # Mean of the looks' own probabilities
        self.found = detected / looks  # Share detected, and its 95 % interval
        self.low, self.high = share_interval(round(detected), self.looks)
        # Probability of such a share, or one further off, by chance.
        self.p = p_of_trials(count, mean_pd, nearer(round(detected), pd, off))


def pd_by_range(looks: LookTally) -> list[PdFigures]:
    """Figures of at most `MAX_BINS` equal bins over the ranges looked at; none is empty."""
    cells = looks.cells()
    at = np.flatnonzero(cells[0])
    if not len(at):
        return []
    first, end = int(at[0]), int(at[-1]) + 1
    step = round(_round_up((end - first) * CELL_M / MAX_BINS) / CELL_M)
    return [
        PdFigures(cells[:, begin : begin + step], begin * CELL_M, (begin + step) * CELL_M)
        for begin in range(first // step * step, end, step)
        if cells[0, begin : begin + step].any()
    ]


def _round_up(width_m: float) -> float:
    """A width of 1, 2 or 5 times a power of ten, where cells fit into it, and at least a cell."""
    unit = 10.0 ** math.floor(math.log10(max(width_m, CELL_M)))
    for times in (1, 2, 5, 10, 20, 50):
        step = times * unit
        if step >= width_m and step % CELL_M == 0:
            return step
    return 10 * CELL_M * math.ceil(width_m / (10 * CELL_M))


class LookSums:
    """Looks at targets, and how many of them brought a plot."""

    def __init__(self) -> None:
        self.tally = LookTally(CELL_M, MAX_CELLS)
        self._squares = self._after = 0.0
        self._pairs = 0

    def add(self, looks: LookOdds, range_m: Floats) -> None:
        """Take looks at those ranges, (n,)."""
        order = np.lexsort((looks.t_s, looks.target))
        pd, hit, target = np.clip(looks.pd[order], 0.0, 1.0), looks.hit[order], looks.target[order]
        left, same = hit - pd, target[1:] == target[:-1]
        off = None if looks.off is None else looks.off[order]
        self.tally.add(range_m[order], pd, hit, off)
        self._squares += float(left @ left)
        self._after += float((left[1:] * left[:-1])[same].sum())
        self._pairs += int(same.sum())

    def check(self) -> Check:
        """How often targets had a plot, beside the sum of the probabilities that are expected."""
        cells = self.tally.cells()
        n, total, variance, found, off = cells.sum(axis=1).tolist()
        hits = round(found)
        if not n:
            return Check(
                name="Pd", expected=math.nan, why_not="no target was looked at that it tells apart"
            )
        blank = Check(name="Pd", expected=total / n, of=round(n))
        if variance <= 0 and hits == round(total):
            return replace(blank, why_not="every look is certain, one way or the other")
        rho = _correlation(self._squares, self._after, round(n), self._pairs)
        least = nearer(hits, total, off)
        if rho and variance > 0:
            variance *= (1 + rho) / (1 - rho)
            chance = p_of_normal((least - total) / math.sqrt(variance))
        else:
            mean = np.divide(cells[1], cells[0], out=np.zeros_like(cells[1]), where=cells[0] > 0)
            chance = p_of_trials(cells[0], mean, least)
        return replace(blank, found=hits / n, sigma=math.sqrt(variance) / n, p=chance)


def clutter_check(count: int, expected: float, scans: float, why_not: str = "") -> Check:
    """False alarms beside how many are expected in all scans; or why they are not judged."""
    blank = Check(name="false alarms", unit="a scan", expected=math.nan, of=count)
    if why_not or not scans > 0:
        return replace(blank, why_not=why_not or "no scan was seen")
    return replace(
        blank,
        expected=expected / scans,
        found=count / scans,
        sigma=math.sqrt(max(expected, 1.0)) / scans,
        p=p_of_poisson(count, expected),
        of=max(count, round(expected)),
    )
