"""False alarms: how many of a number of resolution cells alarm, and where.

Each cell alarms independently with probability `pfa`: the number is binomial (eq 9 gives its
mean). Cells need not be whole: cover is not a multiple of beams. They are counted exactly up to
2**53.
"""

from __future__ import annotations

from math import ceil, floor

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.beam import AzimuthCover, Sector
from plotfeed.models.frames import wrap_360
from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.state import Floats

POISSON_BELOW_PFA = 1e-8
"""Pfa below which a Poisson draw is nearer to the binomial than 1 - Pfa in float64 allows."""
_ROUNDING = 4e-15
"""By which a quotient may exceed a whole number that it is."""


def cells_across(cover: float, width: float) -> float:
    """How many cells of that width cover holds; a beam wider than all of it is one."""
    return max(cover / width, 1.0)


def whole_cells(cells: float, pfa: float) -> tuple[int, float]:
    """Whole cells, and their Pfa, that alarm as often on average as those: the next number up."""
    whole = ceil(cells * (1 - _ROUNDING))
    return (whole, pfa * min(cells / whole, 1.0)) if whole else (0, pfa)


@nan_without_warnings
def probability_at_least_one(cells: ArrayLike, pfa: ArrayLike) -> Floats:
    """Probability that some cell alarms; accurate where it is tiny."""
    return as_floats(-np.expm1(as_floats(cells) * np.log1p(-as_floats(pfa))))


def draw_count(cells: int, pfa: float, rng: np.random.Generator) -> int:
    """How many false alarms: binomial, for any number of cells and however small a Pfa."""
    rare = pfa < POISSON_BELOW_PFA
    return int(rng.poisson(cells * pfa) if rare else rng.binomial(cells, pfa))


def cells_between(total_cells: int, start_fraction: float, end_fraction: float) -> int:
    """Cells of a sector of a scan, of its share [start, end) of the cover.

    Sectors that meet share no cell and leave none out: those of a scan sum to its cells exactly.
    """
    return _cells_before(total_cells, end_fraction) - _cells_before(total_cells, start_fraction)


def draw_azimuths(
    cells: float, pfa: float, cover: AzimuthCover, sector: Sector, rng: np.random.Generator
) -> Floats:
    """Azimuths of the false alarms of a sector, degrees, uniform over what it has of the cover.

    Over a scan their mean number is cells times Pfa exactly.
    """
    whole, pfa_each = whole_cells(cells, pfa)
    found = [np.zeros(0)]
    for start, end in cover.shares_in(sector):
        n = draw_count(cells_between(whole, start, end), pfa_each, rng)
        found.append(rng.uniform(start, end, n))  # eqs 10, 11
    return wrap_360(cover.min_deg + np.concatenate(found) * cover.span_deg)


def _cells_before(total_cells: int, fraction: float) -> int:
    """The nearest whole number of cells.

    A hair off one half, where equal sectors put their borders: two roundings of the same border
    must not come out on different sides.
    """
    return floor(total_cells * fraction + 0.500001)
