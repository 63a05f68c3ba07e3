"""Where antennas, arrays, classifiers, steered beams, cameras and clutter fail: their rows."""

from __future__ import annotations

from typing import Any

import mpmath as mp
import numpy as np
from scipy.special import gamma, kv
from scipy.stats import norm
from stability_case import Case, relative

from plotfeed.models.clutter import k_exceedance
from plotfeed.models.detection import whole_cells
from plotfeed.models.dwell_agenda import frame_s
from plotfeed.models.effects.classification import Confusion
from plotfeed.models.effects.echo_effects import CosecantSquaredCut
from plotfeed.models.effects.microphone_layout import MicrophoneLayout
from plotfeed.models.optics import hot_spot_pd
from plotfeed.models.sensors.sensor_model import Degradation


class Highest:
    """A stand-in for a generator, whose uniform numbers are the highest below one."""

    def random(self, size: tuple[int, ...]) -> Any:
        """Numbers of that size."""
        return np.full(size, np.nextafter(1.0, 0.0))


def more_alarms_than_cells() -> Case:
    cells, pfa = 18.0, 0.01
    worse = Degradation(false_alarm_factor=1000.0)
    whole, each = whole_cells(cells * worse.false_alarm_factor, pfa)
    exact = mp.mpf(cells) * 1000 * mp.mpf(pfa)
    return Case(
        where="a thousand times the alarms of 18 beams of Pfa 0.01",
        plain_form="Pfa times the factor",
        plain=f"a probability of {pfa * worse.false_alarm_factor:g}",
        cure="cells times the factor, each with its Pfa",
        ours=relative(whole * each, exact),
        test="models/effects/test_degradation.py::"
        "test_more_alarms_than_there_are_cells_keep_their_mean",
    )


def on_the_horizon() -> Case:
    cut = CosecantSquaredCut(from_deg=4.0, to_deg=30.0, beamwidth_deg=3.0)
    elevation_deg = np.zeros(1)
    with np.errstate(divide="ignore"):
        plain = float((np.sin(np.radians(4.0)) / np.sin(np.radians(elevation_deg[0]))) ** 2)
    exact = mp.mpf(2) ** (-4 * (mp.mpf(4) / 3) ** 2)
    return Case(
        where="gain of a cosecant-squared beam on the horizon",
        plain_form="(sin e₁/sin e)²",
        plain=relative(plain, exact),
        cure="between its elevations alone; a Gaussian edge beyond",
        ours=relative(10 ** (-cut.loss_db(elevation_deg)[0] / 10), exact),
        test="models/effects/test_antenna.py::"
        "test_a_cosecant_squared_beam_has_an_edge_where_the_sine_is_lost",
    )


def off_a_lines_end() -> Case:
    line = MicrophoneLayout(
        shape="line", microphones=8, spacing_m=0.4, azimuth_deg=20.0, wavelength_m=1.7
    )
    ahead, level, snr = np.array([20.0]), np.zeros(1), np.array([400.0])
    with np.errstate(divide="ignore"):
        plain = float(1 / np.abs(np.sin(np.radians(ahead[0] - 20.0))))
    found_deg = line.sigmas_deg(ahead, level, snr)[0][0]
    return Case(
        where="error of a bearing off the end of a line of eight microphones",
        plain_form="σ of the cosine over the sine",
        plain=relative(plain, mp.mpf(1)),
        cure="over √(sine² + σ): where the sine is lost, the root of σ",
        ours=f"{found_deg:.2g}°",
        test="models/effects/test_microphone_layout.py::test_errors_are_finite_in_every_direction",
    )


def beyond_the_last_claim() -> Case:
    row = (0.1,) * 10
    draw = np.nextafter(1.0, 0.0)
    plain = int((draw >= np.cumsum(row)).sum()) + 1
    names = tuple(str(n + 1) for n in range(10))
    matrix = Confusion(claims=names, true_classes=("drone",), rows=(row,))
    highest: Any = Highest()
    ours = matrix.claimed(np.array(["drone"], np.object_), highest)[0][0]
    return Case(
        where="the claim of a draw of 1 − 10⁻¹⁶, among ten of 0.1",
        plain_form="the first whose running sum is above it",
        plain=f"claim {plain} of 10",
        cure="the last takes what rounding leaves",
        ours=f"claim {ours} of 10",
        test="models/effects/test_classification.py::"
        "test_rows_whose_sum_rounds_below_one_never_claim_what_there_is_not",
    )


def asked_for_too_much() -> Case:
    beams, dwell_s, load = 800, 1e-3, 1.2
    return Case(
        where="frame of a search while tracks ask for 1.2 of all dwells",
        plain_form="n t/(1 − load)",
        plain=f"{beams * dwell_s / (1 - load):.0f} s".replace("-", "−"),
        cure="without an end from a load of 1 on",
        ours="∞ s" if np.isinf(frame_s(beams, dwell_s, load)) else "a time",
        test="models/test_dwell_agenda.py::test_a_search_takes_longer_the_more_tracks_there_are",
    )


def hardly_ever_warm() -> Case:
    pfa, ratio = 1e-17, 8.0
    root = mp.sqrt(2)
    threshold = mp.findroot(
        lambda t: mp.log(mp.erfc(t / root) / 2) - mp.log(mp.mpf(pfa)), norm.isf(pfa)
    )
    exact = mp.erfc((threshold - mp.mpf(ratio)) / root) / 2
    return Case(
        where="Pd of a hot spot, a false alarm in 10¹⁷ pixels",
        plain_form="threshold by the inverse of Φ at 1 − Pfa",
        plain=relative(norm.sf(norm.ppf(1 - pfa) - ratio), exact),
        cure="the inverse of 1 − Φ at Pfa",
        ours=relative(hot_spot_pd(ratio, pfa), exact),
        test="models/test_optics.py::test_a_spot_is_found_with_a_pfa_below_the_rounding_of_one",
    )


def spiky() -> Case:
    order, threshold = 180.0, 3.0
    q = 2 * np.sqrt(order * threshold)
    with np.errstate(over="ignore", invalid="ignore"):
        plain = 2 / gamma(order) * (order * threshold) ** (order / 2) * kv(order, q)
    vt = mp.mpf(order) * mp.mpf(threshold)
    exact = 2 / mp.gamma(order) * vt ** (mp.mpf(order) / 2) * mp.besselk(order, 2 * mp.sqrt(vt))
    return Case(
        where="tail of K-distributed clutter of the order 180, three times its mean",
        plain_form="2/Γ(ν) (νT)^(ν/2) K_ν(2√νT)",
        plain=relative(plain, exact),
        cure="logarithms, and the scaled Bessel function",
        ours=relative(k_exceedance(threshold, order), exact),
        test="models/test_movers.py::"
        "test_of_a_high_order_it_is_noise_and_of_any_it_is_a_probability",
    )


CLUTTER = (spiky,)
SENSORS = (
    more_alarms_than_cells,
    on_the_horizon,
    off_a_lines_end,
    beyond_the_last_claim,
    asked_for_too_much,
    hardly_ever_warm,
)
