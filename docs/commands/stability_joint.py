"""Where places by several stations fail: rows of docs/stability.md."""

from __future__ import annotations

import mpmath as mp
import numpy as np
from stability_case import Case, relative

from plotfeed.models.joined_sets import covariance
from plotfeed.models.sensors.acoustic import crossing


def parallel_bearings() -> Case:
    first_deg, second_deg, apart_m = 30.0, 30.0 - 1e-9, 1e-9
    first, second = (mp.radians(mp.mpf(bearing)) for bearing in (first_deg, second_deg))
    exact = mp.mpf(apart_m) * mp.cos(second) / mp.sin(first - second)
    a, b = np.radians([first_deg, second_deg])
    plain = apart_m * np.cos(b) / (np.sin(a) * np.cos(b) - np.cos(a) * np.sin(b))
    one = np.ones(1)
    bearings = np.array([first_deg]), np.array([second_deg])
    ours = crossing(*bearings, (apart_m, 0.0, 0.0), one, one).range_m[0]
    return Case(
        where="crossing of bearings 10⁻⁹ degrees apart",
        plain_form="over sin a cos b − cos a sin b",
        plain=relative(plain, exact),
        cure="over the sine of their difference",
        ours=relative(ours, exact),
        test="models/sensors/test_acoustic_pair.py::"
        "test_bearings_a_billionth_of_a_degree_apart_keep_their_digits",
    )


def nearly_one_bearing() -> Case:
    a, b = 0.7, 0.7 + 1e-6
    rows = np.array([[[np.cos(a), np.sin(a), 0], [np.cos(b), np.sin(b), 0], [0, 0, 1.0]]])
    (p, q), (r, s) = ((mp.mpf(float(x)) for x in row[:2]) for row in rows[0, :2])
    exact = (p * p + r * r) / (p * s - q * r) ** 2
    return Case(
        where="covariance of bearings 10⁻⁶ rad apart",
        plain_form="(JᵀJ)⁻¹ by normal equations",
        plain=relative(np.linalg.inv(rows[0].T @ rows[0])[1, 1], exact),
        cure="R⁻¹R⁻ᵀ of J = QR",
        ours=relative(covariance(rows)[0, 1, 1], exact),
        test="models/test_multilateration.py::"
        "test_a_covariance_of_bearings_a_millionth_of_a_radian_apart_keeps_its_digits",
    )


JOINT = (parallel_bearings, nearly_one_bearing)
