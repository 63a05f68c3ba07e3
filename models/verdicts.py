"""Verdicts on limits: figures of samples that hang together, with intervals that hold all the same.

A figure is a ratio of sums, or a quantile. The long-run variance of its rows is the mean square of
their lowest cosine coefficients, as few as the correlation leaves alike, and its law Student's t of
as many degrees: Lazarus, Lewis, Stock and Watson, HAR Inference, Journal of Business and Economic
Statistics 36 (2018). Shares have the exact interval of the trials that are left: Korn and Graubard,
Survey Methodology 24 (1998).

How far a figure of several runs may be off by chance says the bootstrap over runs, for these are
independent and the steps within one are not: Efron and Tibshirani, An Introduction to the Bootstrap
(1993), section 13.3, the percentile interval.

What explains errors are systematic effects fitted together, one after the other, as far as they do:
least squares by Huber's weights, with standard errors that hold where errors of one series hang
together.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.state import Floats, Ints

# SciPy takes three times as long to load as NumPy: functions that need it load it.
BOOTSTRAPS, FEWEST_SAMPLES = 2000, 200
MAX_DRAWN = 2_000_000  # Runs times samples that are held
SHARE = 0.95  # Of the interval
FEWEST = 2  # Runs, below which there is no interval


class Interval(NamedTuple):
    """A figure, and between what it lies in 95 of 100 such experiments; NaN is not known."""

    value: float
    low: float
    high: float


NOTHING = Interval(np.nan, np.nan, np.nan)
# Standard deviations of a normal law on either side of its mean that hold 95 % of it.
TWO_SIDED_95 = 1.959964


def share_interval(count: int, of: int) -> tuple[float, float]:
    """95 % interval of a probability of which so many came true; Wilson, 1927."""
    if not of:
        return math.nan, math.nan
    share, z2 = count / of, TWO_SIDED_95**2
    middle = (share + z2 / (2 * of)) / (1 + z2 / of)
    half = TWO_SIDED_95 * math.sqrt(share * (1 - share) / of + z2 / (4 * of**2)) / (1 + z2 / of)
    return max(middle - half, 0.0), min(middle + half, 1.0)


@nan_without_warnings
def ratio_interval(parts: ArrayLike, wholes: ArrayLike, seed: int = 0) -> Interval:
    """The sum of `parts` (n,) over that of `wholes` (n,), one of each a run.

    Runs whose part is NaN are left out. The draws are those of `seed`, so that the same runs have
    the same interval.
    """
    a, b = as_floats(parts), as_floats(wholes)
    known = np.isfinite(a) & np.isfinite(b)
    a, b = a[known], b[known]
    if not len(a) or not b.sum():
        return NOTHING
    value = float(a.sum() / b.sum())
    if len(a) < FEWEST:
        return Interval(value, np.nan, np.nan)
    drawn = _times_drawn(len(a), seed)
    ratios = (drawn @ a) / (drawn @ b)
    edges = [(1 - SHARE) / 2, (1 + SHARE) / 2]
    low, high = np.quantile(ratios[np.isfinite(ratios)], edges)
    return Interval(value, float(low), float(high))


@lru_cache(maxsize=4)
def _times_drawn(runs: int, seed: int) -> Floats:
    """Counts of each run in each sample, (k, n): of many runs fewer samples, which differ less."""
    samples = min(BOOTSTRAPS, max(MAX_DRAWN // runs, FEWEST_SAMPLES))
    rng = np.random.default_rng(seed)
    return as_floats(rng.multinomial(runs, np.full(runs, 1 / runs), samples))


def mean_interval(values: ArrayLike, seed: int = 0) -> Interval:
    """The mean of values (n,), one a run; infinite where that of any run is."""
    values = as_floats(values)
    if np.isinf(values).any():
        return Interval(np.inf, np.inf, np.inf)
    return ratio_interval(values, np.ones_like(values), seed)


# Of the figure, whichever way it is wrong.
RISK = 0.05
# So far the spectrum of the correlation hardly falls: by a tenth, on average.
FLAT = 0.14
# Where nothing varies nobody knows how samples hang together: so many count as one.
NEIGHBOURS = 10.0
RESAMPLES = 1000
FEWEST_RUNS = 3
# In place of infinite figures, of which there is no mean: further than any limit.
BEYOND = 1e12
# One-sided critical values for so many looks at 5 %: Jennison and Turnbull, Group Sequential
# Methods (2000), table 2.1.
POCOCK = (1.645, 1.875, 1.992, 2.067, 2.122)


class FigureSamples(NamedTuple):
    """What a figure is of: rows (n,), by series and by time within it.

    The figure is (sum of `parts` / sum of `wholes`) ^ `power`, or the `quantile` of the parts. Of a
    share, parts are numbers of trials of which wholes are all.
    """

    parts: Floats
    wholes: Floats
    series: Ints
    power: float = 1.0
    quantile: float | None = None
    is_share: bool = False

    @property
    def value(self) -> float:
        """The figure; NaN of nothing."""
        if self.quantile is not None:
            return float(np.quantile(self.parts, self.quantile)) if len(self.parts) else np.nan
        whole = float(self.wholes.sum())
        return float((self.parts.sum() / whole) ** self.power) if whole > 0 else np.nan

    @nan_without_warnings
    def interval(self, risk: float = RISK / 2) -> Interval:
        """The figure between bounds, each of which is wrong with that chance at most.

        They are far where samples hang together for so long that hardly anything can be said.
        """
        if not len(self.parts) or not self.wholes.sum() > 0:
            return NOTHING
        if self.quantile is not None:
            return self._of_quantile(self.quantile, risk)
        from scipy.special import stdtrit

        ratio = float(self.parts.sum() / self.wholes.sum())
        if self.is_share:
            left = _trials_left(self.wholes, self.parts, self.series, risk)
            low, high = _of_trials(ratio, left, risk)
        else:
            se, freedom = deviation(self.parts - ratio * self.wholes, self.series)
            reach = se / float(self.wholes.sum()) * len(self.parts) * -float(stdtrit(freedom, risk))
            low, high = ratio - reach, ratio + reach
        least = low if self.power == 1.0 else max(low, 0.0)
        return Interval(self.value, float(least**self.power), float(high**self.power))

    @property
    def trials(self) -> float:
        """How many independent trials a share is worth; NaN where it is none."""
        if not self.is_share or not self.wholes.sum() > 0:
            return np.nan
        return _trials_left(self.wholes, self.parts, self.series, RISK / 2)

    def _of_quantile(self, share: float, risk: float) -> Interval:
        value, n = self.value, len(self.parts)
        ones = np.ones(n)
        below = (self.parts <= value).astype(np.float64)
        low, high = _of_trials(share, _trials_left(ones, below, self.series, risk), risk)
        least = float(np.quantile(self.parts, low)) if low * n >= 1 else -np.inf
        most = float(np.quantile(self.parts, high)) if (1 - high) * n >= 1 else np.inf
        return Interval(value, least, most)


def deviation(rows: Floats, series: Ints) -> tuple[float, float]:
    """The standard error of the mean of rows (n,) whose mean is 0, and its degrees of freedom.

    Rows are by series, such as flights, and by time within them. Of less than four it is infinite.
    """
    n = len(rows)
    squares = float(rows @ rows)
    if n < 4:
        return np.inf, 1.0
    if not squares > 0:
        return 0.0, float(n)
    same = series[1:] == series[:-1]
    along = float((rows[1:] * rows[:-1])[same].sum()) / max(squares * float(same.mean()), 1e-300)
    # A correlation comes out too small of few samples: Kendall, Biometrika 41 (1954).
    along = min(max(along + (1 + 3 * along) / n, 0.0), 0.999)
    cosines = int(min(0.4 * n ** (2 / 3), FLAT * (1 - along) * n / np.sqrt(max(along, 1e-3))))
    if cosines < 1:  # what is there is worth one sample, of which only the spread is known
        return float(np.sqrt(squares / n)), 1.0
    from scipy.fft import dct

    lowest = dct(rows, norm="ortho")[1 : cosines + 1]
    return float(np.sqrt((lowest**2).mean() / n)), float(cosines)


def _trials_left(wholes: Floats, parts: Floats, series: Ints, risk: float) -> float:
    """How many independent trials say as much of a share."""
    from scipy.special import ndtri, stdtrit

    trials = float(wholes.sum())
    found = float(parts.sum()) / trials
    se, freedom = deviation(parts - found * wholes, series)
    se *= len(parts) / trials
    if not 0 < se < np.inf:
        return trials / NEIGHBOURS if se == 0 else 0.0
    narrower = float(ndtri(risk) / stdtrit(freedom, risk)) ** 2
    return min(found * (1 - found) / se**2 * narrower, trials)


def _of_trials(share: float, left: float, risk: float) -> tuple[float, float]:
    """Bounds of a share of independent trials, by Clopper and Pearson."""
    from scipy.special import betaincinv

    hits = share * left
    low = float(betaincinv(hits, left - hits + 1, risk)) if hits > 0 else 0.0
    high = float(betaincinv(hits + 1, left - hits, 1 - risk)) if hits < left else 1.0
    return low, high


def seeds_interval(
    values: Floats,
    risk: float = RISK / 2,
    trials: Floats | None = None,
    *,
    are_counts: bool = False,
) -> Interval:
    """The mean of a figure over runs (n,), which are independent, by Student's t.

    Runs may be alike by chance, and tell no spread: bounds of a share, of `trials` in each run
    (n,), NaN where the figure is none, are no narrower than those of all these trials, and bounds
    of counts than those of Poisson's law. The mean is infinite where that of any run is, such as
    the time to see most drones where most were never seen.
    """
    from scipy.special import gammaincinv, stdtrit

    if np.isinf(values).any():
        return Interval(np.inf, np.inf, np.inf)
    values = values[np.isfinite(values)]
    n = len(values)
    if n < FEWEST_RUNS:
        return Interval(float(values.mean()), -np.inf, np.inf) if n else NOTHING
    mean, spread = float(values.mean()), float(values.std(ddof=1)) / np.sqrt(n)
    reach = spread * -float(stdtrit(n - 1, risk))
    low, high = mean - reach, mean + reach
    if trials is not None and np.isfinite(trials).any():
        least, most = _of_trials(mean, float(np.nansum(trials)), risk)
        low, high = min(low, least), max(high, most)
    if are_counts:
        least, most = (float(gammaincinv(k, p)) / n if k > 0 else 0.0
                       for k, p in ((mean * n, risk), (mean * n + 1, 1 - risk)))  # fmt: skip
        low, high = min(low, least), max(high, most)
    return Interval(mean, low, high)


def look_risk(looks: int, risk: float = RISK) -> float:
    """The risk of each of up to 5 looks, at which they have that of `risk` together."""
    from scipy.special import ndtr

    return float(ndtr(-POCOCK[looks - 1])) * risk / RISK


Decision = Literal["passed", "failed", "undecided", "not testable"]


def decided(figure: Interval, at_most: float | None, at_least: float | None) -> Decision:
    """Whether a figure keeps its limit by the bounds that it lies between."""
    if np.isnan(figure.value):
        return "not testable"
    most = np.inf if at_most is None else at_most
    least = -np.inf if at_least is None else at_least
    if least <= figure.low and figure.high <= most:
        return "passed"
    return "failed" if figure.low > most or figure.high < least else "undecided"


def times_more(figure: Interval, limit: float) -> float:
    """How many times as many samples would decide, if the figure stayed where it is."""
    apart = abs(figure.value - limit)
    reach = (figure.high if limit > figure.value else 2 * figure.value - figure.low) - figure.value
    return (reach / apart) ** 2 if apart > 0 and np.isfinite(reach) else np.inf


def breaking_level(
    levels: Floats, values: Floats, limit: float, *, rises: bool, risk: float = RISK / 2
) -> Interval:
    """Find the level (k,) at which a figure breaks its limit, of values (k, runs) by seeds.

    `rises` says that the limit is the most it may be. Means are made monotone, in the direction in
    which they get worse, and break where they cross; bounds are by the bootstrap over runs, the
    first the worse one. Infinite where all levels keep the limit, and minus infinity where none.
    """
    from scipy.optimize import isotonic_regression

    order = np.argsort(levels)
    levels, values = levels[order], values[order] if rises else -values[order]
    known = np.clip(values[:, ~np.isnan(values).any(axis=0)], -BEYOND, BEYOND)
    runs = known.shape[1]
    if not runs or len(levels) < 2:
        return NOTHING
    if np.polyfit(np.arange(len(levels)), known.mean(axis=1), 1)[0] < 0:
        levels, known = levels[::-1], known[::-1]
    bound = limit if rises else -limit

    def crossing(of: Floats) -> float:
        """Where the means cross, counted in levels."""
        fitted = isotonic_regression(of).x
        k = int(np.searchsorted(fitted, bound, side="right"))
        if k in (0, len(fitted)):
            return np.inf if k else -np.inf
        return k - 1 + float((bound - fitted[k - 1]) / (fitted[k] - fitted[k - 1]))

    rng = np.random.default_rng(0)
    drawn = [crossing(known[:, rng.integers(0, runs, runs)].mean(axis=1)) for _ in range(RESAMPLES)]
    beyond = int(risk * RESAMPLES)
    found = [crossing(known.mean(axis=1)), *np.sort(drawn)[[beyond, -1 - beyond]]]
    if runs < FEWEST:
        found[1:] = [np.nan] * 2
    at = [x if np.isinf(x) else float(np.interp(x, range(len(levels)), levels)) for x in found]
    return Interval(*at)


# That any effect is named of errors that have none.
FAMILY = 0.01
# Of the sum of squares that an effect must explain to matter.
MATTERS = 0.1
# Of what an effect explains, what another may leave and still be as good.
AS_GOOD = 0.1
# Of spreads, from which on a row weighs less: 95 % efficient of normal errors.
HUBER = 1.345
ROUNDS = 4


class FittedEffect(NamedTuple):
    """An effect, how large it is, in its unit, and which others explain the same as well."""

    name: str
    value: float
    se: float
    others: tuple[str, ...]


def joint_fit(errors: Floats, effects: Mapping[str, Floats], series: Ints) -> list[FittedEffect]:
    """The effects that errors (n, d) have, of those that are given as what a unit of each does.

    Effects are (n, d) too, and NaN where they do nothing that is known. Rows are by series and
    time. The largest comes first, all with the values that they have together.
    """
    given = {name: np.nan_to_num(column) for name, column in effects.items()}
    known = np.isfinite(errors)
    errors = np.where(known, errors, 0.0)
    given = {name: np.where(known, column, 0.0) for name, column in given.items()}
    chosen: list[str] = []
    twins: dict[str, tuple[str, ...]] = {}
    left = _left(errors, given, chosen)
    while len(chosen) < len(given):
        found = {n: _left(errors, given, [*chosen, n]) for n in given if n not in chosen}
        best = min(found, key=lambda name: found[name])
        saved = left - found[best]
        if not saved > MATTERS * left or not _is_seen(errors, given, [*chosen, best], series):
            break
        twins[best] = tuple(
            n for n in found if n != best and found[n] - found[best] < AS_GOOD * saved
        )
        chosen.append(best)
        left = found[best]
    found_all = [(name, _one_of(errors, given, chosen, name, series)) for name in chosen]
    return [FittedEffect(name, value, se, twins[name]) for name, (value, se, _) in found_all]


def _matrix(given: Mapping[str, Floats], chosen: list[str]) -> Floats:
    n = next(iter(given.values())).size
    return (
        np.stack([given[name].ravel() for name in chosen], axis=1) if chosen else np.zeros((n, 0))
    )


def _fitted(
    errors: Floats, given: Mapping[str, Floats], chosen: list[str]
) -> tuple[Floats, Floats]:
    """Values of the effects, (k,), and weights of the rows, (n,)."""
    matrix, y = _matrix(given, chosen), errors.ravel()
    d = errors.shape[1]
    weights = np.ones(len(errors))
    values: Floats = np.zeros(matrix.shape[1])
    for _ in range(ROUNDS):
        root = np.sqrt(np.repeat(weights, d))
        values = np.asarray(np.linalg.lstsq(matrix * root[:, None], y * root, rcond=1e-9)[0])
        apart = np.sqrt(((errors - (matrix @ values).reshape(errors.shape)) ** 2).sum(axis=1))
        spread = max(float(np.median(apart)), 1e-9)
        weights = np.minimum(1.0, HUBER * spread / np.maximum(apart, 1e-12))
    return values, weights


def _left(errors: Floats, given: Mapping[str, Floats], chosen: list[str]) -> float:
    """The mean of squares that those effects leave, of which none counts more than others."""
    values, _ = _fitted(errors, given, chosen)
    rest = errors - (_matrix(given, chosen) @ values).reshape(errors.shape)
    squares = np.sort((rest**2).sum(axis=1))
    return float(squares[: max(int(0.9 * len(squares)), 1)].mean())


def _is_seen(errors: Floats, given: Mapping[str, Floats], chosen: list[str], series: Ints) -> bool:
    """Whether the last of those effects is more than chance."""
    from scipy.special import stdtr

    value, se, freedom = _one_of(errors, given, chosen, chosen[-1], series)
    if not 0 < se < np.inf:
        return bool(se == 0)
    return bool(2 * stdtr(freedom, -abs(value) / se) < FAMILY / len(given))


def _one_of(
    errors: Floats, given: Mapping[str, Floats], chosen: list[str], name: str, series: Ints
) -> tuple[float, float, float]:
    """An effect among others, its standard error, and the degrees of freedom of that."""
    (values, weights), k, d = _fitted(errors, given, chosen), chosen.index(name), errors.shape[1]
    root = np.sqrt(np.repeat(weights, d))
    matrix = _matrix(given, chosen)
    others = np.delete(matrix, k, axis=1) * root[:, None]
    own = matrix[:, k] * root
    own = own - others @ np.linalg.lstsq(others, own, rcond=1e-9)[0]
    power = float(own @ own)
    if not power > 1e-9:
        return float(values[k]), np.inf, 1.0
    rows = (own * (errors.ravel() - matrix @ values) * root).reshape(-1, d).sum(axis=1)
    se, freedom = deviation(rows, series)
    return float(values[k]), se * len(rows) / power, freedom
