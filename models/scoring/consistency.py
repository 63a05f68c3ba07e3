"""Whether tracks err as they say, and how late they are: NEES, lag, and how many samples count."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv

from plotfeed.models.state import Bools, Floats, Ints

MOST_LAGS = 50


def nees(errors_m: Floats, covariances_m2: Floats) -> Floats:
    """Normalised estimation error squared, e' P^-1 e, of errors (n, d) and (n, d, d); (n,).

    NaN where a covariance is not positive definite.
    """
    dimensions = errors_m.shape[1]
    found = np.full(len(errors_m), np.nan)
    finite = np.isfinite(errors_m).all(axis=1) & np.isfinite(covariances_m2).all(axis=(1, 2))
    usable = np.flatnonzero(finite)
    least = np.linalg.eigvalsh(covariances_m2[usable])[:, 0] if len(usable) else np.zeros(0)
    usable = usable[least > 0]
    if len(usable) and dimensions:
        solved = np.linalg.solve(covariances_m2[usable], errors_m[usable, :, None])[:, :, 0]
        found[usable] = (errors_m[usable] * solved).sum(axis=1)
    return found


def nees_interval(samples: float, dimensions: int, share: float = 0.95) -> tuple[float, float]:
    """Bounds between which the mean NEES of so many independent samples lies with that chance.

    Their sum has a chi-squared law of samples x dimensions degrees of freedom.
    """
    if not samples > 0:
        return float("nan"), float("nan")
    beyond = (1 - share) / 2
    bounds = 2 * gammaincinv(samples * dimensions / 2, [beyond, 1 - beyond]) / samples
    return float(bounds[0]), float(bounds[1])


def independent_samples(values: Floats, series: Ints) -> float:
    """How many independent values these (n,) are worth, in the order of time within a series.

    n / (1 + 2 sum of autocorrelations), up to the first that is not positive.
    """
    n = len(values)
    if n < 3:
        return float(n)
    centred = values - values.mean()
    variance = float((centred**2).mean())
    if not variance > 0:
        return float(n)
    total = 1.0
    for lag in range(1, min(MOST_LAGS, n - 1) + 1):
        same = series[lag:] == series[:-lag]
        pairs = int(np.count_nonzero(same))
        if not pairs:
            break
        products = centred[lag:] * centred[:-lag]
        correlation = float(products[same].sum()) / pairs / variance
        if correlation <= 0:
            break
        total += 2 * correlation
    return max(n / total, 1.0)


class Lag(NamedTuple):
    """How far tracks trail along their way."""

    tau_s: float
    """Positive for tracks that are behind."""
    se_s: float


def lag_of(errors_m: Floats, velocities_m_s: Floats, covariances_m2: Floats | None = None) -> Lag:
    """Lag by weighted least squares: an error is -tau v and noise.

    tau = -sum(e' R^-1 v) / sum(v' R^-1 v), from errors and true velocities (n, d), and stated
    covariances R (n, d, d); without them all weigh alike. Its standard error is that of R, times
    the spread that is left where that is larger. NaN where nothing moves.
    """
    none = Lag(float("nan"), float("nan"))
    n, dimensions = errors_m.shape
    if n < 2:
        return none
    weighed = _weighed(velocities_m_s, covariances_m2)
    power = float((velocities_m_s * weighed).sum())
    if not power > 1e-9 * n:
        return none
    tau_s = -float((errors_m * weighed).sum()) / power
    left = errors_m + tau_s * velocities_m_s
    spread = float((left * _weighed(left, covariances_m2)).sum()) / (n * dimensions - 1)
    scale = spread if covariances_m2 is None else max(spread, 1.0)
    return Lag(tau_s, float(np.sqrt(scale / power)))


def _weighed(vectors: Floats, covariances_m2: Floats | None) -> Floats:
    """R^-1 x of vectors x, (n, d); themselves where no covariances are stated."""
    if covariances_m2 is None:
        return vectors
    found: Floats = np.asarray(np.linalg.solve(covariances_m2, vectors[:, :, None])[:, :, 0])
    return found


def survival_quantile(values: Floats, seen: Bools, share: float = 0.5) -> float:
    """The value by which that share has come about, where some never did while they were watched.

    `seen` (n,) says which values are such, and which are only as long as was watched (censored).
    Kaplan and Meier's estimate; infinite where fewer than that share came about.
    """
    if not len(values):
        return float("nan")
    order = np.lexsort((~seen, values))
    at_risk, left = len(values), 1.0
    for value, came in zip(values[order].tolist(), seen[order].tolist(), strict=True):
        if came:
            left *= 1 - 1 / at_risk
            if left <= 1 - share + 1e-12:
                return float(value)
        at_risk -= 1
    return float("inf")
