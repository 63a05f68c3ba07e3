"""Laws of delay, of the shapes that netem has; delays of successive and of repeated messages."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.models import special
from plotfeed.models.state import Floats, Ints

# In jitters: netem's tables are of 16 bits with 8192 to a jitter, so that none goes further.
CLIP = 4.0
# Pareto's law of shape 3 from 1 on has the mean 1.5; iproute2 subtracts that and multiplies by
# 4/3, so that its standard deviation is 2/sqrt(3) jitters before it is clipped, and 0.82 after.
PARETO_SHAPE = 3.0
PARETO_MEAN = 1.5
PARETO_SCALE = 4 / 3
NORMAL_PART = 0.25  # Of a paretonormal delay; the rest is Pareto, at the same probability


def _normal(u: Floats) -> Floats:
    score: Floats = np.minimum(np.maximum(special.ndtri(u), -CLIP), CLIP)
    return score


def _pareto(u: Floats) -> Floats:
    tail = np.maximum(1 - u, 1e-3)  # below a hundredth it is clipped
    return np.minimum((tail ** (-1 / PARETO_SHAPE) - PARETO_MEAN) * PARETO_SCALE, CLIP)


# Quantile functions of (delay - latency) / jitter.
SHAPES: dict[str, Callable[[Floats], Floats]] = {
    "normal": _normal,
    "uniform": lambda u: 2 * u - 1,
    "pareto": _pareto,
    "paretonormal": lambda u: NORMAL_PART * _normal(u) + (1 - NORMAL_PART) * _pareto(u),
}
HALVINGS = 50  # By which a probability is found to the last digit that matters


CELLS = 1 << 13  # Of equal probability by the law: distances are known to one part in as many
MET = 0.1  # Share of a cell by which a law may miss an edge, as it does within an atom
HALF_A_NS = 0.5  # Delays are whole nanoseconds, so that a law's atom is met from below


@dataclass(frozen=True, slots=True)
class DelayLaw:
    """How long messages take, in milliseconds; never below 0."""

    latency_ms: float
    jitter_ms: float = 0.0
    shape: str = "normal"
    sample_ms: Floats | None = None  # Ascending; in place of jitter and shape

    @classmethod
    def of(cls, link: LinkSettings) -> DelayLaw:
        """The law that a link asks for."""
        if link.delays_ms is not None:
            return cls(link.latency_ms, sample_ms=np.sort(np.array(link.delays_ms)))
        return cls(link.latency_ms, link.jitter_ms, link.distribution)

    @property
    def is_constant(self) -> bool:
        """Whether all messages take the same time."""
        return self.sample_ms is None and not self.jitter_ms

    def quantile_ms(self, u: ArrayLike) -> Floats:
        """Delays at those probabilities, from 0 to 1; any shape in, the same out."""
        at = np.asarray(u, dtype=np.float64)
        if self.sample_ms is not None:
            rank = np.arange(len(self.sample_ms))
            beyond: Floats = np.interp(at * rank[-1], rank, self.sample_ms)
            return self.latency_ms + beyond
        if not self.jitter_ms:
            return np.full(at.shape, self.latency_ms)
        return np.maximum(self.latency_ms + self.jitter_ms * SHAPES[self.shape](at), 0.0)

    def cdf(self, delay_ms: ArrayLike) -> Floats:
        """Probability of a delay up to those; any shape in, the same out.

        The greatest one whose quantile is no longer, by halving: so where many take the same time,
        it leaps.
        """
        at = np.asarray(delay_ms, dtype=np.float64)
        low, high = np.zeros(at.shape), np.ones(at.shape)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            is_within = self.quantile_ms(middle) <= at
            low, high = np.where(is_within, middle, low), np.where(is_within, high, middle)
        least_ms, most_ms = self.quantile_ms([0.0, 1.0])
        return np.where(at < least_ms, 0.0, np.where(at >= most_ms, 1.0, low))

    def mean_ms(self) -> float:
        """Mean of the delay, by 4096 of its quantiles."""
        return float(self.quantile_ms(_MIDDLES).mean())

    def mean_deviation_ms(self) -> float:
        """Mean distance from the mean, by 4096 quantiles."""
        delays_ms = self.quantile_ms(_MIDDLES)
        return float(np.abs(delays_ms - delays_ms.mean()).mean())

    def distance(self, delays_ns: Ints) -> float:
        """Kolmogorov's distance of delays from the law; NaN of none, and of a law without a spread.

        Probabilities that no delay has, within the law's atoms, are left out.
        """
        edges = np.arange(1, CELLS) / CELLS
        met = np.abs(self.cdf(self.quantile_ms(edges)) - edges) < MET / CELLS
        if not len(delays_ns) or not met.any():
            return math.nan
        below = self.cdf((delays_ns + HALF_A_NS) / 1e6)
        # What ends at an edge, within what counts as met of it, lies below it: so do atoms.
        cells = np.clip(np.ceil(below * CELLS - MET).astype(np.int64) - 1, 0, CELLS - 1)
        seen = np.cumsum(np.bincount(cells, minlength=CELLS))[:-1] / len(delays_ns)
        return float(np.abs(seen - edges)[met].max())


_MIDDLES = (np.arange(4096) + 0.5) / 4096


LEAST_MARGIN_MS = 200.0
MOST_WAIT_MS = 120_000.0
# As Linux, which then gives up; here the last of them arrives, since nothing is to be lost.
MOST_REPEATS = 15


def waits_ns(law: DelayLaw) -> tuple[int, ...]:
    """Time from a message's first sending to its n-th repeat, for n from 0 to the most.

    The way back is taken to be like the way there, and to vary on its own.
    """
    deviation_ms = math.sqrt(2) * law.mean_deviation_ms()
    time_out_ms = 2 * law.mean_ms() + max(LEAST_MARGIN_MS, 4 * deviation_ms)
    waits, total_ms = [0], 0.0
    for n in range(MOST_REPEATS):
        total_ms += min(time_out_ms * 2**n, MOST_WAIT_MS)
        waits.append(round(total_ms * 1e6))
    return tuple(waits)


class DelaySeries:
    """Delays each of which is drawn from the law of the link, exactly.

    With a correlation their normal scores are an autoregression of the first order: z = rho z' +
    sqrt(1 - rho^2) e, and the delay is the law's quantile at Phi(z). A copy of a message comes
    after it as the next message does, and nothing comes after the copy.
    """

    def __init__(self, link: LinkSettings, score: float | None = None) -> None:
        self._law = DelayLaw.of(link)
        self._rho = link.delay_correlation
        self._new = (1 - link.delay_correlation**2) ** 0.5
        self._scores: list[float] = []
        self.score = score  # Of the last message; None if there was none

    def use(self, messages: int) -> None:
        """Count how many of the last draws have been used: what is drawn next follows those."""
        if self._scores and messages:
            self.score = self._scores[messages - 1]
        self._scores = []

    def draw(self, own: Floats, copies: Floats | None) -> tuple[list[int], list[int]]:
        """Delays in nanoseconds of messages and of their copies, from uniform numbers."""
        if self._law.is_constant:
            constant = [round(self._law.latency_ms * 1e6)] * len(own)
            return constant, constant
        if self._rho:
            z = self.score
            for e in _scores(own).tolist():
                z = e if z is None else self._rho * z + self._new * e
                self._scores.append(z)
            after = np.array(self._scores)
            own = special.ndtr(after)
            if copies is not None:
                copies = special.ndtr(self._rho * after + self._new * _scores(copies))
        return self._ns(own), [] if copies is None else self._ns(copies)

    def _ns(self, u: Floats) -> list[int]:
        delays: list[int] = np.rint(self._law.quantile_ms(u) * 1e6).astype(np.int64).tolist()
        return delays


def _scores(u: Floats) -> Floats:
    scores: Floats = special.ndtri(np.maximum(u, 2.0**-54))  # a uniform number may be 0
    return scores
