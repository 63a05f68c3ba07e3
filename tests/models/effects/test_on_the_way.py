"""What weakens signals on their way: ground and walls, rain, gases, wind and jammers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import fresnel

from plotfeed.models.clutter import inside
from plotfeed.models.effects.jamming import jamming_over_noise
from plotfeed.models.effects.line_of_sight import (
    EARTH_RADIUS_M,
    OPAQUE,
    ElevationTile,
    Ground,
    HorizonSettings,
    Obstruction,
    Walls,
    horizon_of,
    knife_edge_loss_db,
)
from plotfeed.models.effects.weather import (
    gases_db_per_km,
    rain_coefficients,
    rain_db_per_km,
    wind_noise_db,
)
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.propagation import BOLTZMANN_J_K, C_M_S, T0_K, radar_snr

# Horizons beside rays that are followed step by step, and one edge beside Fresnel's integral.


HERE = LocalFrame(40.5, -3.5, 700.0)
STRAIGHT = HorizonSettings(azimuths=1440, step_m=20.0, reach_m=9000.0, k=1.0)


def by_fresnel_db(nu):
    """The loss behind an edge by the integral that the recommendation approximates."""
    s, c = fresnel(nu)
    return -10 * np.log10(((1 - c - s) ** 2 + (c - s) ** 2) / 4)


def obstruction(horizon, *, diffracts=False, k=1.0):
    return Obstruction(frames=(HERE,), horizons=(horizon,), diffracts=diffracts, k=k)


def test_behind_an_edge_it_is_fresnels_integral_within_what_the_recommendation_says():
    nu = np.linspace(-0.7, 20, 5000)
    assert np.abs(knife_edge_loss_db(nu) - by_fresnel_db(nu)).max() < 0.14


def tile(heights_m, north_deg, west_deg, step_deg=1.0, **more) -> ElevationTile:
    steps = {"row_step_deg": step_deg, "column_step_deg": step_deg}
    return ElevationTile(
        heights_m=heights_m, north_deg=north_deg, west_deg=west_deg, **steps, **more
    )


def rough() -> Ground:
    """Hills of some 150 m, a kilometre apart."""
    rng = np.random.default_rng(5)
    row, column = np.mgrid[0:401, 0:401] / 20
    height_m = np.full((401, 401), 620.0)
    for _ in range(60):
        y, x = rng.uniform(0, 20, 2)
        bump = np.exp(-((row - y) ** 2 + (column - x) ** 2) / 0.6)
        height_m += rng.uniform(0, 150) * bump
    return Ground([tile(height_m, 40.6, -3.6, 0.0005)])


def test_the_running_maximum_answers_as_the_ray_that_is_followed():
    """Whether a straight ray stays above the ground, in 1500 steps."""
    ground, rng = rough(), np.random.default_rng(6)
    places = aer_to_enu(
        rng.uniform(0, 360, 400), rng.uniform(-1, 4, 400), rng.uniform(500, 8000, 400)
    )
    factor = obstruction(horizon_of(HERE, ground, None, STRAIGHT)).power_factor(places, 0.03)
    share = np.linspace(0.004, 0.999, 1500)[:, None]
    rays = (HERE.to_geodetic(share * place) for place in places)
    clear_m = np.array([(height_m - ground.height_m(*at)).min() for *at, height_m in rays])
    is_plain = np.abs(clear_m) > 3.0  # between samples of 20 m and 0.25 degrees
    assert is_plain.sum() > 100
    assert 50 < (clear_m[is_plain] < 0).sum() < is_plain.sum() - 50
    np.testing.assert_array_equal(factor[is_plain] < 0.5, clear_m[is_plain] < 0)


def test_walls_hide_what_the_ray_meets_at_entry_or_exit():
    """Towers about the place: rings of longitude and latitude, and how high they reach."""
    rng, rings, tops_m = np.random.default_rng(7), [], []
    for _ in range(40):
        middle = aer_to_enu(rng.uniform(0, 360), 0.0, rng.uniform(100, 1500))
        around = np.array([10.0, 100.0, 190.0, 280.0]), 0.0, rng.uniform(20, 60)
        latitude_deg, longitude_deg, _ = HERE.to_geodetic(middle + aer_to_enu(*around))
        rings.append(np.column_stack([longitude_deg, latitude_deg]))
        tops_m.append(700.0 + rng.uniform(-20, 80))
    settings = HorizonSettings(azimuths=36_000, step_m=20.0, reach_m=4000.0, k=1.0)
    horizon = horizon_of(HERE, None, Walls.of_rings(rings, tops_m), settings)
    places = aer_to_enu(rng.uniform(0, 360, 500), rng.uniform(-1, 5, 500), 2000.0)
    factor = obstruction(horizon).power_factor(places, 0.03)

    def is_hidden(place):
        latitude_deg, longitude_deg, height_m = HERE.to_geodetic(
            np.linspace(0, 1, 2001)[:, None] * place
        )
        return any(
            (inside(longitude_deg, latitude_deg, ring) & (height_m < top_m)).any()
            for ring, top_m in zip(rings, tops_m, strict=True)
        )

    hidden = np.array([is_hidden(place) for place in places])
    assert 50 < hidden.sum() < 450
    assert (hidden == (factor == OPAQUE)).mean() > 0.99  # azimuths are 0.01 degrees wide


@pytest.mark.parametrize("k", [1.0, 4 / 3])
def test_over_level_ground_the_horizon_is_that_of_the_effective_earth(k):
    mast, ground = LocalFrame(40.5, -3.5, 10.0), Ground([tile(np.zeros((3, 3)), 41.5, -4.5)])
    settings = HorizonSettings(azimuths=8, step_m=50.0, reach_m=40_000.0, k=k)
    horizon = horizon_of(mast, ground, None, settings)
    seen = Obstruction(frames=(mast,), horizons=(horizon,), diffracts=False, k=k)
    distance_m, target_m = np.arange(15_000.0, 40_000.0, 10.0), 15.0
    up_m = (target_m - 10.0) - distance_m**2 / (2 * EARTH_RADIUS_M)
    east = np.column_stack([distance_m, np.zeros(len(distance_m)), up_m])
    free = seen.power_factor(east, 0.03) > 0.5
    last_m = float(distance_m[free].max())
    expected_m = sum(np.sqrt(2 * k * EARTH_RADIUS_M * h) for h in (10.0, target_m))
    assert last_m == pytest.approx(expected_m, rel=0.01)
    assert not free[distance_m > last_m].any()


def test_from_a_transmitter_its_own_horizon_counts():
    mast = LocalFrame(*(float(x) for x in HERE.to_geodetic(np.array([4000.0, 0.0, 0.0]))))
    ground = rough()
    horizons = tuple(horizon_of(frame, ground, None, STRAIGHT) for frame in (HERE, mast))
    both = Obstruction(frames=(HERE, mast), horizons=horizons, diffracts=True, k=1.0)
    alone = Obstruction(frames=(mast,), horizons=horizons[1:], diffracts=True, k=1.0)
    rng = np.random.default_rng(9)
    places = aer_to_enu(rng.uniform(0, 360, 300), rng.uniform(0, 3, 300), 4500.0)
    from_mast = mast.from_ecef(HERE.to_ecef(places))
    found = both.power_factor(places, 0.1, HERE.from_ecef(mast.origin_ecef_m))
    np.testing.assert_array_equal(found, alone.power_factor(from_mast, 0.1))
    assert (found < 0.5).sum() > 20


def test_what_is_cut_off_still_has_a_level():
    assert 0 < OPAQUE**2 < 1e-30
    assert np.isfinite(20 * np.log10(OPAQUE))


def test_what_no_raster_knows_hides_nothing():
    void = tile(np.full((2, 2), -32768, ">i2"), 41, -4, void=-32768)
    elsewhere = tile(np.full((2, 2), 9000.0), 10, -4)
    horizon = horizon_of(HERE, Ground([void, elsewhere]), None, STRAIGHT)
    assert len(horizon.azimuth) == 0
    down = aer_to_enu(np.linspace(0, 360, 100), -5.0, 8000.0)
    assert (obstruction(horizon, diffracts=True).power_factor(down, 0.03) == 1.0).all()
    overhead = np.array([[0.0, 0.0, 50.0], [0.0, 0.0, 0.0]])
    assert (obstruction(horizon).power_factor(overhead, 0.03) == 1.0).all()


def test_a_raster_is_bilinear_between_its_samples_and_joins_the_next():
    heights = np.array([[0.0, 10.0], [20.0, 40.0]])
    west, east = tile(heights, 1, 0), tile(heights + 10, 1, 1)
    ground = Ground([west, east])
    latitude, longitude = np.array([1.0, 0.0, 0.5, 0.5, 0.5]), np.array([0.0, 1.0, 0.5, 1.5, 2.5])
    found = ground.height_m(latitude, longitude)
    np.testing.assert_array_equal(found, [0.0, 40.0, 17.5, 27.5, np.nan])
    raised = Ground([west], lambda lat, lon: lat + 100 * lon)
    assert raised.height_m(np.array([0.5]), np.array([0.5])) == pytest.approx(17.5 + 50.5)


# Rain, gases, wind and jammers: values worked out elsewhere, and laws that they must obey.


@pytest.mark.parametrize(
    ("f_ghz", "k_h", "alpha_v", "two_way_db"),
    [
        (9.4, 0.00925396596390006, 1.25742121078036, 1.17721543459635),
        (16, 0.0528173680489059, 1.02729004495201, 3.74620943487922),
        (24.15, 0.144638204425097, 0.955047612574112, 7.4312043054002),
    ],
)
def test_rain_weakens_as_the_formula_of_p838_says(f_ghz, k_h, alpha_v, two_way_db):
    assert float(rain_coefficients(f_ghz * 1e9, "horizontal")[0]) == pytest.approx(k_h, rel=1e-12)
    assert float(rain_coefficients(f_ghz * 1e9, "vertical")[1]) == pytest.approx(alpha_v, rel=1e-12)
    assert float(2 * rain_db_per_km(f_ghz * 1e9, 25)) == pytest.approx(two_way_db, rel=1e-12)


def test_circular_waves_are_weakened_between_the_other_two_and_dry_air_weakens_nothing():
    f_hz = np.linspace(10e9, 90e9, 200)
    each = [rain_db_per_km(f_hz, 10, p) for p in ("horizontal", "vertical", "circular")]
    assert (each[2] <= np.maximum(each[0], each[1]) * 1.01).all()
    assert (each[2] >= np.minimum(each[0], each[1]) * 0.99).all()
    assert (rain_db_per_km(f_hz, 0.0) == 0).all()


def test_gases_weaken_by_what_the_recommendations_figures_say():
    """Over 20 km at 7.5 and 15 g/m3, by the full sum of lines: within a tenth."""
    f_hz = np.array([10e9, 16e9, 24e9])
    np.testing.assert_allclose(20 * gases_db_per_km(f_hz, 7.5), [0.28, 0.71, 3.5], rtol=0.1)
    np.testing.assert_allclose(20 * gases_db_per_km(f_hz, 15.0), [0.44, 1.3, 6.7], rtol=0.1)
    assert np.isnan(gases_db_per_km(60e9, 7.5))
    line = gases_db_per_km(np.linspace(18e9, 28e9, 401), 7.5)
    assert np.linspace(18, 28, 401)[line.argmax()] == pytest.approx(22.235, abs=0.6)


def test_wind_is_19_db_louder_when_it_is_twice_as_fast_and_silent_when_there_is_none():
    wind = np.array([2.0, 4.0, 8.0])
    level_db = wind_noise_db(wind, 200.0, 0.09)
    np.testing.assert_allclose(np.diff(level_db), 63 * np.log10(2))
    assert float(wind_noise_db(10.0, 100.0, 0.1)) == pytest.approx(40 + 15, abs=1e-9)
    assert float(wind_noise_db(0.0, 100.0, 0.1)) == -np.inf


def test_a_target_that_jams_for_itself_is_drowned_as_the_equation_of_self_screening_says():
    """J/S = 4 pi R^2 ERP/B / (P G sigma T), whatever the receiver."""
    range_m, eirp_w, width_hz, noise_figure_db = 3000.0, 0.5, 20e6, 5.0
    power_w, gain_db, rcs_m2, time_s = 500.0, 20.0, 0.01, 0.06
    noise = BOLTZMANN_J_K * T0_K * 10 ** (noise_figure_db / 10)
    over_noise = jamming_over_noise(
        eirp_w=eirp_w, jammer_hz=10e9, jammer_width_hz=width_hz, range_m=range_m, gain_dbi=35.0,
        frequency_hz=10e9, bandwidth_hz=15e6, noise_w_hz=noise,
    )  # fmt: skip
    snr = radar_snr(power_w, gain_db, 35.0, C_M_S / 10e9, rcs_m2, time_s, range_m, range_m, 0.0,
                    noise_figure_db)  # fmt: skip
    radiated = power_w * 10 ** (gain_db / 10) * rcs_m2 * time_s
    expected = 4 * np.pi * range_m**2 * (eirp_w / width_hz) / radiated
    assert float(over_noise / snr) == pytest.approx(float(expected), rel=1e-9)
