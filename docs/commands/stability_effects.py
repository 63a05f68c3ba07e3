"""Where effects that a scene may name, false alarms and links fail: rows of docs/stability.md."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mpmath as mp
import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc, gammaincc, gammainccinv
from stability_case import Case, relative

from plotfeed.feeds.link.losses import chain_of
from plotfeed.feeds.scene.link_keys import GilbertElliott
from plotfeed.models.detection import probability_at_least_one
from plotfeed.models.effects.doppler import Doppler
from plotfeed.models.effects.echo_effects import cell_factor
from plotfeed.models.effects.line_of_sight import OPAQUE, STEEPEST
from plotfeed.models.effects.merging import MergedGroups
from plotfeed.models.effects.pulse_intervals import filter_factor
from plotfeed.models.effects.readings import Drift
from plotfeed.models.effects.weather import LOG_K, rain_coefficients
from plotfeed.models.fluctuation import pd_fluctuating
from plotfeed.models.frames import wrap_180
from plotfeed.models.movers import wander_variance_m2
from plotfeed.models.optics import task_probability

CHANNEL = np.zeros(1, np.int64)
DOPPLER = Doppler(
    cells_m_s=(0.25,), spans_m_s=(60.0,), folds=True, notch_m_s=1.0, floors_m_s=(0.0,)
)
TIME_CONSTANT_STEPS = 600.0
NS = 1_000_000_000
TEST_OF_CHAINS = (
    "feeds/link/test_loss_chains.py::test_chains_that_hardly_ever_move_keep_their_figures"
)


@dataclass
class Axes:
    """A stand-in for chance: each draw is an axis of its own, so that values are coefficients."""

    axes: dict[int, int] = field(default_factory=dict)
    step: int = 0

    def rng(self, _purpose: Any, step: int) -> Axes:
        """The one object, at a step."""
        self.step = step
        return self

    def standard_normal(self, n: int) -> NDArray[np.float64]:
        """The axis of the step."""
        return np.eye(n)[self.axes.setdefault(self.step, len(self.axes))]


def slow() -> Case:
    rate_m_s = 1e-6
    ours = DOPPLER.share_passed(np.array([rate_m_s]), CHANNEL)[0]
    exact = -mp.expm1(-(mp.mpf(rate_m_s) ** 2))
    return Case(
        where="a rate of a millionth of the clutter notch",
        plain_form="1 − exp(−(rate/notch)²)",
        plain=relative(1 - np.exp(-(rate_m_s**2)), exact),
        cure="−expm1(−(rate/notch)²)",
        ours=relative(ours, exact),
        test="models/effects/test_doppler.py::test_a_rate_a_millionth_of_the_notch_passes_a_trillionth",
    )


def folded() -> Case:
    rate_m_s, span_m_s = 1e-10, 60.0
    ours = DOPPLER.folded(np.array([rate_m_s]), CHANNEL)[0]
    return Case(
        where="a rate of 10⁻¹⁰ m/s, folded into ±30 m/s",
        plain_form="(x + s/2) mod s − s/2",
        plain=relative((rate_m_s + span_m_s / 2) % span_m_s - span_m_s / 2, mp.mpf(rate_m_s)),
        cure="x − s times the nearest whole of x/s",
        ours=relative(ours, mp.mpf(rate_m_s)),
        test="models/effects/test_doppler.py::"
        "test_a_folded_rate_is_the_nearest_to_zero_of_those_that_look_alike",
    )


def forgotten() -> Case:
    """The worst covariance among scans up to three time constants apart."""
    steps = 1_700_000_000 + np.array([0, 1, 7, 60, 333, 600, 1800])
    axes: Any = Axes()
    drift = Drift(axes, step_ns=NS, time_constant_ns=TIME_CONSTANT_STEPS * NS, n=400)
    values = drift.at(steps * NS)
    exact = np.exp(-np.abs(np.subtract.outer(steps, steps)) / TIME_CONSTANT_STEPS)
    innovations = 3000
    left_out = np.exp(-2 * innovations / TIME_CONSTANT_STEPS)  # of a variance
    return Case(
        where="covariance of a drift of 600 scans",
        plain_form="sum of the latest 3000 innovations",
        plain=float(left_out),
        cure="halving between anchors 64 time constants apart",
        ours=float(np.abs(values @ values.T - exact).max()),
        test="models/effects/test_readings.py::"
        "test_the_covariance_is_that_of_gauss_and_markov_to_the_last_digits",
    )


def slow_drift() -> Case:
    """What is new in a step of a billionth of the time constant."""
    h = mp.mpf(10) ** -9
    kept = np.exp(-1e-9)
    exact = mp.sqrt(mp.tanh(h))
    # Of the middle between two values, by the correlation over the half of their distance.
    plain = np.sqrt((1 - kept**2) / (1 + kept**2))
    return Case(
        where="spread of a drift, 10⁻⁹ time constants from what is known",
        plain_form="√((1 − ρ²)/(1 + ρ²)), ρ = e⁻ʰ",
        plain=relative(plain, exact),
        cure="√(tanh h)",
        ours=relative(np.sqrt(np.tanh(1e-9)), exact),
        test="models/effects/test_readings.py::"
        "test_the_covariance_is_that_of_gauss_and_markov_to_the_last_digits",
    )


def over_north() -> Case:
    azimuth_deg, powers = np.array([359.5, 0.5]), np.ones(2)
    merged = MergedGroups(np.zeros(2, np.int64), np.zeros(1, np.int64))
    ours = float(wrap_180(merged.centroid_deg(azimuth_deg, powers)[0]))
    return Case(
        where="centroid of echoes at 359.5° and 0.5°",
        plain_form="mean of the azimuths",
        plain=f"{azimuth_deg.mean():g}°, the other side",
        cure="mean of the differences from one, wrapped",
        ours=f"{ours:g}°",
        test="models/effects/test_merging.py::test_the_echo_lies_at_the_centroid_of_powers_over_north",
    )


def cut_off() -> Case:
    ours = float(10 * np.log10(OPAQUE))
    return Case(
        where="level of an echo that a ridge cuts off",
        plain_form="10 lg(0)",
        plain="−∞ dB",
        cure="a factor of 10⁻²⁰ each way",
        ours=f"{ours:.0f} dB".replace("-", "−"),
        test="models/effects/test_line_of_sight.py::test_what_is_cut_off_still_has_a_level",
    )


def between_carriers() -> Case:
    k = {ghz: float(rain_coefficients(ghz * 1e9, "horizontal")[0]) for ghz in (10, 12, 15)}
    log_ghz = [mp.log10(ghz) for ghz in (10, 12, 15)]
    share = float(np.log(12 / 10) / np.log(15 / 10))
    sums = LOG_K["horizontal"]
    exact = 10 ** (
        sum(mp.mpf(a) * mp.e ** (-(((log_ghz[1] - b) / c) ** 2)) for a, b, c in sums.bells)
        + mp.mpf(sums.slope) * log_ghz[1]
        + mp.mpf(sums.offset)
    )
    return Case(
        where="k of rain at 12 GHz",
        plain_form="in a line of lg k over lg f, between 10 and 15 GHz",
        plain=relative(k[10] ** (1 - share) * k[15] ** share, exact),
        cure="the formula of P.838-3",
        ours=relative(k[12], exact),
        test="models/effects/test_weather.py::test_rain_weakens_as_the_formula_of_p838_says",
    )


def short_way() -> Case:
    sigma, tau, t = 3.0, 10.0, 1e-6
    u = mp.mpf(t) / mp.mpf(tau)
    exact = 2 * mp.mpf(sigma) ** 2 * mp.mpf(tau) ** 2 * (u + mp.expm1(-u))
    plain = 2 * sigma**2 * tau**2 * (t / tau + np.expm1(-t / tau))
    return Case(
        where="variance of a bird's way in 10⁻⁷ time constants",
        plain_form="2σ²τ²(u + expm1(−u))",
        plain=relative(plain, exact),
        cure="its series below u = 0.02",
        ours=relative(wander_variance_m2(sigma, tau, t), exact),
        test="models/test_movers.py::"
        "test_the_variance_of_a_way_is_right_to_the_last_digits_however_short",
    )


def along_azimuths() -> Case:
    """The highest slope so far of ten thousand rays on one axis, worked out at once."""
    slope, ray, apart = 1.23456789e-6, 3599, 4 * STEEPEST
    exact = mp.mpf(slope)
    return Case(
        where="slope of an edge, from the running maximum of 3600 azimuths at once",
        plain_form="maximum of slope + azimuth · 4000, less what was added",
        plain=relative((slope + ray * apart) - ray * apart, exact),
        cure="the slope itself, where that maximum rises",
        ours=relative(float(np.float32(slope)), exact),
        test="models/effects/test_line_of_sight.py::"
        "test_the_running_maximum_answers_as_the_ray_that_is_followed",
    )


def hardly_any_alarm() -> Case:
    cells, pfa = 10**6, 1e-15
    exact = -mp.expm1(cells * mp.log1p(-mp.mpf(pfa)))
    return Case(
        where="chance of an alarm among 10⁶ cells, Pfa 10⁻¹⁵",
        plain_form="1 − (1 − Pfa)ⁿ",
        plain=relative(1 - (1 - pfa) ** cells, exact),
        cure="−expm1(n log1p(−Pfa))",
        ours=relative(probability_at_least_one(cells, pfa), exact),
        test="models/test_detection.py::test_almost_never_is_not_never",
    )


def rare_changes() -> Case:
    p, r = 3e-18, 1e-18
    exact_p, exact_r = mp.mpf(p), mp.mpf(r)
    loss = exact_p / (exact_p + exact_r)
    exact = loss * (1 - loss) * (2 - exact_p - exact_r) / (exact_p + exact_r)
    steps, law = np.array([[1 - r, r], [p, 1 - p]]), np.array([p, r]) / (p + r)
    lost = np.array([1.0, 0.0])
    try:
        later = (law * lost) @ (np.linalg.inv(np.eye(2) - steps + law) - np.eye(2)) @ lost
    except np.linalg.LinAlgError:
        later = np.nan
    plain = law[0] * (1 - law[0]) + 2 * later
    chain = chain_of(GilbertElliott(kind="gilbert-elliott", p=p, r=r))
    return Case(
        where="variance of losses, states that change once in 10¹⁸ messages",
        plain_form="inverse of I − P + 1π",
        plain=relative(plain, exact),
        cure="sums until a state comes again, without a subtraction",
        ours=relative(chain.variance_per_message, exact),
        test=TEST_OF_CHAINS,
    )


def very_large() -> Case:
    cycles = 1e4
    with np.errstate(over="ignore", invalid="ignore"):
        power = np.float64(cycles) ** (2.7 + 0.7 * cycles)
        plain = float(power / (1 + power))
    return Case(
        where="a drone with ten thousand times the cycles that a camera needs",
        plain_form="x^E/(1 + x^E)",
        plain=plain,
        cure="1/(1 + exp(−E ln x))",
        ours=abs(float(task_probability(cycles, 1.0)) - 1.0),
        test="models/test_optics.py::test_a_task_with_very_many_cycles_or_none_has_a_probability",
    )


def endless_burst() -> Case:
    p, r = 0.5, 1e-17
    lost = np.array([[1 - r, 0.0], [p, 0.0]])
    try:
        plain = float(np.linalg.solve(np.eye(2) - lost, np.ones(2))[0])
    except np.linalg.LinAlgError:
        plain = float("nan")
    chain = chain_of(GilbertElliott(kind="gilbert-elliott", p=p, r=r))
    return Case(
        where="mean burst, one that ends with a chance of 10⁻¹⁷",
        plain_form="inverse of I − PE",
        plain=relative(plain, 1 / mp.mpf(r)),
        cure="the same sums",
        ours=relative(chain.mean_burst, 1 / mp.mpf(r)),
        test=TEST_OF_CHAINS,
    )


def faint_and_many() -> Case:
    n, snr, pfa = 100, 1e-6, 1e-6
    y = gammainccinv(n, pfa)
    total = mp.mpf(n) * mp.mpf(snr)
    ratio = 1 + 1 / total
    threshold = mp.findroot(
        lambda t: mp.log(mp.gammainc(n, t, regularized=True)) - mp.log(mp.mpf(pfa)), y
    )
    below = mp.gammainc(n - 1, 0, threshold / ratio, regularized=True)
    exact = mp.gammainc(n - 1, threshold, regularized=True)
    exact += ratio ** (n - 1) * below * mp.exp(-threshold / (1 + total))
    with np.errstate(over="ignore", invalid="ignore"):
        much = np.float64(1 + 1 / (n * snr))
        plain = gammaincc(n - 1, y) + much ** (n - 1) * gammainc(n - 1, y / much) * np.exp(
            -y / (1 + n * snr)
        )
    return Case(
        where="Pd of Swerling 1, 100 looks at 10⁻⁶",
        plain_form="DiFranco and Rubin: (1 + 1/NS)ᴺ⁻¹ …",
        plain=relative(plain, exact),
        cure="a series of positive terms",
        ours=relative(pd_fluctuating(snr, pfa, n, 1.0), exact),
        test="models/test_fluctuation.py::test_faint_and_strong_echoes_of_many_looks_cost_no_digits",
    )


def nearly_blind() -> Case:
    prf_hz, wavelength_m, rate_m_s = 1000.0, 0.03, 1e-6
    turns = 2 * mp.mpf(rate_m_s) / (mp.mpf(wavelength_m) * prf_hz)
    plain = 1 - np.cos(4 * np.pi * rate_m_s / (wavelength_m * prf_hz))
    return Case(
        where="gain of a canceller at a millionth of a metre a second",
        plain_form="1 − cos 2πfT",
        plain=relative(plain, 2 * mp.sinpi(turns) ** 2),
        cure="2 sin² of πfT from the nearest blind speed",
        ours=relative(
            filter_factor(rate_m_s, prf_hz, wavelength_m, "single"), 2 * mp.sinpi(turns) ** 2
        ),
        test="models/effects/test_pulse_intervals.py::"
        "test_close_to_a_blind_speed_no_digit_of_the_gain_is_lost",
    )


def amid_the_cell() -> Case:
    x = 0.0
    with np.errstate(invalid="ignore"):
        plain = (np.sin(np.pi * x) / (np.pi * np.float64(x)) / (1 - x**2)) ** 2
    return Case(
        where="Hann's loss right amid a cell",
        plain_form="sin πx/(πx(1 − x²))",
        plain=relative(plain, mp.mpf(1)),
        cure="sinc x/(1 − x²), x from the nearest middle",
        ours=relative(cell_factor(np.array([x]), "hann")[0], mp.mpf(1)),
        test="models/effects/test_antenna.py::"
        "test_cells_lose_on_average_and_at_worst_what_their_shape_says",
    )


EFFECTS = (
    faint_and_many,
    nearly_blind,
    amid_the_cell,
    slow,
    folded,
    forgotten,
    slow_drift,
    over_north,
    cut_off,
    along_azimuths,
    between_carriers,
    short_way,
    hardly_any_alarm,
    very_large,
)
LINKS = (rare_changes, endless_burst)
