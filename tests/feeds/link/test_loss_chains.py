"""Laws of loss as chains of states, and of delay as shapes of netem."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support.links import link

from plotfeed.feeds.link.delays import DelayLaw
from plotfeed.feeds.link.impairment import LinkExpectation
from plotfeed.feeds.link.losses import LossChain, chain_of, left_of
from plotfeed.feeds.scene.link_keys import FourState, GilbertElliott, RandomLoss

inner = st.floats(0.01, 0.99)
small = st.floats(-120, -0.1).map(lambda exponent: 10.0**exponent)


@given(st.floats(0.001, 0.999), st.floats(-0.999, 0.999))
def test_random_loss_has_exactly_its_mean_and_bursts(p: float, c: float) -> None:
    c = max(c, -min(p, 1 - p) / max(p, 1 - p))
    chain = chain_of(RandomLoss(kind="random", probability=p, correlation=c))
    assert chain.mean_loss == pytest.approx(p, rel=1e-9)
    ends = (1 - p) * (1 - c)
    assert chain.mean_burst == pytest.approx(1 / ends, rel=1e-6)
    np.testing.assert_allclose(chain.burst_survival(6), (1 - ends) ** np.arange(6), atol=1e-9)


@settings(max_examples=20)
@given(st.tuples(small, small, small, small, small), inner)
def test_chains_that_hardly_ever_move_keep_their_figures(
    rates: tuple[float, ...], bad: float
) -> None:
    p13, p31, p32, p23, p14 = rates
    p14, p32 = p14 * (1 - p13), p32 * (1 - p31)
    four = chain_of(FourState(kind="four-state", p13=p13, p31=p31, p32=p32, p23=p23, p14=p14))
    compare_with_500_digits(
        four, {(0, 2): p32, (0, 3): p31, (1, 3): 1, (2, 0): p23, (3, 0): p13, (3, 1): p14}
    )
    two = GilbertElliott(kind="gilbert-elliott", p=p13, r=p31, good_loss=p23, bad_loss=bad)
    compare_with_500_digits(chain_of(two), {(0, 1): p31, (1, 0): p13})


def compare_with_500_digits(chain: LossChain, rates: dict[tuple[int, int], float]) -> None:
    """Variance and mean burst by the fundamental matrix and by the burst's law."""
    with mp.workdps(500):
        size, e = len(chain.emissions), mp.matrix(chain.emissions)
        p = mp.eye(size)
        for (i, j), rate in rates.items():
            p[i, j] = mp.mpf(rate)
            p[i, i] -= mp.mpf(rate)
        one = mp.ones(size, 1)
        ends = mp.eye(size) - p.T
        for j in range(size):
            ends[size - 1, j] = 1
        last = mp.matrix([0] * (size - 1) + [1])
        law = mp.lu_solve(ends, last).T
        loss = (law * e)[0]
        fundamental = (mp.eye(size) - p + one * law) ** -1 - mp.eye(size)
        weighed = mp.matrix([law[i] * e[i] for i in range(size)]).T
        variance = loss * (1 - loss) + 2 * (weighed * fundamental * e)[0]
        begins = mp.matrix([law[i] * (1 - e[i]) for i in range(size)]).T * p * mp.diag(e)
        lengths = mp.lu_solve(mp.eye(size) - p * mp.diag(e), one)
        burst = (begins * lengths)[0] / mp.fsum(begins)
    assert chain.mean_loss == pytest.approx(float(loss), rel=1e-9)
    assert chain.variance_per_message == pytest.approx(float(variance), rel=1e-6)
    assert chain.mean_burst == pytest.approx(float(burst), rel=1e-9)


@pytest.mark.parametrize(
    ("loss", "mean_loss", "mean_burst"),
    [
        # States 1 and 3 in the proportion p31 : p13, 2 by p13 p32/p23, 4 by p14 p31.
        ({"p13": 0.02, "p31": 0.3, "p32": 0.1, "p23": 0.5, "p14": 0.01}, 0.0703364, 2.0909091),
        ({"p13": 0.02}, 0.02, 1 / 0.98),
    ],
)
def test_four_states_by_hand(loss: dict[str, float], mean_loss: float, mean_burst: float) -> None:
    chain = chain_of(FourState(kind="four-state", **loss))
    assert chain.mean_loss == pytest.approx(mean_loss, rel=1e-6)
    assert chain.mean_burst == pytest.approx(mean_burst, rel=1e-6)


def test_nothing_lost_and_everything_lost_have_no_bursts_to_speak_of() -> None:
    never, always = ({"kind": "random", "probability": p} for p in (0.0, 1.0))
    for loss, mean, burst, survival in (
        *((loss, 0, math.nan, math.nan) for loss in (None, never)),
        (always, 1, math.inf, 1),
    ):
        chain = LinkExpectation(link(loss=loss)).loss
        assert (chain.mean_loss, chain.spread_of_loss(10)) == (mean, 0)
        np.testing.assert_equal(chain.mean_burst, burst)
        np.testing.assert_equal(chain.burst_survival(3), survival)


def test_states_that_last_beyond_all_numbers_have_a_spread_and_a_burst() -> None:
    rarely = {"kind": "gilbert-elliott", "p": 1e-310, "r": 1e-310}
    assert LinkExpectation(link(loss=rarely)).loss.spread_of_loss(1000) == math.inf
    hardly_ends = LinkExpectation(link(loss={"kind": "gilbert-elliott", "p": 0.5, "r": 2e-101}))
    assert hardly_ends.loss.mean_burst == pytest.approx(5e100)
    assert hardly_ends.loss.spread_of_loss(1000) < 1e-50


@given(st.floats(0, 1, exclude_max=True), inner)
@example(math.nextafter(1.0, 0.0), 0.3)  # where rounding gives 1
def test_what_a_choice_leaves_of_a_number_lies_from_0_to_1(u: float, p: float) -> None:
    assert 0 <= left_of(u, p) < 1


# Laws of delay.

QUANTILES = {
    # Of the tables of iproute2 6.1, in jitters.
    "normal": {0.01: -2.3253, 0.1: -1.2816, 0.25: -0.6746, 0.75: 0.6740, 0.9: 1.2805, 0.99: 2.3185},
    "pareto": {0.01: -0.6622, 0.1: -0.6191, 0.5: -0.3203, 0.75: 0.1160, 0.9: 0.8705, 0.99: 3.9999},
    "paretonormal": {0.01: -1.0780, 0.1: -0.7847, 0.5: -0.2402, 0.75: 0.2554, 0.9: 0.9729},
}


@pytest.mark.parametrize("shape", QUANTILES)
def test_shapes_have_the_quantiles_of_netem(shape: str) -> None:
    law = DelayLaw.of(link(latency_ms=1000.0, jitter_ms=100.0, distribution=shape))
    for probability, jitters in QUANTILES[shape].items():
        found = float(law.quantile_ms(probability))
        assert found == pytest.approx(1000 + 100 * jitters, abs=1.0)


def test_a_sample_is_straight_between_its_order_statistics() -> None:
    sample = [3.0, 1.0, 2.0, 2.0, 9.0]
    law = DelayLaw.of(link(distribution="table", delays_ms=sample, latency_ms=10.0))
    u = np.linspace(0, 1, 41)
    np.testing.assert_allclose(law.quantile_ms(u), 10 + np.quantile(sample, u))
    at = np.array([10.9, 11.0, 11.5, 11.999, 12.0, 12.5, 16.0, 19.0, 20.0])
    np.testing.assert_allclose(law.cdf(at), [0, 0, 0.125, 0.24975, 0.5, 0.625, 0.875, 1, 1])
    np.testing.assert_array_equal(law.cdf([-np.inf, 19.0, np.inf]), [0, 1, 1])


def test_without_a_name_the_shape_is_normal_and_no_delay_is_below_0() -> None:
    law = DelayLaw.of(link(latency_ms=1.0, jitter_ms=1.0))
    np.testing.assert_allclose(law.quantile_ms([0.0, 0.84134474606854]), [0, 2], atol=1e-9)
    np.testing.assert_allclose(law.cdf([-1e-9, 0.0]), [0, 0.1586552539], atol=1e-9)
