"""The energy detector: the sum of the powers of many samples, against a known noise power.

`snr` is the mean signal-to-noise ratio of one sample, linear; signal and noise are Gaussian, so the
sum of `n_samples` is a gamma variable times 1+S, in units of the noise power of one sample. Its Pd
is `detection.pd_noncoherent_swerling2`. Good for as many as 1e9 samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammainccinv

from plotfeed.models.detection import pd_noncoherent_swerling2, threshold_noncoherent
from plotfeed.models.numerics import as_floats, nan_without_warnings, unit_interval
from plotfeed.models.state import Floats

_SMALLEST_SNR = 1e-12


@nan_without_warnings
def draw_detected_energy(
    snr: ArrayLike, pfa: ArrayLike, n_samples: ArrayLike, rng: np.random.Generator
) -> Floats:
    """Energies that crossed the threshold: the exact law given the hit; broadcast shape.

    S = 0 makes false alarms.
    """
    shape = np.broadcast_shapes(np.shape(snr), np.shape(pfa), np.shape(n_samples))
    return _energy_exceeded_by(1 - rng.random(shape), snr, pfa, n_samples)


@nan_without_warnings
def estimated_snr(energy: ArrayLike, n_samples: ArrayLike) -> Floats:
    """What an energy says of the signal-to-noise ratio: always above zero."""
    return as_floats(np.maximum(as_floats(energy) / as_floats(n_samples) - 1, _SMALLEST_SNR))


@nan_without_warnings
def inverse_estimated_snr(snr: ArrayLike, pfa: float, n_samples: float) -> Floats:
    """Mean, over the detections, of one over the estimated SNR; (...) in, (...) out.

    Error variances go as that. Gauss and Legendre average over the tail, whose dense end, just
    above the threshold, gets most of the points.
    """
    root, weights = unit_interval()
    mean_snr = as_floats(snr)[..., None]
    energy = _energy_exceeded_by(1 - root**3, mean_snr, pfa, n_samples)
    return as_floats(1 / estimated_snr(energy, n_samples) @ (3 * root**2 * weights))


def _energy_exceeded_by(
    share: Floats, snr: ArrayLike, pfa: ArrayLike, n_samples: ArrayLike
) -> Floats:
    """The energy that this share of the detections exceeds; rounding may not undo a detection."""
    tail = pd_noncoherent_swerling2(snr, pfa, n_samples)
    energy = (1 + as_floats(snr)) * gammainccinv(n_samples, share * tail)
    return as_floats(np.maximum(energy, threshold_noncoherent(pfa, n_samples)))
