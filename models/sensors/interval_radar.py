"""Radars whose looks may be of several intervals of pulses, of which each decides by itself.

What a kind of radar makes of one interval is its own: a signal, or those of several transmitters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.sensors.sensor_model import Prediction, Targets, mean_prediction
from plotfeed.models.state import Floats


@dataclass(frozen=True, kw_only=True)
class IntervalRadar(PolarRadar, ABC):
    """A radar of K signals and, where pulses are modelled, N intervals: ratios are (n, N K)."""

    @property
    @abstractmethod
    def signals_each(self) -> int:
        """K, in one interval."""

    @abstractmethod
    def interval_pd(self, snrs: Floats, order: Floats | None) -> Floats:
        """Probability of detection of one interval; (n, K) in, (n,) out."""

    @abstractmethod
    def draw_interval(
        self, snrs: Floats, rng: np.random.Generator, order: Floats | None
    ) -> tuple[Floats, Floats]:
        """Powers a signal of detections in one interval, and thresholds; (n, K) in, (n,) out."""

    @abstractmethod
    def inverse_interval(self, snrs: Floats, order: Floats | None) -> Floats:
        """Mean of 1/x over detections of power x in one interval; (n, K) in, (n,) out."""

    @property
    def n_signals(self) -> int:
        """Signals of a look, those of all intervals."""
        return self.signals_each * (1 if self.intervals is None else self.intervals.count)

    def pd(self, snrs: Floats, order: Floats | None = None) -> Floats:
        """Probability that the look detects, or that enough of its intervals do."""
        if self.intervals is None:
            return self.interval_pd(snrs, order)
        from plotfeed.models.effects.pulse_intervals import at_least

        return at_least(self._pd_each(snrs, order), self.intervals.needed)

    def draw_detected(
        self, snrs: Floats, rng: np.random.Generator, order: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Powers a signal of detections, and thresholds; of several intervals, of the first."""
        if self.intervals is not None:
            from plotfeed.models.effects.pulse_intervals import chosen, first_successes

            first = first_successes(self._pd_each(snrs, order), self.intervals.needed)
            which = chosen(first, rng.random((len(snrs),)))
            by_interval = self._by_interval(snrs)
            snrs = np.take_along_axis(by_interval, which[:, None, None], axis=1)[:, 0]
        return self.draw_interval(snrs, rng, order)

    def inverse_detected(self, snrs: Floats, order: Floats | None = None) -> Floats:
        """Mean of 1/x over detections of power x; of several intervals, of the first."""
        if self.intervals is None:
            return self.inverse_interval(snrs, order)
        from plotfeed.models.effects.pulse_intervals import first_successes

        first = first_successes(self._pd_each(snrs, order), self.intervals.needed)
        by_interval = self._by_interval(snrs)
        columns = [
            self.inverse_interval(by_interval[:, i], order) for i in range(self.intervals.count)
        ]
        return np.asarray((first * np.stack(columns, axis=-1)).sum(axis=1))

    def _by_interval(self, snrs: Floats) -> Floats:
        """Ratios by interval and signal; (n, N, K)."""
        return snrs.reshape(len(snrs), snrs.shape[1] // self.signals_each, self.signals_each)

    def _pd_each(self, snrs: Floats, order: Floats | None) -> Floats:
        """Probability of detection of each interval; (n, N)."""
        each = snrs.reshape(-1, self.signals_each)
        count = snrs.shape[1] // self.signals_each
        orders = None if order is None else np.repeat(order, count)
        return self.interval_pd(each, orders).reshape(-1, count)

    def predict(self, targets: Targets) -> Prediction:
        """Closed forms; over all places of the intervals in a beam that passes."""
        if self.intervals is None or self.intervals.beam is None:
            return super().predict(targets)
        everywhere = np.zeros(len(targets), np.int64)
        found = [
            super(IntervalRadar, self).predict(replace(targets, t_utc_ns=everywhere + phase_ns))
            for phase_ns in self.intervals.phases_ns
        ]
        return mean_prediction(found)
