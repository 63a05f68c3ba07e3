"""Gains by direction, and what is lost between cells, beside values of sixty digits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.given_files import values_of

from plotfeed.models.effects.echo_effects import (
    CELL_SHAPES,
    CosecantSquaredCut,
    GaussianCut,
    TableCut,
    cell_factor,
    cosecant_peak_loss_db,
    gaussian_loss_db,
)


def test_a_gaussian_beam_has_half_of_its_power_half_a_width_off() -> None:
    for args, gain_db in values_of("beam_gain_gaussian_oneway_db"):
        offset = float(args["offset_beamwidths"])
        assert gaussian_loss_db(3 * offset, 3.0) == pytest.approx(-gain_db, rel=1e-14)


def test_between_beams_side_by_side_the_loss_averages_what_their_spacing_leaves() -> None:
    for args, mean_db in values_of("beams_mean_loss_twoway_db"):
        spacing_deg = 2 * float(args["spacing_beamwidths"])
        beams = 9
        cut = GaussianCut(
            beamwidth_deg=2.0, boresight_deg=40.0, spacing_deg=spacing_deg, beams=beams
        )
        angle_deg = 40 + spacing_deg * beams * (np.linspace(0, 1, 90_001)[1:] - 0.5)
        gain = 10 ** (-2 * cut.loss_db(angle_deg) / 10)
        assert -10 * np.log10(gain.mean()) == pytest.approx(mean_db, abs=1e-3)


@given(st.floats(-720, 720), st.integers(2, 90))
def test_beams_that_close_the_circle_have_no_seam(azimuth_deg: float, beams: int) -> None:
    width_deg = 360.0 / beams
    cut = GaussianCut(
        beamwidth_deg=width_deg, boresight_deg=0.0, spacing_deg=width_deg, beams=beams
    )
    here, next_to_it = cut.loss_db(np.array([azimuth_deg, azimuth_deg + width_deg]))
    assert here <= 3.0103 * (1 + 1e-9)
    assert next_to_it == pytest.approx(here, abs=1e-9)


def test_a_cosecant_squared_beam_has_an_edge_where_the_sine_is_lost() -> None:
    """On the horizon and below it: a Gaussian edge, of which 4 of 3 degrees leave 2^(-64/9)."""
    cut = CosecantSquaredCut(from_deg=4.0, to_deg=30.0, beamwidth_deg=3.0)
    loss_db = cut.loss_db(np.array([0.0, -1e-300, -4.0]))
    expected = 10 * np.log10(2) * 4 * np.array([4 / 3, 4 / 3, 8 / 3]) ** 2
    np.testing.assert_allclose(loss_db, expected, rtol=1e-13)


def test_what_a_cosecant_squared_beam_has_less_at_its_peak() -> None:
    for args, loss_db in values_of("cosecant_peak_loss_db"):
        found = cosecant_peak_loss_db(float(args["from_deg"]), float(args["to_deg"]))
        assert found == pytest.approx(loss_db, rel=1e-13)


def test_a_table_is_linear_in_decibels_and_holds_at_its_ends() -> None:
    cut = TableCut(angles_deg=(-10.0, 0.0, 20.0), gains_db=(-20.0, 0.0, -6.0), boresight_deg=350.0)
    found = cut.loss_db(np.array([335.0, 345.0, 350.0, 0.0, 10.0, 90.0]))
    np.testing.assert_allclose(found, [20.0, 10.0, 0.0, 3.0, 6.0, 6.0], atol=1e-12)


@pytest.mark.parametrize("shape", CELL_SHAPES)
def test_cells_lose_on_average_and_at_worst_what_their_shape_says(shape: str) -> None:
    cells = np.linspace(-3, 3, 600_001)
    factor = cell_factor(cells, shape)
    ((_, mean_db),) = values_of(f"straddle_{shape}_mean_power_db")[:1]
    ((_, worst_db),) = values_of(f"straddle_{shape}_worst_db")[:1]
    assert -10 * np.log10(factor[:-1].mean()) == pytest.approx(mean_db, abs=1e-4)
    assert -10 * np.log10(factor.min()) == pytest.approx(worst_db, rel=1e-4)
    assert cell_factor(np.array([4.0]), shape) == 1.0
