"""Residuals of a sensor's plots beside what the sensor claims, each named and judged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.special import ndtri

from plotfeed.models.effects.merging import REACH, near_pairs
from plotfeed.models.plain_tracker import least_sum
from plotfeed.models.state import Bools, Columns, Floats, Ints
from plotfeed.models.tail_chances import p_of_normal, p_of_poisson, p_of_squares, p_of_trials

FEWEST = 8
"""Plots of targets from which on errors are judged."""
SEEN_LATENESS_S = 1.0
"""Lateness that must be seen at 4.6 standard errors, or time is not judged: nine times in ten."""
BENEFIT = 4.6
CORRELATED = 2.33
"""Standard errors from which on successive errors count as correlated."""
MOST_CORRELATED = 0.98
INDEPENDENT = 1e-9
"""Share of what tells of lateness that systematic errors do not explain, to be any."""
CELLS = 500
"""Into which looks are sorted by their odds."""


@dataclass(frozen=True, kw_only=True)
class Residuals(Columns):
    """Plots of targets, (n,), and k quantities of each, (n, k), in the order of `quantities`.

    `error` is what was measured less what was true at the time that the plot states, NaN where that
    is not measured; `rate` how fast the truth changed, a second; `kurtosis` that of errors.
    """

    target: Ints
    t_s: Floats
    error: Floats
    sigma: Floats
    rate: Floats
    kurtosis: Floats


@dataclass(frozen=True, kw_only=True)
class LookOdds(Columns):
    """Looks, (n,): at what, when, with which claimed probability of a plot, and whether it came."""

    target: Ints
    t_s: Floats
    pd: Floats
    hit: Bools


class MeasuredQuantity(NamedTuple):
    """Something that plots measure."""

    name: str
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualCheck:
    """One claim beside what was found."""

    name: str
    """Such as "azimuth", "azimuth spread", "time", "Pd", "false alarms"."""
    unit: str
    claimed: float
    found: float
    sigma: float
    """Standard error of what was found; NaN if there is none."""
    p: float
    """Probability of this or more by chance; NaN if it is not judged."""
    of: int
    """Plots or looks that it follows from."""
    why_not: str = ""
    """Why it is not judged."""

    @property
    def z(self) -> float:
        """Standard deviations from what is claimed, of a normal number as improbable."""
        if math.isnan(self.p):
            return math.nan
        return math.copysign(-float(ndtri(max(self.p, 1e-300) / 2)), self.found - self.claimed)


def not_judged(name: str, unit: str, claimed: float, why: str, of: int = 0) -> ResidualCheck:
    """A claim that nothing is known of."""
    return ResidualCheck(
        name=name, unit=unit, claimed=claimed, found=math.nan, sigma=math.nan, p=math.nan, of=of,
        why_not=why,
    )  # fmt: skip


class FalseInGates(NamedTuple):
    """Plots of nobody that are taken for a target's: how many, and the gate's half widths (k,)."""

    hits: float
    gate: Floats


def error_checks(
    residuals: Residuals,
    quantities: Sequence[MeasuredQuantity],
    false: FalseInGates,
    no_time: str = "",
) -> list[ResidualCheck]:
    """Systematic errors of each quantity, lateness, and the spread of each quantity.

    `no_time` says why the times of plots tell nothing, if so.
    """
    there = [k for k in range(len(quantities)) if np.isfinite(residuals.error[:, k]).any()]
    if len(residuals) < FEWEST or not there:
        few = f"{len(residuals)} plots of targets that it tells apart; {FEWEST} are needed"
        return [
            *(not_judged(q.name, q.unit, 0.0, few, len(residuals)) for q in quantities),
            not_judged("time", "s", 0.0, few, len(residuals)),
            *(not_judged(f"{q.name} spread", "", 1.0, few, len(residuals)) for q in quantities),
        ]
    fit = _Fit(residuals, with_time=True)
    why = no_time or fit.why_no_time()
    judged = fit if not why else _Fit(residuals, with_time=False)
    confounded = bool(why) and why == fit.why_no_time() and fit.is_confounded
    checks = [judged.bias(k, q, confounded=confounded) for k, q in enumerate(quantities)]
    if why:
        checks.append(not_judged("time", "s", 0.0, why, len(residuals)))
    else:
        checks.append(judged.time())
    return checks + [judged.spread(k, q, false) for k, q in enumerate(quantities)]


class _Fit:
    """Errors fitted by a systematic one of each quantity, and by lateness."""

    def __init__(self, r: Residuals, *, with_time: bool) -> None:
        order = np.lexsort((r.t_s, r.target))
        self._r = r = r.rows(order)
        self._n, self._k = r.error.shape
        self._has = np.isfinite(r.error) & np.isfinite(r.sigma) & (r.sigma > 0)
        weight = np.where(self._has, 1 / np.where(self._has, r.sigma, 1.0) ** 2, 0.0)
        error = np.where(self._has, r.error, 0.0)
        slope = np.where(self._has & np.isfinite(r.rate), -r.rate, 0.0) if with_time else 0 * error
        k = self._k
        parts = np.zeros((k, k + 1, k + 1))
        for i in range(k):
            parts[i, i, i] = weight[:, i].sum()
            parts[i, i, k] = parts[i, k, i] = weight[:, i] @ slope[:, i]
            parts[i, k, k] = weight[:, i] @ slope[:, i] ** 2
        right = np.append((weight * error).sum(axis=0), (weight * slope * error).sum())
        inverse, is_told = _inverse(parts.sum(axis=0))
        self.theta = inverse @ right
        left = error - self.theta[:k] - slope * self.theta[k]
        self._left = np.where(self._has, left * np.sqrt(weight), 0.0)
        self._count = self._has.sum(axis=0)
        self._free = np.maximum(self._count - 1 - (1 / k if with_time else 0.0), 1.0)
        self._squares = (self._left**2).sum(axis=0)
        self._spread = np.sqrt(self._squares / self._free)
        self._rho = np.array(
            [_correlation(self._left[:, i], self._has[:, i], r.target) for i in range(k)]
        )
        inflation = np.maximum(1.0, self._spread**2) * (1 + self._rho) / (1 - self._rho)
        covariance = inverse @ np.tensordot(inflation, parts, 1) @ inverse
        self.se = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        if not is_told:
            self.se[k] = math.inf
        alone = float(parts[:, k, k].sum())
        self._se_time_alone = math.sqrt(inflation.max() / alone) if alone > 0 else math.inf

    @property
    def is_confounded(self) -> bool:
        """Whether lateness would be seen, were it not for systematic errors that look like it."""
        se_s = float(self.se[self._k])
        return self._se_time_alone * BENEFIT <= SEEN_LATENESS_S < se_s * BENEFIT

    def why_no_time(self) -> str:
        """Why lateness is not judged; nothing if it is."""
        if self._se_time_alone * BENEFIT > SEEN_LATENESS_S:
            return "targets hardly move as the sensor sees them"
        if self.is_confounded:
            return "on these paths lateness looks like a systematic error"
        return ""

    def bias(self, k: int, quantity: MeasuredQuantity, *, confounded: bool) -> ResidualCheck:
        """The systematic error of a quantity."""
        n = int(self._count[k])
        if n < FEWEST:
            few = f"{n} plots of targets measure it; {FEWEST} are needed"
            return not_judged(quantity.name, quantity.unit, 0.0, few, n)
        found, se = float(self.theta[k]), float(self.se[k])
        return ResidualCheck(
            name=f"{quantity.name} or time" if confounded else quantity.name,
            unit=quantity.unit,
            claimed=0.0,
            found=found,
            sigma=se,
            p=p_of_normal(found / se),
            of=n,
        )

    def time(self) -> ResidualCheck:
        """How late plots are stamped."""
        found, se = float(self.theta[self._k]), float(self.se[self._k])
        return ResidualCheck(
            name="time", unit="s", claimed=0.0, found=found, sigma=se, p=p_of_normal(found / se),
            of=self._n,
        )  # fmt: skip

    def spread(self, k: int, quantity: MeasuredQuantity, false: FalseInGates) -> ResidualCheck:
        """Errors over what is claimed of them."""
        name, n = f"{quantity.name} spread", int(self._count[k])
        if n < FEWEST:
            few = f"{n} plots of targets measure it; {FEWEST} are needed"
            return not_judged(name, "", 1.0, few, n)
        free, rho, gate = float(self._free[k]), float(self._rho[k]), float(false.gate[k])
        kurtosis = np.where(self._has[:, k], self._r.kurtosis[:, k], 1.0)
        # Plots of nobody lie anywhere in the gate: uniform numbers, of which squares are known.
        extra = min(false.hits, float(n))
        mean = free + extra * (gate**2 / 3 - 1)
        varied = float((kurtosis - 1).sum()) * free / n
        variance = varied * (1 + rho**2) / (1 - rho**2) + extra * gate**4 / 5
        found = float(self._spread[k])
        return ResidualCheck(
            name=name,
            unit="",
            claimed=1.0,
            found=found,
            sigma=math.sqrt(variance) / (2 * free),
            p=p_of_squares(float(self._squares[k]), mean, max(variance, 1e-6 * free)),
            of=n,
        )


def _inverse(normal: Floats) -> tuple[Floats, bool]:
    """The inverse of normal equations, diagonal but for lateness, and whether that can be told.

    Lateness is the last; where it cannot be told, it is left out.
    """
    k = len(normal) - 1
    weight = np.diagonal(normal)[:k]
    each = np.where(weight > 0, 1 / np.where(weight > 0, weight, 1.0), 0.0)
    along = each * normal[:k, k]
    own = float(normal[k, k] - normal[:k, k] @ along)
    inverse = np.zeros_like(normal)
    inverse[:k, :k] = np.diag(each)
    is_told = own > INDEPENDENT * float(normal[k, k])
    if is_told:
        column = np.append(-along, 1.0)
        inverse += np.outer(column, column) / own
    return inverse, is_told


def _correlation(left: Floats, has: Bools, target: Ints) -> float:
    """Correlation of successive errors of one target; 0 where it may well be chance."""
    left, target = left[has], target[has]
    same = target[1:] == target[:-1]
    pairs, squares = int(same.sum()), float(left @ left)
    if pairs < FEWEST or not squares > 0:
        return 0.0
    rho = float((left[1:] * left[:-1])[same].sum()) / squares * len(left) / pairs
    return min(rho, MOST_CORRELATED) if rho * math.sqrt(pairs) > CORRELATED else 0.0


def detection_check(looks: LookOdds, false_per_look: float) -> ResidualCheck:
    """How often targets had a plot, beside the sum of the probabilities that are claimed."""
    n = len(looks)
    if not n:
        return not_judged("Pd", "", math.nan, "no target was looked at that it tells apart")
    claimed = float(looks.pd.mean())
    p = 1 - (1 - np.clip(looks.pd, 0.0, 1.0)) * (1 - min(false_per_look, 1.0))
    hits, variance = int(looks.hit.sum()), float((p * (1 - p)).sum())
    found = hits / n
    if variance <= 0 and hits == round(float(p.sum())):
        return not_judged("Pd", "", claimed, "every look is certain, one way or the other", n)
    order = np.lexsort((looks.t_s, looks.target))
    left = np.where(variance > 0, (looks.hit - p), 0.0)[order]
    rho = _correlation(left, np.ones(n, np.bool_), looks.target[order])
    if rho:
        variance *= (1 + rho) / (1 - rho)
        chance = p_of_normal((hits - float(p.sum())) / math.sqrt(variance))
    else:
        cells = np.array_split(np.sort(p), min(CELLS, len(p)))
        counts = np.array([len(cell) for cell in cells], np.float64)
        chance = p_of_trials(counts, np.array([cell.mean() for cell in cells]), hits)
    return ResidualCheck(
        name="Pd", unit="", claimed=claimed, found=found, sigma=math.sqrt(variance) / n, p=chance,
        of=n,
    )  # fmt: skip


def clutter_check(left: int, expected: float, scans: float, false_hits: float) -> ResidualCheck:
    """Plots that no target has, beside the number of false alarms that is claimed; in all scans."""
    mean = max(expected - false_hits, 0.0)
    if not scans > 0:
        return not_judged("false alarms", "a scan", math.nan, "no scan was seen")
    return ResidualCheck(
        name="false alarms",
        unit="a scan",
        claimed=expected / scans,
        found=(left + false_hits) / scans,
        sigma=math.sqrt(max(mean, 1.0)) / scans,
        p=p_of_poisson(left, mean),
        of=max(left, round(mean)),
    )


def judged_wrong(checks: Sequence[ResidualCheck], false_rate: float) -> list[bool]:
    """Which checks fail; where all is right any does with that chance at most (Holm 1979)."""
    judged = sorted((c.p, i) for i, c in enumerate(checks) if not math.isnan(c.p))
    wrong = [False] * len(checks)
    for done, (p, i) in enumerate(judged):
        if p >= false_rate / (len(judged) - done):
            break
        wrong[i] = True
    return wrong


def always_valid(check: ResidualCheck, false_rate: float, *, at_once: float = 20.0) -> bool:
    """Whether a check that is looked at time and again fails: at that rate however often one looks.

    Robbins' bound (1970) for a sum of n standard normal numbers, sharpest about `at_once` of them:
    |S| >= sqrt((n + r) ln((n + r) / (r a^2))).
    """
    n = check.of
    if math.isnan(check.p) or not n:
        return False
    bound = (n + at_once) / n * math.log((n + at_once) / (at_once * false_rate**2))
    return abs(check.z) >= math.sqrt(bound)


GATE = 5.0
"""Half its width, in standard deviations."""
WIDER = 1.3
"""Spread of residuals, over the claimed one, from which on the gate is made wider."""
MOST_FALSE = 0.3
"""Share of false plots among those in gates from which on their spread tells nothing."""
ROUNDS = 8
WINDOW = 2.0
"""Half the width of the window that looks for the commonest residual, in standard deviations."""
OFFSETS = (-2.5, 2.5, -4.0, 4.0, -5.5, 5.5)
"""Half widths of the gate by which gates are displaced to count what is false."""
TO_NORMAL = 1.4826
"""Standard deviation over the median of absolute deviations, of normal numbers."""


@dataclass(frozen=True, kw_only=True)
class Candidates(Columns):
    """Pairs of a plot and a look of one sector that may belong together, by their numbers; (n,).

    `error` is what was measured less what was true, `sigma` its claimed standard deviation, both
    (n, k) in the units of k quantities, NaN where a plot does not measure one.
    """

    plot: Ints
    look: Ints
    error: Floats
    sigma: Floats


class PlotPairs(NamedTuple):
    """Which candidates are pairs, and the gate by which they were found."""

    chosen: Ints
    """Rows of candidates; no plot and no look twice."""
    centre: Floats
    """Of the gate, (k,), in units of the quantities."""
    gate: Floats
    """Half its width in claimed standard deviations, (k,)."""
    false_per_look: float
    """Mean number of plots of nobody in a gate."""


def plot_pairs(found: Candidates, reach: Floats, looks: int) -> PlotPairs:
    """The pairs among candidates; residuals up to `reach` (k,) and 12 gates are looked for.

    The first quantity is the one by which gates are displaced to count false plots. `looks` is how
    many there are.
    """
    quantities = found.error.shape[1]
    usual = _medians(found.sigma)
    reach = np.fmax(reach, 4 * GATE * usual)
    has = np.isfinite(found.error)
    far = np.abs(found.error) > np.fmax(reach, 4 * GATE * found.sigma)
    near = np.flatnonzero(~far.any(axis=1) & has.any(axis=1))
    error, sigma, has = found.error[near], found.sigma[near], has[near]
    plot, look = found.plot[near], found.look[near]
    centre, gate = np.zeros(quantities), np.full(quantities, GATE)
    within = np.ones(len(near), np.bool_)
    for k in range(quantities):
        centre[k] = _commonest(error[within & has[:, k], k], usual[k])
        within &= (np.abs(error[:, k] - centre[k]) <= GATE * sigma[:, k]) | ~has[:, k]
    ratio = np.where(has, (error - centre) / sigma, 0.0)
    chosen, false_per_look = _NONE, 0.0
    for _ in range(ROUNDS):
        chosen = _one_to_one(plot, look, ratio / gate)
        others = ~np.isin(plot, plot[chosen])
        false_per_look = _false_per_look(ratio[others], sigma[others, 0], gate, reach[0], looks)
        if false_per_look * looks > MOST_FALSE * max(len(chosen), 1):
            break
        wider = np.array(
            [_wanted(ratio[chosen, k][has[chosen, k]], gate[k]) for k in range(quantities)]
        )
        if (wider <= 1.05 * gate).all():
            break
        gate = wider
    return PlotPairs(near[chosen], centre, gate, false_per_look)


def look_groups(axes: Sequence[tuple[Floats, float]]) -> Ints:
    """A number of each look, (n,), which looks share that plots may not tell from each other.

    Each axis is places along it, (n,), over the distance from which plots do tell, and the period
    after which it is the same again, or 0.
    """
    n = len(axes[0][0])
    if n < 2:
        return np.zeros(n, np.int64)
    first, second, _ = near_pairs([(place * REACH, period * REACH) for place, period in axes])
    links: Any = coo_array((np.ones(len(first), np.bool_), (first, second)), shape=(n, n))
    return np.asarray(connected_components(links, directed=False)[1], np.int64)


def _medians(sigma: Floats) -> Floats:
    """Medians of each quantity; 0 of one that is nowhere measured."""
    return np.array(
        [np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else 0.0 for c in sigma.T]
    )


def _commonest(error: Floats, sigma: float) -> float:
    """The residual about which most are, unless about 0 there are nearly as many."""
    width = 2 * WINDOW * sigma
    values = np.sort(error)
    if not len(values):
        return 0.0
    ends = np.searchsorted(values, values + width, side="right")
    counts = ends - np.arange(len(values))
    best = int(counts.argmax())
    about_zero = int((np.abs(values) <= WINDOW * sigma).sum())
    most = int(counts[best])
    if most <= about_zero + 3 * np.sqrt(most):
        return 0.0
    middle = float(np.median(values[best : ends[best]]))
    for _ in range(3):  # the window's own edges are chosen by chance
        middle = float(np.median(values[np.abs(values - middle) <= width]))
    return middle


def _one_to_one(plot: Ints, look: Ints, share: Floats) -> Ints:
    """Pairs within the gate, by the least sum of squares; rows."""
    inside = np.flatnonzero((np.abs(share) <= 1).all(axis=1))
    cost = (share[inside] ** 2).sum(axis=1) - share.shape[1] - 1.0
    return inside[least_sum(plot[inside], look[inside], cost)]


def _false_per_look(ratio: Floats, sigma: Floats, gate: Floats, reach: float, looks: int) -> float:
    """Mean number of plots of nobody in gates that are displaced from where a target was."""
    if not looks or not len(ratio):
        return 0.0
    usual = float(np.median(sigma[np.isfinite(sigma)])) if np.isfinite(sigma).any() else 0.0
    rest: Bools = np.asarray((np.abs(ratio[:, 1:]) <= gate[1:]).all(axis=1))
    counts = [
        int((rest & (np.abs(ratio[:, 0] - offset * gate[0]) <= gate[0])).sum())
        for offset in OFFSETS
        if (abs(offset) + 1) * gate[0] * usual <= reach
    ]
    return float(np.mean(counts)) / looks if counts else 0.0


def _wanted(ratio: Floats, gate: float) -> float:
    """The gate that residuals ask for that lie within one."""
    if len(ratio) < 4:
        return gate
    spread = TO_NORMAL * float(np.median(np.abs(ratio - np.median(ratio))))
    return max(gate, GATE * spread) if spread > WIDER else gate


_NONE: Ints = np.zeros(0, np.int64)
