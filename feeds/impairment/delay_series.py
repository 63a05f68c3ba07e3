"""Delays of successive messages, correlated or not."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from plotfeed.feeds.impairment.delays import DelayLaw
from plotfeed.feeds.impairment.settings import Link
from plotfeed.models.state import Floats


class DelaySeries:
    """Delays each of which is drawn from the law of the link, exactly.

    With a correlation their normal scores are an autoregression of the first order: z = rho z' +
    sqrt(1 - rho^2) e, and the delay is the law's quantile at Phi(z). A copy of a message comes
    after it as the next message does, and nothing comes after the copy.
    """

    def __init__(self, link: Link, score: float | None = None) -> None:
        self._law = DelayLaw.of(link)
        self._rho = link.delay_correlation
        self._new = (1 - link.delay_correlation**2) ** 0.5
        self._scores: list[float] = []
        self.score = score
        """Of the last message; None if there was none."""

    def use(self, messages: int) -> None:
        """So many of what was drawn last have been used: what is drawn next follows those."""
        if self._scores and messages:
            self.score = self._scores[messages - 1]
        self._scores = []

    def draw(self, own: Floats, copies: Floats | None) -> tuple[list[int], list[int]]:
        """Delays in nanoseconds of messages and of their copies, from uniform numbers."""
        if self._law.is_constant:
            constant = [round(self._law.latency_ms * 1e6)] * len(own)
            return constant, constant
        if self._rho:
            own = self._follow(own)
            copies = None if copies is None else self._copied(copies)
        return self._ns(own), [] if copies is None else self._ns(copies)

    def _follow(self, own: Floats) -> Floats:
        z = self.score
        for e in _scores(own).tolist():
            z = e if z is None else self._rho * z + self._new * e
            self._scores.append(z)
        return _uniform(np.array(self._scores))

    def _copied(self, copies: Floats) -> Floats:
        return _uniform(self._rho * np.array(self._scores) + self._new * _scores(copies))

    def _ns(self, u: Floats) -> list[int]:
        delays: list[int] = np.rint(self._law.quantile_ms(u) * 1e6).astype(np.int64).tolist()
        return delays


def _scores(u: Floats) -> Floats:
    scores: Floats = ndtri(np.maximum(u, 2.0**-54))  # a uniform number may be 0
    return scores


def _uniform(scores: Floats) -> Floats:
    u: Floats = ndtr(scores)
    return u
