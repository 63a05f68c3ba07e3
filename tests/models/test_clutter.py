"""Clutter whose power is K-distributed: how often it crosses a threshold, and by how much."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from support.significance import assert_law, assert_sum

from plotfeed.models.clutter import Spikes, k_exceedance


@pytest.mark.parametrize(
    ("threshold", "order"), [(10.0, 0.5), (0.1, 0.05), (30.0, 3.0), (1e4, 1.5)]
)
def test_the_tail_is_that_of_fifty_digits(threshold: float, order: float) -> None:
    """Of order 0.5, ten times the mean comes with 0.0114, and with 4.5e-5 in noise."""
    with mp.workdps(50):
        vt = mp.mpf(order) * mp.mpf(threshold)
        bessel = mp.besselk(order, 2 * mp.sqrt(vt))
        exact = 2 / mp.gamma(order) * vt ** (mp.mpf(order) / 2) * bessel
    assert k_exceedance(threshold, order) == pytest.approx(float(exact), rel=1e-12)
    assert k_exceedance(10.0, 0.5) == pytest.approx(0.0114228909934669, rel=1e-12)


def test_of_a_high_order_it_is_noise_and_of_any_it_is_a_probability() -> None:
    assert k_exceedance(3.0, 300.0) == pytest.approx(np.exp(-3.0), rel=0.02)
    found = k_exceedance([0.0, 1e-9, 1.0, 1e3, 1e9], [[0.05], [1.0], [50.0]])
    assert np.isfinite(found).all()
    assert (found[:, 0] == 1.0).all()
    assert (np.diff(found, axis=1) <= 0).all()
    assert (found <= 1.0 + 1e-12).all()
    assert 0.0 < k_exceedance(3.0, 180.0) < k_exceedance(0.1, 180.0) < 1.0


@pytest.mark.parametrize("order", [0.3, 2.0])
def test_what_crosses_the_threshold_exceeds_it_by_the_law_of_the_tail(order: float) -> None:
    threshold, n = 8.0, 4000
    rng = np.random.default_rng(1)
    fresh = Spikes(threshold=threshold, order=order, texture=None)
    over = fresh.over_threshold(np.zeros(n, np.int64), rng)
    tail = k_exceedance(threshold, order)
    assert_law(over, lambda x: 1 - k_exceedance(threshold * np.asarray(x), order) / tail, "fresh")
    texture = rng.standard_gamma(order, 200_000) / order
    stays = Spikes(threshold=threshold, order=order, texture=texture)
    chance = stays.chance(len(texture))
    spread = float(np.var(chance)) * len(texture)
    assert_sum(float(chance.sum()), float(tail) * len(texture), spread, "mean over textures")
    squares = rng.choice(len(texture), n, p=chance / chance.sum())
    over = stays.over_threshold(squares, rng)
    assert_law(over, lambda x: 1 - k_exceedance(threshold * np.asarray(x), order) / tail, "stays")
