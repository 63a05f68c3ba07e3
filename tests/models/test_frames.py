"""Frames against reference values of 60 digits, and the properties that hold everywhere."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.given_files import reference

from plotfeed.models.frames import (
    COLUMNS,
    GRID_FILE,
    ROWS,
    WGS84_A_M,
    WGS84_B_M,
    Axes,
    LocalFrame,
    aer_to_enu,
    are_all_within,
    ecef_to_geodetic,
    enu_to_aer,
    geodetic_to_ecef,
    geoid_undulation_m,
    packed,
    rows_about,
    unpacked,
    wrap_180,
    wrap_360,
)

latitudes = st.floats(-90, 90)
longitudes = st.floats(-180, 180)
heights = st.floats(-500, 20_000)
angles = st.floats(-1e6, 1e6)


def rows(table, *names):
    return zip(*(table[name] for name in names), strict=True)


def test_local_coordinates_agree_with_the_reference():
    table = reference("geodesy_local.csv")
    targets = geodetic_to_ecef(table["target_lat"], table["target_lon"], table["target_h"])
    sites = rows(table, "sensor_lat", "sensor_lon", "sensor_h")
    enu = np.array([LocalFrame(*s).from_ecef(t) for s, t in zip(sites, targets, strict=True)])
    expected = np.stack([table["east_m"], table["north_m"], table["up_m"]], axis=-1)
    assert np.abs(enu - expected).max() < 1e-8

    azimuth, elevation, slant = enu_to_aer(enu)
    np.testing.assert_allclose(slant, table["slant_range_m"], rtol=0, atol=1e-8)
    far = np.hypot(table["east_m"], table["north_m"]) >= 100
    assert far.sum() > 100
    assert np.abs(wrap_180(azimuth - table["azimuth_deg"]))[far].max() < 1e-9
    assert np.abs(elevation - table["elevation_deg"])[table["slant_range_m"] >= 100].max() < 1e-9


def test_positions_from_measurements_agree_with_the_reference():
    table = reference("geodesy_inverse.csv")
    enu = aer_to_enu(table["azimuth_deg"], table["elevation_deg"], table["slant_range_m"])
    sites = rows(table, "sensor_lat", "sensor_lon", "sensor_h")
    found = np.array([LocalFrame(*s).to_geodetic(e) for s, e in zip(sites, enu, strict=True)]).T
    expected = np.array([table["lat_deg"], table["lon_deg"], table["h_m"]])
    miss = geodetic_to_ecef(*found) - geodetic_to_ecef(*expected)
    assert np.linalg.norm(miss, axis=-1).max() < 1e-8
    assert np.abs(found[2] - expected[2]).max() < 1e-8


@pytest.mark.parametrize(
    ("geodetic", "ecef"),
    [
        ((0, 0, 0), (WGS84_A_M, 0, 0)),
        ((0, 90, 0), (0, WGS84_A_M, 0)),
        ((0, 180, 0), (-WGS84_A_M, 0, 0)),
        ((0, -180, 0), (-WGS84_A_M, 0, 0)),
        ((90, 123, 5), (0, 0, WGS84_B_M + 5)),
        ((-90, -45, 0), (0, 0, -WGS84_B_M)),
    ],
)
def test_axes_are_exact(geodetic, ecef):
    np.testing.assert_allclose(geodetic_to_ecef(*geodetic), ecef, rtol=2e-16, atol=0)


@given(latitudes, longitudes, st.floats(-10_000, 1e6))
def test_geodetic_round_trip(latitude, longitude, height):
    ecef = geodetic_to_ecef(latitude, longitude, height)
    found = ecef_to_geodetic(ecef)
    assert np.linalg.norm(geodetic_to_ecef(*found) - ecef) < 1e-8
    assert abs(found[0] - latitude) < 1e-13
    assert abs(found[2] - height) < 1e-8


@pytest.mark.parametrize("latitude", [90.0, -90.0])
def test_poles_have_latitude_height_and_longitude_zero(latitude):
    found = ecef_to_geodetic(geodetic_to_ecef(latitude, 77.0, 123.0))
    np.testing.assert_allclose(found, (latitude, 0.0, 123.0), rtol=0, atol=2e-9)


@pytest.mark.parametrize("centre", [(0, 0, 0), (40e3, 0, 0), (np.nan, 0, 0), (np.inf, 0, 0)])
def test_no_geodetic_position_near_the_centre_or_nowhere(centre):
    assert np.isnan(ecef_to_geodetic(centre)).any()


@given(latitudes, longitudes, heights, st.tuples(*[st.floats(-30e3, 30e3)] * 3))
def test_local_round_trip(latitude, longitude, height, enu):
    frame = LocalFrame(latitude, longitude, height)
    np.testing.assert_allclose(frame.from_ecef(frame.to_ecef(enu)), enu, rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        geodetic_to_ecef(*frame.to_geodetic(enu)), frame.to_ecef(enu), rtol=0, atol=1e-8
    )


@pytest.mark.parametrize("site", [(40.4168, -3.7038), (90.0, 0.0), (-89.99, 12.0), (7.0, 180.0)])
def test_straight_above_has_no_azimuth(site):
    frame = LocalFrame(*site, 100.0)
    azimuth, elevation, slant = enu_to_aer(frame.from_ecef(geodetic_to_ecef(*site, 620.0)))
    assert np.isnan(azimuth)
    assert elevation == 90.0
    assert slant == pytest.approx(520, abs=1e-8)


def test_where_there_is_no_direction_none_is_told():
    azimuth, elevation, slant = enu_to_aer([0.0, 0.0, 0.0])
    assert np.isnan([azimuth, elevation]).all()
    assert slant == 0
    for wrap in (wrap_180, wrap_360):
        assert np.isnan(wrap([np.nan, np.inf, -np.inf])).all()
    assert np.isnan(aer_to_enu(np.nan, 0, 1)[:2]).all()
    nowhere = LocalFrame(1, 2, 3).from_ecef([[np.nan, 0, 0], [np.inf, 0, 0]])
    assert not np.isfinite(nowhere).any()


def test_the_antimeridian_is_no_seam():
    west = LocalFrame(10.0, 180.0, 0.0).from_ecef(geodetic_to_ecef(10.0, -179.999, 0.0))
    plain = LocalFrame(10.0, 30.0, 0.0).from_ecef(geodetic_to_ecef(10.0, 30.001, 0.0))
    np.testing.assert_allclose(west, plain, atol=1e-8)
    sides = (LocalFrame(10.0, side, 0.0).origin_ecef_m for side in (180.0, -180.0))
    np.testing.assert_array_equal(*sides)


@pytest.mark.parametrize(
    ("azimuth", "direction"),
    [(0, (0, 1, 0)), (90, (1, 0, 0)), (180, (0, -1, 0)), (270, (-1, 0, 0)), (360, (0, 1, 0))],
)
def test_compass_points_are_exact(azimuth, direction):
    np.testing.assert_array_equal(aer_to_enu(azimuth, 0, 1), direction)
    assert enu_to_aer(direction)[0] == azimuth % 360


@given(st.floats(0, 359.999), st.floats(-89.9, 89.9), st.floats(0.1, 1e5))
def test_polar_round_trip(azimuth, elevation, slant):
    found = enu_to_aer(aer_to_enu(azimuth, elevation, slant))
    assert abs(wrap_180(found[0] - azimuth)) < 1e-12
    assert abs(found[1] - elevation) < 1e-12
    assert found[2] == pytest.approx(slant, rel=1e-15)


@given(angles)
def test_wrapped_angles_lie_in_their_interval_and_are_the_same_angle(angle):
    half, full = wrap_180(angle), wrap_360(angle)
    assert -180 <= half < 180
    assert 0 <= full < 360
    for wrapped in (half, full):
        turns = (angle - wrapped) / 360
        assert abs(turns - np.round(turns)) < 1e-12


@pytest.mark.parametrize(
    ("angle", "expected"),
    [(-1e-17, -1e-17), (180, -180), (-180, -180), (359.998, -0.002), (540, -180), (-190, 170)],
)
def test_wrap_180(angle, expected):
    assert wrap_180(angle) == pytest.approx(expected, rel=1e-10, abs=0)


@pytest.mark.parametrize("angle", [-1e-17, 0.0, -0.0, 360.0, 720.0, -360.0])
def test_360_is_0(angle):
    folded = wrap_360(angle)
    assert folded == 0
    assert not np.signbit(folded)


def test_a_position_of_single_precision_loses_metres_and_ours_does_not() -> None:
    frame = LocalFrame(40.45, -3.73, 650.0)
    ecef_m = frame.to_ecef(np.array([1234.5678, -987.6543, 55.5]))
    rounded = frame.from_ecef(ecef_m.astype(np.float32))
    assert np.abs(rounded - [1234.5678, -987.6543, 55.5]).max() > 0.05
    assert np.abs(frame.from_ecef(ecef_m) - [1234.5678, -987.6543, 55.5]).max() < 5e-9


def test_shapes_broadcast():
    ecef = geodetic_to_ecef(np.zeros((4, 1)), np.zeros(5), 0.0)
    assert ecef.shape == (4, 5, 3)
    frame = LocalFrame(1.0, 2.0, 3.0)
    assert frame.from_ecef(ecef).shape == frame.to_ecef(ecef).shape == (4, 5, 3)
    assert [part.shape for part in enu_to_aer(ecef)] == [(4, 5)] * 3
    assert [part.shape for part in ecef_to_geodetic(ecef)] == [(4, 5)] * 3
    assert aer_to_enu(np.zeros(6), 0.0, np.ones((2, 1))).shape == (2, 6, 3)
    assert frame.from_ecef(np.zeros((0, 3))).shape == (0, 3)
    assert geoid_undulation_m(np.zeros((3, 1)), np.zeros(4)).shape == (3, 4)
    assert geoid_undulation_m(0.0, 0.0).shape == ()
    assert np.isnan(geoid_undulation_m([np.nan, 0.0], [0.0, np.nan])).all()


@pytest.mark.parametrize("elevation", [90.0, -90.0])
def test_straight_up_and_down_a_place_needs_no_azimuth(elevation):
    frame, up = LocalFrame(40.45, -3.73, 650.0), np.sign(elevation) * 400.0
    assert frame.heights_m(np.nan, elevation, 400.0) == pytest.approx(650.0 + up, abs=1e-6)
    np.testing.assert_array_equal(aer_to_enu(np.nan, elevation, 400.0), [0.0, 0.0, up])
    both = frame.heights_m([np.nan, np.nan], [elevation, 45.0], [400.0, 400.0])
    assert np.isnan(both).tolist() == [False, True]


@given(
    st.lists(st.tuples(st.floats(-89, 89), st.floats(-180, 180)), min_size=1, max_size=5),
    st.floats(0.0, 3.0),
    st.integers(0, 2**32 - 1),
)
def test_whoever_is_within_reach_of_any_frame_is_about_and_who_is_far_from_all_is_not(
    places: list[tuple[float, float]], spread_deg: float, seed: int
) -> None:
    """By each pair, of one town or all over the globe, some positions NaN."""
    rng = np.random.default_rng(seed)
    first = np.array(places[0])
    near = [first + spread_deg * np.tanh(np.array(place) / 90) for place in places]
    every = places if spread_deg > 2.5 else near
    frames = Axes.of([LocalFrame(float(lat), float(lon), 100.0) for lat, lon in every])
    origins_m = frames.origin_ecef_m.reshape(-1, 3)
    within_m = rng.uniform(100, 20_000, len(every))
    chosen = origins_m[rng.integers(0, len(every), (2, 40))]
    step_m = rng.normal(size=(2, 40, 3))
    step_m *= 10 ** rng.uniform(1, 6, (2, 40, 1)) / np.linalg.norm(step_m, axis=-1, keepdims=True)
    positions_m = chosen + step_m
    positions_m[:, :3] = np.nan
    apart_m = np.linalg.norm(positions_m[:, :, None] - origins_m, axis=-1)
    found = rows_about(frames, positions_m, within_m)
    assert (np.diff(found) > 0).all()
    assert set(np.flatnonzero((apart_m <= within_m).any(axis=(0, 2)))) <= set(found.tolist())
    size_m = np.linalg.norm(origins_m[:, None] - origins_m, axis=-1).max()
    furthest_m = within_m.max() + 2 * size_m + 1.0
    assert (np.nanmin(apart_m[:, found], axis=(0, 2)) <= furthest_m).all()
    assert (
        are_all_within(frames, positions_m[:, 3:], within_m) <= (apart_m[:, 3:] <= within_m).all()
    )
    assert are_all_within(frames, origins_m, np.full(len(every), 2 * size_m + 1.001))


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


def test_what_is_packed_is_unpacked() -> None:
    grid_dm = np.random.default_rng(5).integers(-1100, 900, (ROWS, COLUMNS)).astype(np.int16)
    assert (unpacked(packed(grid_dm)) == grid_dm).all()
