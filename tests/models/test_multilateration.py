"""Places by least squares from sums of ranges: the bound, the digits, and what heights leave."""

from __future__ import annotations

import numpy as np
import pytest
from mpmath import mp

from plotfeed.models.joined_sets import Sightings, covariance, linearised, range_sums_m, solved
from plotfeed.models.state import Floats

MASTS_M = np.array(
    [[-8000.0, 15_000.0, 200.0], [17_000.0, 3000.0, 150.0], [2000.0, -17_500.0, 120.0]]
)
PLACE_M = np.array([1500.0, 2000.0, 100.0])
OPEN = 1e9


def sightings(sum_m: Floats, sigma_m: float = 20.0, sigma_height_m: float = OPEN) -> Sightings:
    nothing = np.full(sum_m.shape, np.nan)
    return Sightings(
        transmitters_m=MASTS_M,
        receivers_m=np.zeros((3, 3)),
        sum_m=sum_m,
        sigma_sum_m=np.full(sum_m.shape, sigma_m),
        azimuth_deg=nothing,
        sigma_azimuth_deg=nothing,
        elevation_deg=nothing,
        sigma_elevation_deg=nothing,
        height_m=100.0,
        sigma_height_m=sigma_height_m,
    )


def test_a_sum_of_ranges_by_hand() -> None:
    """By the reference value of a mast 17 km away, to its last digit."""
    found_m = range_sums_m(PLACE_M, MASTS_M[:1], np.zeros((1, 3)))
    assert found_m[0] == pytest.approx(18603.5519207965, rel=1e-15)


def test_three_sums_near_the_ground_leave_no_usable_height() -> None:
    """Masts 120 to 200 m high, 17 km away, sums known to 20 m: heights to half a kilometre."""
    sums_m = range_sums_m(PLACE_M[None], MASTS_M, np.zeros((3, 3)))
    without = solved(PLACE_M[None], sightings(sums_m)).covariance_m2[0]
    east_m, north_m, up_m = np.sqrt(np.diag(without))
    assert east_m < 25
    assert north_m < 25
    assert up_m > 500
    known = solved(PLACE_M[None], sightings(sums_m, sigma_height_m=50.0)).covariance_m2[0]
    assert np.sqrt(known[2, 2]) == pytest.approx(50.0, rel=0.01)
    assert (np.diag(known)[:2] < np.diag(without)[:2]).all()


def test_places_scatter_by_the_covariance_where_heights_are_as_expected() -> None:
    """The normalised square of errors has mean 3, by 20,000 sets of noisy sums."""
    rng, n = np.random.default_rng(5), 20_000
    places_m = PLACE_M + np.array([0.0, 0.0, 50.0]) * rng.standard_normal((n, 1))
    sums_m = range_sums_m(places_m, MASTS_M, np.zeros((3, 3)))
    noisy_m = sums_m + 20.0 * rng.standard_normal(sums_m.shape)
    found = solved(np.tile([1000.0, 2600.0, 60.0], (n, 1)), sightings(noisy_m, 20.0, 50.0))
    error_m = found.place_m - places_m
    nees = np.einsum("ni,nij,nj->n", error_m, np.linalg.inv(found.covariance_m2), error_m)
    assert nees.mean() == pytest.approx(3.0, abs=0.1)
    assert found.square.mean() == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("start_m", [(4000.0, 4000.0, 10.0), (-3000.0, -500.0, 300.0)])
def test_exact_sums_give_their_place_from_far(start_m: tuple[float, float, float]) -> None:
    sums_m = range_sums_m(PLACE_M[None], MASTS_M, np.zeros((3, 3)))
    found = solved(np.array([start_m]), sightings(sums_m, sigma_height_m=50.0))
    np.testing.assert_allclose(found.place_m[0], PLACE_M, atol=1e-6)
    assert found.square[0] < 1e-12


def nearly_parallel(angle_rad: float) -> Floats:
    """Rows of two bearings so far apart, and a height."""
    a, b = 0.7, 0.7 + angle_rad
    return np.array([[[np.cos(a), np.sin(a), 0], [np.cos(b), np.sin(b), 0], [0, 0, 1.0]]])


def test_a_covariance_of_bearings_a_millionth_of_a_radian_apart_keeps_its_digits() -> None:
    """By sixty digits of the same rows, of which the normal equations lose all but some."""
    jacobian = nearly_parallel(1e-6)
    with mp.workdps(60):
        (a, b), (c, d) = ((mp.mpf(float(x)) for x in row[:2]) for row in jacobian[0, :2])
        exact = (a * a + c * c) / (a * d - b * c) ** 2
    ours = covariance(jacobian)[0, 1, 1]
    plain = np.linalg.inv(jacobian[0].T @ jacobian[0])[1, 1]
    assert float(abs(ours / exact - 1)) < 1e-8
    assert float(abs(plain / exact - 1)) > 1e-4


def test_gradients_are_those_of_what_is_measured() -> None:
    full = Sightings(
        transmitters_m=MASTS_M,
        receivers_m=np.array([[0.0, 0.0, 0.0], [3000.0, 0.0, 5.0], [0.0, -2000.0, 0.0]]),
        sum_m=np.full((1, 3), 2e4),
        sigma_sum_m=np.full((1, 3), 7.0),
        azimuth_deg=np.full((1, 3), 20.0),
        sigma_azimuth_deg=np.full((1, 3), 1.5),
        elevation_deg=np.full((1, 3), 3.0),
        sigma_elevation_deg=np.full((1, 3), 2.0),
        height_m=60.0,
        sigma_height_m=35.0,
    )
    jacobian, at = linearised(PLACE_M[None], full)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-3
        _, after = linearised((PLACE_M + step)[None], full)
        np.testing.assert_allclose((at - after)[0] / 1e-3, jacobian[0, :, axis], atol=1e-6)
