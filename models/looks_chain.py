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

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.numerics import unit_interval
from plotfeed.models.state import Floats, Ints

BLOCK_ELEMENTS = 1 << 22
"""Size of the tables behind a draw: 32 MB."""
_TAIL = 36.0
"""Means of an exponential beyond which 2e-16 of it lies."""


def outlasting(snrs: Floats, multiplier: Floats, n_samples: int) -> Floats:
    """Probability that the looks outlast the samples; (...)."""
    return _chance(snrs, multiplier, n_samples, at_the_end=1.0)


def draw_outlasting(
    snrs: Floats, multiplier: float, n_samples: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Sums of looks that outlast their samples, and the sums of these; (n, K) in, (n,) out."""
    block = max(1, BLOCK_ELEMENTS // (snrs.shape[-1] * (n_samples + 1)))
    starts = range(0, max(len(snrs), 1), block)
    parts = [_draw_block(snrs[i : i + block], multiplier, n_samples, rng) for i in starts]
    powers, samples = zip(*parts, strict=True)
    return np.concatenate(powers), np.concatenate(samples)


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
    chance = np.empty_like(ends)
    chance.T[...] = at_the_end
    for _ in range(n_samples):
        _carry_back(chance, ends, goes_on)
    return np.asarray(chance[0])


def _draw_block(
    snrs: Floats, multiplier: float, n_samples: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Sums, look by look: how many samples it outlasts given the success, and then the times.

    Whatever ends first, the time until then is exponential of mean (1+S)/(multiplier+1+S), in
    units of the samples, so that times are gamma distributed by the number of ends. Without memory,
    the look that lasts at the end is from there on as long as a new one.
    """
    ends, goes_on = _odds(snrs, np.asarray(multiplier))
    chances = np.empty((n_samples + 1, *ends.shape))
    chances[0] = 1.0
    for n in range(n_samples):
        chances[n + 1] = chances[n]
        _carry_back(chances[n + 1], ends, goes_on)
    samples_left = np.full(len(snrs), n_samples)
    reference_sum, beyond = np.zeros(len(snrs)), np.zeros(len(snrs))
    for i, mean in enumerate(1 + snrs.T):
        is_last = i == len(ends) - 1
        outlasted = (
            samples_left
            if is_last
            else _draw_outlasted(chances[:, i], goes_on[i], samples_left, rng)
        )
        own_end = outlasted < samples_left
        reference_sum += goes_on[i] * rng.standard_gamma(outlasted + own_end, (len(snrs),))
        samples_left = samples_left - outlasted
        rest = mean * rng.standard_exponential((len(snrs),))
        beyond += np.where(samples_left == 0, rest, 0.0)
    return multiplier * reference_sum + beyond, reference_sum


def _draw_outlasted(
    chance: Floats, goes_on: Floats, samples_left: Ints, rng: np.random.Generator
) -> Ints:
    """How many of the samples left a look outlasts, given that all looks outlast all; (n,).

    `chance` is that of success from this look on with 0, 1, ... samples left; (samples + 1, n).
    Outlasting one more sample and then succeeding becomes less probable with each: the number
    follows by inversion.
    """
    left = np.arange(len(chance))[:, None]
    at_least = chance / goes_on**left  # with so many left, over what no longer depends on it
    level = (
        rng.random((len(samples_left),)) * np.take_along_axis(at_least, samples_left[None], 0)[0]
    )
    return np.asarray(((at_least > level) & (left < samples_left)).sum(axis=0))


def _odds(snrs: Floats, multiplier: Floats) -> tuple[Floats, Floats]:
    """Odds of the look ending first, and of the sample; (K, ...), looks first."""
    shape = np.broadcast_shapes(snrs.shape[:-1], multiplier.shape)
    mean = 1 + np.moveaxis(np.broadcast_to(snrs, (*shape, snrs.shape[-1])), -1, 0)
    share = multiplier / mean
    return 1 / (1 + 1 / share), 1 / (1 + share)


def _carry_back(chance: Floats, ends: Floats, goes_on: Floats) -> None:
    """Turn the chances within each look to those one sample before, in place; (K, ...)."""
    chance *= goes_on
    for i in range(len(chance) - 2, -1, -1):
        chance[i] += ends[i] * chance[i + 1]
