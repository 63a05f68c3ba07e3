from __future__ import annotations

from importlib.resources import files

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.frames import COLUMNS, GRID_FILE, ROWS, geoid_undulation_m, packed, unpacked

LONGITUDES = st.floats(-180, 180)


def test_places_are_known() -> None:
    """From the 15' file, which lists no more than its nodes: Madrid, and the ends of the geoid."""
    assert geoid_undulation_m(40.45, -3.73) == pytest.approx(51.6, abs=1.3)
    assert geoid_undulation_m(4.75, 78.75) == pytest.approx(-106.9, abs=1.3)
    assert geoid_undulation_m(-8.25, 147.25) == pytest.approx(85.0, abs=4.0)


def test_it_is_the_grids_own_value_at_every_node() -> None:
    grid_dm = unpacked(files("plotfeed.models").joinpath(GRID_FILE).read_bytes())
    latitude_deg = 90.0 - np.arange(ROWS)[:, None] / 2
    longitude_deg = np.arange(COLUMNS)[None] / 2
    assert (geoid_undulation_m(latitude_deg, longitude_deg) == grid_dm / 10).all()
    assert (geoid_undulation_m(latitude_deg, longitude_deg - 360.0) == grid_dm / 10).all()


@given(latitude=st.floats(-90, 90), longitude=LONGITUDES)
def test_between_nodes_it_is_bilinear(latitude: float, longitude: float) -> None:
    south, west = np.floor(2 * latitude) / 2, np.floor(2 * longitude) / 2
    north, east = min(south + 0.5, 90.0), west + 0.5
    v, u = 2 * (latitude - south), 2 * (longitude - west)
    corners = geoid_undulation_m([[south, south], [north, north]], [west, east])
    expected = np.array([1 - v, v]) @ corners @ np.array([1 - u, u])
    assert geoid_undulation_m(latitude, longitude) == pytest.approx(expected, abs=1e-9)


@given(latitude=st.floats(-90, 90))
def test_it_is_continuous_at_the_antimeridian_and_at_greenwich(latitude: float) -> None:
    for meridian in (0.0, 180.0):
        sides = geoid_undulation_m(latitude, meridian + np.array([-360.0, -1e-12, 0.0, 1e-12]))
        assert np.ptp(sides) < 1e-8
    assert geoid_undulation_m(latitude, -1e-300) == geoid_undulation_m(latitude, 0.0)


@given(longitude=LONGITUDES, pole=st.sampled_from([-90.0, 90.0]))
def test_a_pole_is_one_place(longitude: float, pole: float) -> None:
    assert geoid_undulation_m(pole, longitude) == (13.6 if pole > 0 else -29.5)
    near = geoid_undulation_m(np.copysign(90.0 - 1e-9, pole), longitude)
    assert near == pytest.approx(geoid_undulation_m(pole, 0.0), abs=1e-6)


def test_it_broadcasts_and_nan_has_no_height() -> None:
    assert geoid_undulation_m(np.zeros((3, 1)), np.zeros(4)).shape == (3, 4)
    assert geoid_undulation_m(0.0, 0.0).shape == ()
    assert np.isnan(geoid_undulation_m([np.nan, 0.0], [0.0, np.nan])).all()


def test_what_is_packed_is_unpacked() -> None:
    grid_dm = np.random.default_rng(5).integers(-1100, 900, (ROWS, COLUMNS)).astype(np.int16)
    assert (unpacked(packed(grid_dm)) == grid_dm).all()
