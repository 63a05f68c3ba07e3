"""Sums of looks of any signal-to-noise ratios against a sum of reference samples, exactly.

The reference samples, unit exponentials, are laid end to end: `multiplier` times as long, they are
the threshold. The looks' powers, exponentials of mean 1+S, are laid beside them in their order.
While a look lasts, what ends next is the look, with probability multiplier/(multiplier+1+S), or a
reference sample: exponentials have no memory. The sum of the looks exceeds the threshold when the
looks outlast all samples.

This is the uniformised chain of the phase-type distribution with its sum over the number of steps,
which is negative-binomial, done in closed form: nothing is truncated, and every probability is a
sum of products of positive numbers, so that ties, extreme ratios and tiny probabilities keep their
digits. The relative error is some (samples + looks) times that of float64.

`snrs` is (..., K), looks on the last axis, at least zero; `multiplier` broadcasts against (...).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.numerics import unit_interval
from plotfeed.models.state import Floats, Ints

BLOCK_ELEMENTS = 1 << 15
"""Numbers of a table that are worked on at once: 256 kB."""
KEPT_ELEMENTS = 1 << 22
"""Size of the tables that are kept for a draw: 32 MB."""
CERTAIN = 1 - 1e-12
"""What a probability is taken to be at least of, whatever rounding has done."""
_TAIL = 36.0
"""Means of an exponential beyond which 2e-16 of it lies."""


def outlasting(snrs: Floats, multiplier: Floats, n_samples: int) -> Floats:
    """Probability that the looks outlast the samples; (...)."""
    return _chance(snrs, multiplier, n_samples, at_the_end=1.0)


def draw_outlasting(
    snrs: Floats, multiplier: float, n_samples: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Sums of looks that outlast their samples, and the sums of these; (n, K) in, (n,) out.

    Look by look: how many samples it outlasts given the success, and then the times. Whatever ends
    first, the time until then is exponential of mean (1+S)/(multiplier+1+S), in units of the
    samples, so that times are gamma distributed by the number of ends. Without memory, the look
    that lasts at the end is from there on as long as a new one.
    """
    n = len(snrs)
    ends, goes_on = _odds(snrs, np.asarray(multiplier))
    outlasting_them = _Outlasting(ends, goes_on, n_samples)
    samples_left = np.full(n, n_samples)
    reference_sum, beyond = np.zeros(n), np.zeros(n)
    for i, mean in enumerate(1 + snrs.T):
        outlasted = samples_left
        if i < len(ends) - 1:
            outlasted = outlasting_them.draw(i, rng.random((n,)), samples_left)
        own_end = outlasted < samples_left
        reference_sum += goes_on[i] * rng.standard_gamma(outlasted + own_end, (n,))
        samples_left = samples_left - outlasted
        rest = mean * rng.standard_exponential((n,))
        beyond += np.where(samples_left == 0, rest, 0.0)
    return multiplier * reference_sum + beyond, reference_sum


def mean_inverse(snrs: Floats, multiplier: Floats, n_samples: int) -> Floats:
    """Mean of 1/sum over the sums of looks that outlast the samples; (...). Finite SNRs only.

    At x, the sum has the density of the last look lasting there, over 1+S. For a reference sum g
    and x = y g, the mean of 1/x is the integral of that density over the logarithm of y, from the
    multiplier on; its average over g is a chance of the chain. Gauss and Legendre integrate, to
    less than 1e-8.
    """
    n_looks = snrs.shape[-1]
    in_last_look = np.zeros(n_looks)
    in_last_look[-1] = 1.0
    # The tail falls exponentially where samples are many, as y**-n_samples where they are few.
    largest = (1 + snrs.max(axis=-1)) * (n_looks + _TAIL) / n_samples
    low = np.log(multiplier)
    width = np.log(np.maximum(largest, multiplier)) + _TAIL / n_samples - low
    nodes, weights = unit_interval()
    integral = np.zeros(width.shape)
    for node, weight in zip(nodes, weights, strict=True):
        y = np.exp(low + width * node)
        lasting = _chance(snrs, y, n_samples, at_the_end=in_last_look)
        integral += weight * width * lasting
    return integral / (1 + snrs[..., -1]) / outlasting(snrs, multiplier, n_samples)


def _chance(snrs: Floats, multiplier: Floats, n_samples: int, *, at_the_end: ArrayLike) -> Floats:
    """Chance of what has those after the last sample within each look, (K,), else none; (...).

    Carried back sample by sample to the start of the first look.
    """
    ends, goes_on = _odds(snrs, multiplier)
    chances = np.empty(ends.shape[1:], ends.dtype)
    n_looks, rows = len(ends), chances.size
    flat, ends, goes_on = (
        chances.reshape(-1),
        ends.reshape(n_looks, -1),
        goes_on.reshape(n_looks, -1),
    )
    for part in _blocks(rows, n_looks):
        of_part = ends[:, part], goes_on[:, part]
        chance = np.empty_like(of_part[0])
        chance.T[...] = at_the_end
        back = _Backwards(chance, *of_part)
        for _ in range(n_samples):
            back.step()
        flat[part] = chance[0]
    return chances


class _Outlasting:
    """How many samples each look outlasts, given that all looks outlast all of them."""

    def __init__(self, ends: Floats, goes_on: Floats, n_samples: int) -> None:
        self._ends = ends
        self._goes_on = goes_on
        self._n_samples = n_samples
        self._kept: Floats | None = None
        self._place = np.full(ends.shape[1], -1)

    def draw(self, look: int, level: Floats, samples_left: Ints) -> Ints:
        """How many of the samples left a look outlasts; (n,), by inversion from uniform levels.

        That of a strong look nearly always outlasts them all: as it does by itself with probability
        goes_on**samples_left, given the success it does at least with that.
        """
        outlasted = samples_left.copy()
        surely = level < self._goes_on[look] ** samples_left * CERTAIN
        doubtful = np.flatnonzero(~surely & (samples_left > 0))
        for part in _blocks(len(doubtful), self._n_samples + 1):
            rows = doubtful[part]
            outlasted[rows] = _inverted(
                level[rows],
                self._chances(look, rows, doubtful),
                self._goes_on[look, rows],
                samples_left[rows],
            )
        return outlasted

    def _chances(self, look: int, rows: Ints, doubtful: Ints) -> Floats:
        """Chances of success from a look on with 0, 1, ... samples left; (samples + 1, n).

        All looks of a row are worked out at once and kept, as far as there is room: whatever is in
        doubt later is so at the first look.
        """
        if self._kept is None:
            n_looks = len(self._ends) - 1
            some = doubtful[: KEPT_ELEMENTS // (n_looks * (self._n_samples + 1))]
            self._place[some] = np.arange(len(some))
            self._kept = np.empty((n_looks, self._n_samples + 1, len(some)))
            for part in _blocks(len(some), len(self._ends)):
                _fill(
                    self._kept[:, :, part], self._ends[:, some[part]], self._goes_on[:, some[part]]
                )
        place = self._place[rows]
        if (place >= 0).all():
            return np.asarray(self._kept[look][:, place])
        table = np.empty((1, self._n_samples + 1, len(rows)))
        _fill(table, self._ends[look:, rows], self._goes_on[look:, rows])
        return np.asarray(table[0])


def _fill(table: Floats, ends: Floats, goes_on: Floats) -> None:
    """Write chances of success from each look on, by samples left; (looks, samples + 1, n)."""
    chance = np.ones_like(ends)
    back = _Backwards(chance, ends, goes_on)
    table[:, 0] = 1.0
    for n in range(1, table.shape[1]):
        back.step()
        table[:, n] = chance[: len(table)]


def _inverted(level: Floats, chances: Floats, goes_on: Floats, samples_left: Ints) -> Ints:
    """How many of the samples left a look of those chances outlasts; (n,).

    Outlasting one more sample and then succeeding becomes less probable with each.
    """
    left = np.arange(len(chances))[:, None]
    at_least = chances / goes_on**left  # with so many left, over what no longer depends on it
    above = level * np.take_along_axis(at_least, samples_left[None], 0)[0]
    return np.asarray(((at_least > above) & (left < samples_left)).sum(axis=0))


def _odds(snrs: Floats, multiplier: Floats) -> tuple[Floats, Floats]:
    """Odds of the look ending first, and of the sample; (K, ...), looks first."""
    shape = np.broadcast_shapes(snrs.shape[:-1], multiplier.shape)
    looks_first = np.moveaxis(np.broadcast_to(snrs, (*shape, snrs.shape[-1])), -1, 0)
    mean = np.add(looks_first, 1, order="C")
    share = multiplier / mean
    return 1 / (1 + 1 / share), 1 / (1 + share)


class _Backwards:
    """Chances within each look, (K, n), that are turned to those of one sample before, in place."""

    def __init__(self, chance: Floats, ends: Floats, goes_on: Floats) -> None:
        self._chance = chance
        self._goes_on = goes_on
        self._looks = [(chance[i], ends[i], chance[i + 1]) for i in range(len(chance) - 2, -1, -1)]
        self._product = np.empty(chance.shape[1:], chance.dtype)

    def step(self) -> None:
        """One sample back."""
        product = self._product
        np.multiply(self._chance, self._goes_on, out=self._chance)
        for own, ends, following in self._looks:
            np.multiply(ends, following, out=product)
            np.add(own, product, out=own)


def _blocks(rows: int, each: int) -> Iterator[slice]:
    """Parts of rows, of which each takes so many numbers, that stay near the processor."""
    block = max(1, BLOCK_ELEMENTS // each)
    return (slice(start, start + block) for start in range(0, rows, block))
