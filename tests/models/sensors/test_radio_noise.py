"""External noise: lines of ITU-R P.372, where they hold, and their sum."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.propagation import GALACTIC, MAN_MADE, external_noise_db

ENVIRONMENTS = pytest.mark.parametrize("environment", MAN_MADE)


@pytest.mark.parametrize(
    ("environment", "at_1_mhz", "at_10_mhz"),
    [
        ("city", 76.8, 49.1),
        ("residential", 72.5, 44.8),
        ("rural", 67.2, 39.5),
        ("quiet-rural", 53.6, 25.0),
    ],
)
def test_man_made_noise_is_c_at_1_mhz_and_loses_d_a_decade(environment, at_1_mhz, at_10_mhz):
    line = MAN_MADE[environment]
    assert line.median_db([1e6, 10e6]) == pytest.approx([at_1_mhz, at_10_mhz], abs=1e-12)
    assert external_noise_db(environment, 1e6) == pytest.approx(at_1_mhz)  # nothing else there


def test_residential_noise_continued_to_600_mhz_is_what_section_4_gives():
    line = MAN_MADE["residential"]
    assert line.c_db - line.d_db * np.log10(600) == pytest.approx(-4.45, abs=0.005)
    assert np.isnan(external_noise_db("residential", 600e6))


def test_powers_of_man_made_and_galactic_noise_add():
    assert GALACTIC.median_db(100e6) == pytest.approx(6.0)
    # rural at 100 MHz is 11.8 dB; 15.14 + 3.98 is 19.12
    assert external_noise_db("rural", 100e6) == pytest.approx(12.814, abs=1e-3)
    assert external_noise_db("rural", 101e6) == pytest.approx(11.68, abs=0.01)


@ENVIRONMENTS
def test_there_is_no_noise_outside_the_range_of_the_line(environment):
    line = MAN_MADE[environment]
    edges_hz = 1e6 * np.array([line.min_mhz, line.max_mhz])
    assert np.isfinite(external_noise_db(environment, edges_hz)).all()
    outside = np.array([0.0, -1.0, 0.99 * edges_hz[0], 1.01 * edges_hz[1], 1e12, np.inf, np.nan])
    assert np.isnan(external_noise_db(environment, outside)).all()


@given(st.floats(0.3e6, 250e6))
def test_the_busier_the_place_the_louder(frequency_hz):
    city, residential, rural = (
        external_noise_db(place, frequency_hz) for place in ("city", "residential", "rural")
    )
    assert city > residential > rural
    quiet = external_noise_db("quiet-rural", frequency_hz)
    assert np.isnan(quiet) if frequency_hz > 100e6 else quiet < rural
