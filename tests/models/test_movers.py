"""What moves beside drones: wandering flocks, traffic, rotors, and the strips of towers."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from support.significance import assert_law, assert_standard_normal, assert_sum

from plotfeed.models.clutter import Spikes, inside, k_exceedance
from plotfeed.models.effects.surroundings import Pillar
from plotfeed.models.movers import Wander, airspeed_m_s, cars_on, rotor_knots, wander_variance_m2


@pytest.mark.parametrize(
    ("t_s", "expected_m2"), [(1e-6, 8.99999970000001e-12), (20.0, 2043.6035098259)]
)
def test_the_variance_of_a_way_is_right_to_the_last_digits_however_short(t_s, expected_m2):
    assert float(wander_variance_m2(3.0, 10.0, t_s)) == pytest.approx(expected_m2, rel=1e-13)


def test_series_and_closed_form_meet():
    u = np.array([0.0199999, 0.0200001])
    found = wander_variance_m2(1.0, 1.0, u) / u**2
    assert found[0] == pytest.approx(found[1], rel=1e-6)
    assert float(wander_variance_m2(1.0, 1.0, 0.02)) == pytest.approx(
        float(wander_variance_m2(1.0, 1.0, 0.02 * (1 - 1e-12))), rel=1e-9
    )


def test_ways_and_velocities_are_drawn_together_whatever_the_step():
    """By one step of 3 s, and by thirty of 0.1 s: the joint law is that of the process."""
    tau_s, sigma = 4.0, 2.0
    u = 3.0 / tau_s
    variances = {
        "way": float(wander_variance_m2(sigma, tau_s, 3.0)), "velocity": sigma**2,
        "both": sigma**2 * tau_s * -np.expm1(-u),
    }  # fmt: skip
    for seed, steps in enumerate((1, 30)):
        wander = Wander(sigma_m_s=sigma, time_constant_s=tau_s)
        way, velocity = wander.walk(3.0 / steps, steps, (20_000,), np.random.default_rng(seed))
        x, v = way[-1], velocity[-1]
        assert (way[0] == 0).all()
        assert_standard_normal(x / np.sqrt(variances["way"]), "way")
        assert_standard_normal(v / sigma, "velocity")
        spread = np.sqrt(variances["way"] * sigma**2 + variances["both"] ** 2)
        total = float((x * v).sum())
        assert_sum(total, 20_000 * variances["both"], 20_000 * spread**2, "both")


def test_birds_fly_as_fast_as_their_mass_says():
    assert float(airspeed_m_s(1.0)) == 15.9
    assert 8 < float(airspeed_m_s(0.01)) < float(airspeed_m_s(10.0)) < 23


def test_cars_are_poisson():
    rng = np.random.default_rng(3)
    counts = [cars_on(1000.0, 25.0, 1000.0, rng) for _ in range(2000)]
    assert_sum(sum(counts), 2000 * 1000 / 3600 * 40, 2000 * 1000 / 3600 * 40)


def test_a_tip_goes_round_at_its_speed_across_its_axis():
    at_s, place, velocity = rotor_knots(30.0, 50.0, 80.0, 0.3, 48)
    axis = np.array([np.sin(np.radians(30)), np.cos(np.radians(30)), 0.0])
    np.testing.assert_allclose(np.linalg.norm(place, axis=1), 50.0)
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1), 80.0)
    np.testing.assert_allclose(place @ axis, 0.0, atol=1e-12)
    np.testing.assert_allclose((place * velocity).sum(axis=1), 0.0, atol=1e-9)
    np.testing.assert_allclose(place[0], place[-1], atol=1e-12)
    step = np.gradient(place, at_s, axis=0)[1:-1]
    np.testing.assert_allclose(step, velocity[1:-1], rtol=0.01, atol=0.3)


def test_a_tower_casts_no_shadow_before_itself_far_beside_it_or_above_it():
    tower = Pillar((0.0, 3000.0, 100.0), 4.0)
    places = np.array([[0.0, 2900.0, 5.0], [400.0, 4000.0, 5.0], [0.0, 4000.0, 300.0]])
    factor = tower.power_factor(places, 0.03)
    assert factor[0] == 1.0
    assert factor[1] == pytest.approx(1.0, abs=0.05)
    assert factor[2] == 1.0
    behind = np.array([[0.0, 4000.0, 5.0]])
    from_there = tower.power_factor(np.zeros((1, 3)), 0.03, behind[0])
    np.testing.assert_allclose(from_there, tower.power_factor(behind, 0.03), rtol=1e-9)


def test_inside_a_polygon_with_a_notch():
    corners = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]])
    east, north = np.array([1.0, 2.0, 3.5, 5.0, 2.0]), np.array([1.0, 3.0, 3.0, 1.0, 0.5])
    np.testing.assert_array_equal(inside(east, north, corners), [True, False, True, False, True])


# Clutter whose power is K-distributed: how often it crosses a threshold, and by how much.


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
