"""What explains errors: systematic effects fitted together, one after the other, as far as they do.

Least squares by Huber's weights, with the standard errors of `plotfeed.models.verdicts`, which hold
where errors of one series hang together.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from plotfeed.models.state import Floats, Ints
from plotfeed.models.verdicts import deviation

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
