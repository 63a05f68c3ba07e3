"""Where plain forms fail, by how much, and what ours leave: figures of docs/stability.md.

A form is written once, for NumPy's floats and for mpmath's sixty digits: what it loses in floats is
the plain form's error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import mpmath as mp
import numpy as np
from numpy.typing import NDArray
from scipy import special

from plotfeed.models import detection, frames, propagation
from plotfeed.models.clutter import k_exceedance
from plotfeed.models.effects.doppler import Doppler
from plotfeed.models.movers import wander_variance_m2

mp.mp.dps = 60
Errors = tuple[float, float]  # Of the plain form, and of ours
NAMES = ("exp", "expm1", "sqrt", "sin", "cos", "hypot", "degrees")
FLOATS = SimpleNamespace(
    **{name: getattr(np, name) for name in NAMES},
    number=np.float64, pi=np.pi, asin=np.arcsin, atan2=np.arctan2, gamma=special.gamma,
    besselk=special.kv,
)  # fmt: skip
DIGITS = SimpleNamespace(
    **{name: getattr(mp, name) for name in NAMES},
    number=mp.mpf, pi=mp.pi, asin=mp.asin, atan2=mp.atan2, gamma=mp.gamma, besselk=mp.besselk,
)  # fmt: skip


def error(found: Any, exact: Any, *, relative: bool = True) -> float:
    """Error of a float beside a number of sixty digits; NaN where there is no number."""
    value = float(found)
    if not math.isfinite(value):
        return math.nan
    return float(abs(mp.mpf(value) - exact) / (abs(exact) if relative else 1))


@np.errstate(all="ignore")
def errors(form: Any, arguments: Sequence[float], ours: Any, **how: bool) -> Errors:
    """Errors of a form in floats and of ours; the form's first argument has the functions."""
    plain = form(FLOATS, *map(np.float64, arguments))
    exact = form(DIGITS, *map(mp.mpf, map(float, arguments)))
    return error(plain, exact, **how), error(ours, exact, **how)


BASELINE_M = 20_000.0
TRANSMITTER_M = np.array([BASELINE_M, 0.0, 0.0])


def detour_m(m: Any, along_m: Any, off_m: Any) -> Any:
    """Bistatic range of a place along the baseline and off it: the ways less the baseline."""
    return m.hypot(along_m, off_m) + m.hypot(along_m - BASELINE_M, off_m) - BASELINE_M


def detour_errors(along_m: float, off_m: float) -> Errors:
    place = np.array([along_m, off_m, 0.0])
    return errors(detour_m, (along_m, off_m), propagation.bistatic_range(place, TRANSMITTER_M))


def zenith_errors(off_m: float) -> Errors:
    """Of the angle from the vertical, 10 km up."""
    ours = 90 - frames.enu_to_aer(np.array([off_m, 0.0, 1e4]))[1]
    form = lambda m, off, up: 90 - m.degrees(m.asin(up / m.hypot(off, up)))  # noqa: E731
    return errors(form, (off_m, 1e4), ours)


def pole_errors(off_deg: float) -> Errors:
    """Of the height so far from the pole, metres, by the textbook's ten rounds."""

    def form(m: Any, p: Any, z: Any) -> Any:
        a_m, e2 = m.number(frames.WGS84_A_M), m.number(frames.WGS84_E2)
        latitude, height_m = m.atan2(z, p * (1 - e2)), 0
        for _ in range(10):
            radius_m = a_m / m.sqrt(1 - e2 * m.sin(latitude) ** 2)
            height_m = p / m.cos(latitude) - radius_m
            latitude = m.atan2(z, p * (1 - e2 * radius_m / (radius_m + height_m)))
        return height_m

    x_m, y_m, z_m = frames.geodetic_to_ecef(90.0 - off_deg, 77.0, 123.0)
    ours = frames.ecef_to_geodetic(np.array([x_m, y_m, z_m]))[2]
    return errors(form, (math.hypot(x_m, y_m), float(z_m)), ours, relative=False)


def multiplier_errors(n: float) -> Errors:
    """Of the multiplier of a CFAR with that many reference cells, for a Pfa of 1e-6."""
    form: Any = lambda _, pfa, cells: pfa ** (-1 / cells) - 1  # noqa: E731
    return errors(form, (1e-6, n), detection.cfar_multiplier(1e-6, n))


def near_ties_errors(apart_db: float) -> Errors:
    """Of the Pd of three looks that are so far apart, against 48 samples, by partial fractions."""
    snrs = 10 ** ((10.0 + apart_db * np.array([-1.0, 0.0, 1.0])) / 10)
    over = float(detection.threshold_noncoherent_cfar(1e-6, 3, 48))

    def form(m: Any, *looks: Any) -> Any:
        means, total = [1 + snr for snr in looks], m.number(0)
        for i, mean in enumerate(means):
            shares = (mean / (mean - other) for other in means[:i] + means[i + 1 :])
            total = total + math.prod(shares) * (1 + over / mean) ** -48
        return total

    return errors(form, snrs.tolist(), detection.pd_noncoherent_unequal_cfar(snrs, 1e-6, 48))


DOPPLER = Doppler(
    cells_m_s=(0.25,), spans_m_s=(60.0,), folds=True, notch_m_s=1.0, floors_m_s=(0.0,)
)
ONE: NDArray[np.int64] = np.zeros(1, np.int64)
# By the first cell of a row; rows whose figures no rounding makes stand on the page alone.
FORMS: dict[str, Callable[[], Errors]] = {
    "bistatic range 0.1 mm off the baseline": lambda: detour_errors(7000.0, 1e-4),
    "angle from the vertical, 1 mm off it, 10 km up": lambda: zenith_errors(1e-3),
    "height 0.1 mm from the pole": lambda: pole_errors(1e-9),
    "a difference of 10⁻¹⁰°, wrapped": lambda: errors(
        lambda _, x: (x + 180) % 360 - 180, (1e-10,), frames.wrap_180(1e-10)
    ),
    "CFAR over 10¹² reference cells": lambda: multiplier_errors(1e12),
    "10⁻⁶ dB apart, against a CFAR": lambda: near_ties_errors(1e-6),
    "a rate of a millionth of the clutter notch": lambda: errors(
        lambda m, x: 1 - m.exp(-(x**2)), (1e-6,), DOPPLER.share_passed(np.array([1e-6]), ONE)[0]
    ),
    "a rate of 10⁻¹⁰ m/s, folded into ±30 m/s": lambda: errors(
        lambda _, x: (x + 30) % 60 - 30, (1e-10,), DOPPLER.folded(np.array([1e-10]), ONE)[0]
    ),
    "variance of a bird's way in 10⁻⁷ time constants": lambda: errors(
        lambda m, s, t, after: 2 * s * s * t * t * (after / t + m.expm1(-after / t)),
        *((3.0, 10.0, 1e-6), wander_variance_m2(3.0, 10.0, 1e-6)),
    ),
    "tail of K-distributed clutter of the order 180, three times its mean": lambda: errors(
        lambda m, v, t: 2 / m.gamma(v) * (v * t) ** (v / 2) * m.besselk(v, 2 * m.sqrt(v * t)),
        *((180.0, 3.0), k_exceedance(3.0, 180.0)),
    ),
}
