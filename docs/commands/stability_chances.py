"""Where probabilities of detection fail: rows of docs/stability.md."""

from __future__ import annotations

import mpmath as mp
import numpy as np
from numpy.typing import NDArray
from scipy import special
from stability_case import Case, relative

from plotfeed.models import detection, propagation

Floats = NDArray[np.float64]


def exact_pd(threshold: float, means: list[mp.mpf]) -> mp.mpf:
    """Tail of a sum of exponentials of different means, by partial fractions in sixty digits."""
    total = mp.mpf(0)
    for m in means:
        share = mp.fprod(m / (m - other) for other in means if other is not m)
        total += share * mp.exp(-mp.mpf(threshold) / m)
    return total


@np.errstate(all="ignore")
def plain_pd_unequal(threshold: float, snrs: Floats) -> float:
    """Partial fractions in float64."""
    means = 1 + snrs
    shares = [np.prod(m / (m - np.delete(means, i))) for i, m in enumerate(means)]
    return float(np.sum(np.array(shares) * np.exp(-threshold / means)))


def tied(apart_db: float) -> tuple[Floats, float]:
    """Three looks about 10 dB that far apart, and their threshold for a Pfa of 1e-6."""
    snrs = 10 ** ((10.0 + apart_db * np.array([-1.0, 0.0, 1.0])) / 10)
    return snrs, float(detection.threshold_noncoherent(1e-6, 3))


def tiny_pd() -> Case:
    looks, pfa, snr = 3, 1e-12, 1e-3
    x = float(detection.threshold_noncoherent(pfa, looks) / (1 + snr))
    exact = mp.gammainc(looks, mp.mpf(x), regularized=True)
    return Case(
        where="Pd of three looks of −30 dB, Pfa 10⁻¹²",
        plain_form="1 − P(N, y)",
        plain=relative(1 - special.gammainc(looks, x), exact),
        cure="Q(N, y)",
        ours=relative(special_pd(snr, pfa, looks), exact),
        test="models/test_stability.py::test_a_pd_of_a_trillionth_keeps_its_digits",
    )


def special_pd(snr: float, pfa: float, looks: float) -> float:
    """Ours, as a float."""
    return float(detection.pd_noncoherent_swerling2(snr, pfa, looks))


def tiny_pfa() -> Case:
    pfa = 1e-17
    ours = float(detection.threshold_noncoherent(pfa, 3))
    exact = mp.findroot(lambda y: mp.log(mp.gammainc(3, y, regularized=True) / pfa), 45)
    return Case(
        where="threshold of three looks for a Pfa of 10⁻¹⁷",
        plain_form="inverse of P at 1 − Pfa",
        plain=relative(special.gammaincinv(3, 1 - pfa), exact),
        cure="inverse of Q at Pfa",
        ours=relative(ours, exact),
        test="models/test_stability.py::test_a_threshold_for_a_pfa_below_the_rounding_of_one",
    )


def huge_snr() -> Case:
    looks, pfa, snr = 3, 1e-6, 1e6
    x = float(detection.threshold_noncoherent(pfa, looks) / (1 + snr))
    exact = mp.gammainc(looks, 0, mp.mpf(x), regularized=True)
    return Case(
        where="chance of a miss at 60 dB, three looks",
        plain_form="1 − Pd",
        plain=relative(1 - special_pd(snr, pfa, looks), exact),
        cure="P(N, y), a function of its own",
        ours=relative(detection.miss_noncoherent_swerling2(snr, pfa, looks), exact),
        test="models/test_stability.py::test_a_miss_at_60_db_keeps_its_digits",
    )


def multiplier_errors(n: float) -> tuple[float, float]:
    """Relative errors of equation 6 for a Pfa of 1e-6: plain form and ours."""
    exact = mp.expm1(-mp.log(mp.mpf(1e-6)) / mp.mpf(n))
    ours = detection.cfar_multiplier(1e-6, n)
    return relative(1e-6 ** (-1 / n) - 1, exact), relative(ours, exact)


def many_cells() -> Case:
    plain, ours = multiplier_errors(1e12)
    return Case(
        where="CFAR over 10¹² reference cells",
        plain_form="Pfa^(−1/N) − 1",
        plain=plain,
        cure="expm1(−ln Pfa/N)",
        ours=ours,
        test="models/test_stability.py::test_the_multiplier_of_a_trillion_reference_cells_keeps_its_digits",
    )


def ties() -> Case:
    snrs, threshold = tied(0.0)
    exact = mp.gammainc(3, mp.mpf(threshold) / 11, regularized=True)
    return Case(
        where="three looks of 10 dB each",
        plain_form="partial fractions",
        plain=relative(plain_pd_unequal(threshold, snrs), exact),
        cure="a chain with positive terms alone",
        ours=relative(detection.pd_noncoherent_unequal(snrs, 1e-6), exact),
        test="models/test_stability.py::test_looks_of_equal_snr_have_a_pd",
    )


def near_ties_errors(apart_db: float) -> tuple[float, float]:
    """Relative errors of the Pd of three looks: plain form and ours."""
    snrs, threshold = tied(apart_db)
    exact = exact_pd(threshold, [1 + mp.mpf(float(s)) for s in snrs])
    ours = detection.pd_noncoherent_unequal(snrs, 1e-6)
    return relative(plain_pd_unequal(threshold, snrs), exact), relative(ours, exact)


def near_ties() -> Case:
    plain, ours = near_ties_errors(1e-7)
    return Case(
        where="10⁻⁷ dB apart",
        plain_form="partial fractions",
        plain=plain,
        cure="the same chain",
        ours=ours,
        test="models/test_detection.py::test_near_ties_are_as_good_as_ties",
    )


def near_ties_cfar() -> Case:
    snrs, _ = tied(1e-6)
    n = 48
    over = float(detection.threshold_noncoherent_cfar(1e-6, 3, n))
    means = [1 + mp.mpf(float(s)) for s in snrs]
    exact = mp.mpf(0)
    for m in means:
        share = mp.fprod(m / (m - other) for other in means if other is not m)
        exact += share * (m / (m + mp.mpf(over))) ** n
    floats = 1 + snrs
    shares = [np.prod(m / (m - np.delete(floats, i))) for i, m in enumerate(floats)]
    plain = float(np.sum(np.array(shares) * (1 + over / floats) ** -n))
    return Case(
        where="10⁻⁶ dB apart, against a CFAR",
        plain_form="partial fractions",
        plain=relative(plain, exact),
        cure="the chain of looks and samples",
        ours=relative(detection.pd_noncoherent_unequal_cfar(snrs, 1e-6, n), exact),
        test="models/test_stability.py::test_looks_of_nearly_equal_snr_against_a_cfar",
    )


def many_looks() -> Case:
    looks, snr, pfa = 2000, 0.1, 1e-6
    x = float(detection.threshold_noncoherent(pfa, looks) / (1 + snr))
    exact = mp.gammainc(looks, mp.mpf(x), regularized=True)
    with np.errstate(all="ignore"):
        terms = np.cumprod(np.concatenate([[1.0], x / np.arange(1, looks)]))
        plain = float(np.exp(-x) * terms.sum())
    return Case(
        where="2000 looks",
        plain_form="e⁻ʸ Σ yᵏ/k!",
        plain=relative(plain, exact),
        cure="the regularised gamma function",
        ours=relative(special_pd(snr, pfa, looks), exact),
        test="models/test_detection.py::test_pd_and_miss_keep_their_digits_for_many_samples",
    )


@np.errstate(all="ignore")
def loud() -> Case:
    rise = np.exp(np.float64(1000.0))
    return Case(
        where="a sound 1000 dB over the sensitivity",
        plain_form="eˣ/(1 + eˣ)",
        plain=relative(rise / (1 + rise), mp.mpf(1)),
        cure="by the sign of x",
        ours=relative(detection.pd_logistic(1000.0, 0.0), mp.mpf(1)),
        test="models/test_stability.py::test_a_listener_far_from_its_sensitivity_is_certain",
    )


@np.errstate(all="ignore")
def strong_echo() -> Case:
    echo_w, time_bandwidth = np.float64(np.inf), 2.3e6
    plain = echo_w * time_bandwidth / (echo_w + 1e-12)
    return Case(
        where="correlator, the target at the antenna",
        plain_form="equation 25, a quotient of powers",
        plain=relative(plain, mp.mpf(time_bandwidth)),
        cure="BT/(1 + disturbance/echo)",
        ours=relative(
            propagation.correlated_snr(echo_w, 1e-12, time_bandwidth), mp.mpf(time_bandwidth)
        ),
        test="models/test_propagation.py::test_correlator_gain_is_capped_by_time_and_bandwidth",
    )


DETECTION = (
    tiny_pd,
    tiny_pfa,
    huge_snr,
    many_cells,
    ties,
    near_ties,
    near_ties_cfar,
    many_looks,
    loud,
    strong_echo,
)
