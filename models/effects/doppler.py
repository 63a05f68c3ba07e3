"""Range rates by the Doppler effect: what is measured of them, what is blind, what is ambiguous.

A rate is that of the range, v.u, or of a bistatic range, v.(u_tx + u_rx): positive for a target
that recedes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models import accuracy
from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.state import Floats, Ints


@nan_without_warnings
def range_rate_m_s(
    position_enu_m: Floats, velocity_enu_m_s: Floats, from_enu_m: ArrayLike = (0.0, 0.0, 0.0)
) -> Floats:
    """How fast targets recede from a place, m/s; (..., 3) in, (...) out. NaN right at it."""
    sight = position_enu_m - as_floats(from_enu_m)
    along = (sight * velocity_enu_m_s).sum(axis=-1)
    return np.asarray(along / np.linalg.norm(sight, axis=-1))


@dataclass(frozen=True, kw_only=True)
class Doppler:
    """Widths of a Doppler cell and of the interval of rates that is told apart, for each channel.

    The cell is the wavelength over twice the time of coherent integration, for a bistatic range
    over that time itself. The interval is centred on zero; a rate beyond it folds into it, or else
    is not seen. `floors_m_s` are errors that no echo is too strong for, by channel, and `notch_m_s`
    is the width of the clutter filter's notch, 0 for none.
    """

    cells_m_s: tuple[float, ...]
    spans_m_s: tuple[float, ...]
    folds: bool
    notch_m_s: float
    floors_m_s: tuple[float, ...]

    def folded(self, rate_m_s: Floats, channel: Ints) -> Floats:
        """Rates as they appear: the nearest to zero of those that look alike; (n,)."""
        if not self.folds:
            return rate_m_s
        span_m_s = self._spans_m_s[channel]
        return rate_m_s - span_m_s * np.rint(rate_m_s / span_m_s)

    def share_passed(self, rate_m_s: Floats, channel: Ints) -> Floats:
        """Share of the Pd that the notch leaves: 1 - exp(-(rate/notch)^2), 0 at blind speeds."""
        seen_m_s = self.folded(rate_m_s, channel)
        passed = np.ones(len(seen_m_s))
        if self.notch_m_s:
            passed = -np.expm1(-((seen_m_s / self.notch_m_s) ** 2))
        if not self.folds:
            passed = np.where(np.abs(seen_m_s) <= self._spans_m_s[channel] / 2, passed, 0.0)
        return passed

    def sigma_m_s(self, snr: Floats, channel: Ints) -> Floats:
        """Standard deviation of a rate at a detection's own signal-to-noise ratio; (n,)."""
        sigma_m_s = accuracy.sigma_rate_m_s(snr, np.array(self.cells_m_s)[channel])
        return accuracy.with_floor(sigma_m_s, np.array(self.floors_m_s)[channel])

    def measured(
        self,
        rate_m_s: Floats,
        snr: Floats,
        channel: Ints,
        rng: np.random.Generator,
        error_factor: float | Floats = 1.0,
    ) -> dict[str, Floats]:
        """The columns of plots for detections of those powers: rates with noise, as they appear.

        The noise is `error_factor` times what plots state.
        """
        sigma_m_s = self.sigma_m_s(snr, channel)
        noise_m_s = sigma_m_s * rng.standard_normal((len(snr),))
        noisy_m_s = rate_m_s + noise_m_s * error_factor
        return {
            "range_rate_m_s": self.folded(noisy_m_s, channel),
            "sigma_range_rate_m_s": sigma_m_s,
        }

    def of_false_alarms(
        self, snr: Floats, channel: Ints, rng: np.random.Generator
    ) -> dict[str, Floats]:
        """Columns of plots for false alarms: rates uniform over what is told apart."""
        return {
            "range_rate_m_s": self._spans_m_s[channel] * (rng.random(len(snr)) - 0.5),
            "sigma_range_rate_m_s": self.sigma_m_s(snr, channel),
        }

    @cached_property
    def _spans_m_s(self) -> Floats:
        return np.array(self.spans_m_s)
