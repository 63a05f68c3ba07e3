"""What a link asks for, in closed form: what is delivered is held against it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.feeds.impairment.delays import DelayLaw
from plotfeed.feeds.impairment.losses import chain_of
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.models.state import Floats


class LinkExpectation:
    """Of one link. Delays are those of the law alone, before a rate, an order or a stall."""

    def __init__(self, link: LinkSettings) -> None:
        self.link = link
        self.delay = DelayLaw.of(link)
        self._chain = None if link.loss is None else chain_of(link.loss)

    def delay_cdf(self, delay_ms: ArrayLike) -> Floats:
        """Probability of a delay up to those, in milliseconds; any shape in, the same out."""
        return self.delay.cdf(delay_ms)

    def delay_quantile_ms(self, probability: ArrayLike) -> Floats:
        """Delays in milliseconds at those probabilities; any shape in, the same out."""
        return self.delay.quantile_ms(probability)

    @property
    def mean_loss(self) -> float:
        """Share of messages that are lost while the link is up; or repeated, if it stalls."""
        return 0.0 if self._chain is None else self._chain.mean_loss

    def spread_of_loss(self, messages: int) -> float:
        """Standard deviation of the share lost of so many messages, if they are many."""
        if self._chain is None:
            return 0.0
        return float(np.sqrt(self._chain.variance_per_message / messages))

    @property
    def mean_burst(self) -> float:
        """Messages lost in a row, on average; NaN if none is lost."""
        return float("nan") if self._chain is None else self._chain.mean_burst

    def burst_survival(self, longest: int) -> Floats:
        """Probability that 1, 2, ... or more are lost in a row, up to `longest`; (longest,)."""
        if self._chain is None:
            return np.full(longest, np.nan)
        return self._chain.burst_survival(longest)

    @property
    def lag_1_correlation(self) -> float:
        """Of the losses of successive messages; NaN if none is lost, or all are."""
        return float("nan") if self._chain is None else self._chain.lag_1_correlation

    @property
    def duplicate_share(self) -> float:
        """Of the messages that are sent, those that come twice, if no queue is full."""
        return self.link.duplicate
