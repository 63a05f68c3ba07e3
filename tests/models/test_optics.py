"""What cameras resolve, against closed forms and values of other programmes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from plotfeed.models import optics
from plotfeed.models.frames import aer_to_enu, enu_to_aer


@pytest.mark.parametrize(
    ("x", "expected"), [(0.5, 0.107734), (1.0, 0.5), (1.5, 0.820611235962048), (2.0, 0.944899)]
)
def test_a_task_is_done_as_the_transfer_function_has_it(x: float, expected: float) -> None:
    assert optics.task_probability(6.4 * x, 6.4) == pytest.approx(expected, rel=1e-4)
    plain = x ** (2.7 + 0.7 * x)
    assert optics.task_probability(x, 1.0) == pytest.approx(plain / (1 + plain), rel=1e-13)


def test_a_task_with_very_many_cycles_or_none_has_a_probability() -> None:
    found = optics.task_probability([0.0, 1e-300, 190.0, 1e6, np.inf], 1.0)
    np.testing.assert_array_equal(found, [0.0, 0.0, 1.0, 1.0, 1.0])


def test_pixels_of_lenses_are_those_of_their_fields() -> None:
    """The widest and narrowest of a lens of 30 times, and a panorama's neighbour."""
    angles_urad = optics.pixel_angle_rad([2.2, 58.6, 2.3], [1920, 1920, 640]) * 1e6
    np.testing.assert_allclose(angles_urad, [20.0, 584.6, 62.7], rtol=2e-3)
    fields_deg = optics.field_of_pixels_deg(angles_urad / 1e6, [1920, 1920, 640])
    np.testing.assert_allclose(fields_deg, [2.2, 58.6, 2.3], rtol=1e-12)
    assert 2 * optics.cycles_on_target(0.35, 1000.0, 20e-6) == pytest.approx(17.5)


def test_a_twentieth_of_contrast_is_left_at_the_optical_range() -> None:
    np.testing.assert_allclose(
        optics.transmission([0.0, 1500.0, 3000.0], 3000.0), [1.0, 0.05**0.5, 0.05], rtol=1e-12
    )


def test_detail_is_lost_as_contrast_nears_its_threshold() -> None:
    between = np.sqrt(0.02 * 0.3)
    found = optics.resolved_share([0.0, 0.01, 0.02, between, 0.3, 0.9], 0.02, 0.3)
    np.testing.assert_allclose(found, [0.0, 0.0, 0.0, 0.5, 1.0, 1.0], atol=1e-12)


@pytest.mark.parametrize(("pixels", "sigmas"), [(3e6, 4.97), (7e6, 5.13), (30e6, 5.40)])
def test_a_spot_is_found_by_the_normal_law_over_one_alarm_a_picture(
    pixels: float, sigmas: float
) -> None:
    pfa = 1.0 / pixels
    assert optics.hot_spot_pd(sigmas, pfa) == pytest.approx(0.5, abs=0.003)
    assert optics.hot_spot_pd(0.0, pfa) == pytest.approx(pfa, rel=1e-9)
    assert optics.hot_spot_pd(sigmas + 1, pfa) == pytest.approx(stats.norm.cdf(1.0), abs=0.003)


def test_a_spot_is_found_with_a_pfa_below_the_rounding_of_one() -> None:
    """Without one less the Pfa, which is 1 in float64."""
    assert optics.hot_spot_pd(0.0, 1e-17) == pytest.approx(1e-17, rel=1e-9)
    threshold = float(stats.norm.isf(1e-17))
    assert optics.hot_spot_pd(threshold, 1e-17) == pytest.approx(0.5, rel=1e-12)


def test_the_picture_is_a_rectangle_about_the_line_of_sight() -> None:
    rng = np.random.default_rng(1)
    for pan_deg, tilt_deg in ((0.0, 0.0), (200.0, 50.0), (-30.0, -20.0)):
        right, above = rng.uniform(-0.3, 0.3, 500), rng.uniform(-0.2, 0.2, 500)
        sight = optics.directions_enu(right, above, pan_deg, tilt_deg) * 700.0
        found = optics.picture_axes(sight, pan_deg, tilt_deg)
        np.testing.assert_allclose(found, [700 * right, 700 * above, np.full(500, 700.0)])
        fields_deg = 2 * np.degrees(np.arctan([0.1, 0.05]))
        inside = optics.in_picture(sight, pan_deg, tilt_deg, *fields_deg)
        np.testing.assert_array_equal(inside, (np.abs(right) <= 0.1) & (np.abs(above) <= 0.05))
        assert not optics.in_picture(-sight, pan_deg, tilt_deg, 90.0, 90.0).any()


def test_the_middle_of_the_picture_is_where_it_points() -> None:
    middle = optics.directions_enu(np.zeros(1), np.zeros(1), 123.0, 45.0)
    azimuth_deg, elevation_deg, _ = enu_to_aer(middle)
    assert (azimuth_deg[0], elevation_deg[0]) == pytest.approx((123.0, 45.0))
    assert optics.in_picture(aer_to_enu([123.0], [45.0], [900.0]), 123.0, 45.0, 0.01, 0.01).all()
