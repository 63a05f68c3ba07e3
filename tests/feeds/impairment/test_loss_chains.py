from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from links import link

from plotfeed.feeds.impairment.asked import Asked
from plotfeed.feeds.impairment.loss_settings import FourState, GilbertElliott, RandomLoss
from plotfeed.feeds.impairment.losses import LossChain, chain_of, left_of

inner = st.floats(0.01, 0.99)


@st.composite
def chains(draw: st.DrawFn) -> LossChain:
    kind = draw(st.sampled_from(["random", "gilbert-elliott", "four-state"]))
    if kind == "random":
        p = draw(inner)
        least = -min(p, 1 - p) / max(p, 1 - p)
        c = draw(st.floats(max(least, -0.98) * 0.99, 0.95))
        return chain_of(RandomLoss(kind="random", probability=p, correlation=c))
    if kind == "gilbert-elliott":
        p, r, good, bad = (draw(inner) for _ in range(4))
        return chain_of(
            GilbertElliott(kind="gilbert-elliott", p=p, r=r, good_loss=good, bad_loss=bad)
        )
    a, b, p13, p31 = draw(inner), draw(inner), draw(inner), draw(inner)
    return chain_of(
        FourState(
            kind="four-state",
            p13=p13,
            p14=a * (1 - p13),
            p31=p31,
            p32=b * (1 - p31),
            p23=draw(inner),
        )
    )


@given(st.floats(0.001, 0.999), st.floats(-0.999, 0.999))
def test_random_loss_has_exactly_its_correlation(p: float, c: float) -> None:
    c = max(c, -min(p, 1 - p) / max(p, 1 - p))
    chain = chain_of(RandomLoss(kind="random", probability=p, correlation=c))
    assert chain.mean_loss == pytest.approx(p, rel=1e-9)
    assert chain.lag_1_correlation == pytest.approx(c, abs=1e-9)
    assert chain.mean_burst == pytest.approx(1 / ((1 - p) * (1 - c)), rel=1e-6)


@given(inner, inner, inner, inner)
def test_gilbert_elliott_has_the_mean_of_its_formula(
    p: float, r: float, good: float, bad: float
) -> None:
    loss = GilbertElliott(kind="gilbert-elliott", p=p, r=r, good_loss=good, bad_loss=bad)
    assert chain_of(loss).mean_loss == pytest.approx((p * bad + r * good) / (p + r))
    without = GilbertElliott(kind="gilbert-elliott", p=p, r=r, bad_loss=bad)
    assert chain_of(without).mean_burst == pytest.approx(1 / (1 - bad * (1 - r)))


@given(st.floats(0.001, 0.9), st.floats(1, 1000))
def test_a_chain_by_mean_loss_and_burst_has_them(mean_loss: float, mean_burst: float) -> None:
    mean_burst = max(mean_burst, mean_loss / (1 - mean_loss))
    loss = GilbertElliott(kind="gilbert-elliott", mean_loss=mean_loss, mean_burst=mean_burst)
    chain = chain_of(loss)
    assert chain.mean_loss == pytest.approx(mean_loss)
    assert chain.mean_burst == pytest.approx(mean_burst)
    n = np.arange(6)
    np.testing.assert_allclose(chain.burst_survival(6), (1 - 1 / mean_burst) ** n, atol=1e-12)


@given(chains())
def test_the_law_is_stationary_and_bursts_sum_up(chain: LossChain) -> None:
    step = sum(
        weight * np.array(_law(chain, state)) for state, weight in enumerate(chain.stationary)
    )
    np.testing.assert_allclose(step, chain.stationary, atol=1e-12)
    survival = chain.burst_survival(3000)
    assert survival[0] == pytest.approx(1)
    assert (np.diff(survival) <= 1e-12).all()
    if survival[-1] < 1e-9:
        assert survival.sum() == pytest.approx(chain.mean_burst, rel=1e-6)


def _law(chain: LossChain, state: int) -> list[float]:
    """Where a state leads, by the lengths of the intervals of a uniform number."""
    law = [0.0] * len(chain.emissions)
    edges = (0.0, *chain.edges[state], 1.0)
    for target, (low, high) in zip(chain.targets[state], pairwise(edges), strict=True):
        law[target] += high - low
    return law


@given(inner, inner)
def test_the_variance_of_two_states_is_that_of_a_geometric_memory(p: float, r: float) -> None:
    chain = chain_of(GilbertElliott(kind="gilbert-elliott", p=p, r=r))
    loss, memory = chain.mean_loss, 1 - p - r
    assert chain.variance_per_message == pytest.approx(
        loss * (1 - loss) * (1 + memory) / (1 - memory)
    )


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
    never = Asked(link(loss={"kind": "random", "probability": 0.0}))
    always = Asked(link(loss={"kind": "random", "probability": 1.0}))
    assert math.isnan(never.mean_burst)
    assert np.isnan(never.burst_survival(3)).all()
    assert always.mean_burst == math.inf
    assert (always.burst_survival(3) == 1).all()
    assert math.isnan(never.lag_1_correlation)
    assert math.isnan(always.lag_1_correlation)
    assert (never.mean_loss, always.mean_loss) == (0, 1)
    assert Asked(link()).mean_loss == Asked(link()).spread_of_loss(10) == 0
    assert math.isnan(Asked(link()).mean_burst)


@given(st.floats(0, 1, exclude_max=True), inner)
def test_what_a_choice_leaves_of_a_number_lies_from_0_to_1(u: float, p: float) -> None:
    assert 0 <= left_of(u, p) < 1


@given(chains(), st.lists(st.tuples(inner, inner), min_size=1, max_size=200))
def test_two_runs_that_have_met_stay_together(
    chain: LossChain, numbers: list[tuple[float, float]]
) -> None:
    states = set(range(chain.start + 1))
    together = False
    for u, v in numbers:
        states = {chain.repeats(state, u, v, 0)[1] for state in states}
        assert not together or len(states) == 1
        together = len(states) == 1
