"""Chances of echoes that fluctuate, in closed form, for tests of what the road makes of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chndtr

from plotfeed.models.numerics import as_floats
from plotfeed.models.state import Floats


def joint_hit_gauss_markov(snr: ArrayLike, pfa: ArrayLike, rho: ArrayLike) -> Floats:
    """Chance that two looks both detect, of amplitudes correlated by rho; noise known; (...).

    The two powers are correlated exponentials of mean 1+S: exp(-u) (1 + Q(r b, b) - Q(b, r b)), Q
    of Marcum, u the threshold over that mean, r = rho S/(1+S), b^2 = 2u/(1 - r^2).
    """
    s = as_floats(snr)
    u, r = -np.log(as_floats(pfa)) / (1 + s), as_floats(rho) * s / (1 + s)
    b2 = 2 * u / (1 - r * r)
    both = chndtr(r * r * b2, 2, b2) - chndtr(b2, 2, r * r * b2)
    return as_floats(np.exp(-u) * (1 + both))
