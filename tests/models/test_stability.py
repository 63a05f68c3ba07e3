"""Where a plain float64 form fails, and what ours does there: one test for each such place."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special
from support import mimo_equations

from plotfeed.models import accuracy, detection, propagation
from plotfeed.models.beam import AzimuthCover, Sector
from plotfeed.models.frames import LocalFrame, enu_to_aer, geodetic_to_ecef, wrap_180, wrap_360
from plotfeed.models.sensors.active_radar import ActiveRadar
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Signatures

RADAR = ActiveRadar(
    power_w=500.0,
    frequency_hz=10e9,
    gain_tx_dbi=20.0,
    gain_rx_dbi=35.4,
    integration_s=0.06,
    loss_db=4.0,
    noise_figure_db=5.0,
    pfa=1e-6,
    n_reference=16,
    range_resolution_m=10.0,
    range_min_m=0.0,
    range_max_m=10_000.0,
    azimuth_beamwidth_deg=2.0,
    elevation_beamwidth_deg=6.0,
    azimuth_cover=AzimuthCover(-180.0, 180.0),
    elevation_min_deg=-90.0,
    elevation_max_deg=90.0,
    doppler_cells=1,
    range_floor_m=0.1,
    azimuth_floor_deg=0.01,
    elevation_floor_deg=0.01,
    measures_elevation=True,
)


def targets(*enu_m: tuple[float, float, float], rcs_m2: float = 0.01) -> Targets:
    position = np.array(enu_m, dtype=np.float64).reshape(-1, 3)
    n = len(position)
    return Targets(
        drone=np.arange(n),
        t_utc_ns=np.zeros(n, np.int64),
        position_enu_m=position,
        true_position_enu_m=position,
        signatures=Signatures(
            rcs_m2=np.full(n, rcs_m2), sound_power_db=np.full(n, np.nan), emitters=[()] * n
        ),
    )


def test_a_pd_of_a_trillionth_keeps_its_digits() -> None:
    looks, pfa, snr = 3, 1e-12, 1e-3
    threshold = detection.threshold_noncoherent(pfa, looks) / (1 + snr)
    exact = math.exp(-threshold) * (1 + threshold + threshold**2 / 2)  # order 3, by hand
    plain = 1 - special.gammainc(looks, threshold)
    ours = detection.pd_noncoherent_swerling2(snr, pfa, looks)
    assert abs(plain / exact - 1) > 1e-7
    assert ours == pytest.approx(exact, rel=1e-13)


def test_a_miss_at_60_db_keeps_its_digits() -> None:
    looks, pfa, snr = 3, 1e-6, 1e6
    x = float(detection.threshold_noncoherent(pfa, looks) / (1 + snr))
    exact = x**3 / 6 * (1 - 3 * x / 4 + 3 * x**2 / 10)  # the series of the incomplete gamma
    plain = 1 - detection.pd_noncoherent_swerling2(snr, pfa, looks)
    ours = detection.miss_noncoherent_swerling2(snr, pfa, looks)
    assert abs(plain / exact - 1) > 1e-3
    assert ours == pytest.approx(exact, rel=1e-13)


def test_the_multiplier_of_a_trillion_reference_cells_keeps_its_digits() -> None:
    n = 1e12
    y = -math.log(1e-6) / n
    exact = y + y**2 / 2
    assert abs((1e-6 ** (-1 / n) - 1) / exact - 1) > 1e-7
    assert detection.cfar_multiplier(1e-6, n) == pytest.approx(exact, rel=1e-15)


def test_looks_of_equal_snr_have_a_pd() -> None:
    equal = detection.pd_noncoherent_unequal(np.full(3, 10.0), 1e-6)
    with np.errstate(all="ignore"):
        rates = 1 / (1 + np.full(3, 10.0))
        plain = np.prod(rates[:2] / (rates[:2] - rates[2]))
    assert not np.isfinite(plain)
    assert equal == pytest.approx(float(detection.pd_noncoherent_swerling2(10.0, 1e-6, 3)), 1e-13)
    assert detection.pd_noncoherent_unequal_cfar(np.full(3, 10.0), 1e-6, 48) == pytest.approx(
        float(detection.pd_noncoherent_cfar(10.0, 1e-6, 3, 48)), 1e-12
    )


def test_a_threshold_for_a_pfa_below_the_rounding_of_one() -> None:
    assert special.gammaincinv(3, 1 - 1e-17) == math.inf
    y = float(detection.threshold_noncoherent(1e-17, 3))
    assert math.exp(-y) * (1 + y + y**2 / 2) == pytest.approx(1e-17, rel=1e-13)


@pytest.mark.parametrize("apart_db", [1e-2, 1e-6, 1e-10])
def test_looks_of_nearly_equal_snr_against_a_cfar(apart_db: float) -> None:
    snrs = 10 ** ((10.0 + apart_db * np.array([-1.0, 0.0, 1.0])) / 10)
    over = float(detection.threshold_noncoherent_cfar(1e-6, 3, 48))
    exact = mimo_equations.pd(snrs, over, 48)
    assert detection.pd_noncoherent_unequal_cfar(snrs, 1e-6, 48) == pytest.approx(exact, rel=1e-12)


def test_bistatic_range_a_tenth_of_a_millimetre_off_the_baseline() -> None:
    transmitter = np.array([20_000.0, 0.0, 0.0])
    target = np.array([7000.0, 1e-4, 0.0])
    exact = 1e-8 / 2 * (1 / 7000.0 + 1 / 13_000.0)  # to second order in the offset
    ways = np.linalg.norm(target) + np.linalg.norm(target - transmitter)
    assert abs((ways - 20_000.0) / exact - 1) > 0.5
    assert propagation.bistatic_range(target, transmitter) == pytest.approx(exact, rel=1e-8)


def test_a_place_next_to_the_baseline_comes_back() -> None:
    baseline_m, along_m, off_m = 20_000.0, 7000.0, 1e-5
    detour_m = off_m**2 / 2 * (1 / along_m + 1 / (baseline_m - along_m))
    angle_rad = math.atan2(off_m, along_m)
    depth_m = baseline_m * (1 - math.cos(angle_rad))
    plain_m = detour_m * (detour_m + 2 * baseline_m) / (2 * (detour_m + depth_m))
    assert abs(plain_m - along_m) > 1000
    found_m = propagation.range_from_bistatic(detour_m, baseline_m, math.degrees(angle_rad))[0]
    assert found_m == pytest.approx(along_m, rel=1e-12)


def test_a_millimetre_off_the_vertical_at_10_km_is_resolved() -> None:
    off_m, up_m = 1e-3, 10_000.0
    exact_deg = math.degrees(off_m / up_m)
    plain_deg = 90 - math.degrees(math.asin(up_m / math.hypot(off_m, up_m)))
    assert abs(plain_deg / exact_deg - 1) > 1e-3
    assert 90 - enu_to_aer(np.array([off_m, 0.0, up_m]))[1] == pytest.approx(exact_deg, rel=1e-8)


def test_a_position_of_single_precision_loses_metres_and_ours_does_not() -> None:
    frame = LocalFrame(40.45, -3.73, 650.0)
    ecef_m = frame.to_ecef(np.array([1234.5678, -987.6543, 55.5]))
    rounded = frame.from_ecef(ecef_m.astype(np.float32))
    assert np.abs(rounded - [1234.5678, -987.6543, 55.5]).max() > 0.05
    assert np.abs(frame.from_ecef(ecef_m) - [1234.5678, -987.6543, 55.5]).max() < 5e-9


@pytest.mark.parametrize("snr_db", [1e3, 1e4, -1e3, -1e4])
def test_a_listener_far_from_its_sensitivity_is_certain(snr_db: float) -> None:
    assert detection.pd_logistic(snr_db, 0.0) == (1.0 if snr_db > 0 else pytest.approx(0.0))


def test_an_angle_a_hair_below_north_is_north() -> None:
    assert (-1e-17) % 360 == 360.0
    assert wrap_360(-1e-17) == 0.0


def test_angles_of_vectors_whose_cosine_rounds_past_one() -> None:
    u = np.array([1.0, 2.0, 3.0]) / math.sqrt(14)
    along = enu_to_aer(np.stack([u * 1e4, np.array([0.0, 0.0, 5.0]), np.array([0.0, 0.0, -5.0])]))
    assert np.isfinite(along[1]).all()
    assert along[1][1] == 90.0
    assert along[1][2] == -90.0
    same_way = propagation.range_from_bistatic(100.0, 20_000.0, 0.0)[0]
    assert not np.isnan(same_way)


def test_no_distance_and_infinite_snr_leave_the_floor_of_errors() -> None:
    assert accuracy.with_floor(accuracy.sigma_range_m(np.inf, 10.0), 0.3) == 0.3
    assert accuracy.with_floor(accuracy.sigma_angle_deg(np.inf, 2.0), 0.1) == 0.1
    looks, plots = RADAR.observe(
        targets((0.0, 0.0, 0.0), (0.0, 1e-9, 0.0)), np.random.default_rng(1)
    )
    assert 0 not in looks.drone
    assert np.isfinite(plots.range_m).all()


def test_longitudes_on_both_sides_of_the_date_line_are_close() -> None:
    plain_deg = 179.999 - (-179.999)
    assert plain_deg > 359
    assert wrap_180(plain_deg) == pytest.approx(-0.002)
    frame = LocalFrame(10.0, 179.999, 0.0)
    assert np.linalg.norm(frame.from_ecef(geodetic_to_ecef(10.0, -179.999, 0.0))) < 300


def test_no_plot_has_a_range_below_the_blind_one() -> None:
    """At one metre, with errors of ten: more than four in ten ranges would come out negative."""
    near = replace(RADAR, range_floor_m=10.0)
    many = targets(*[(1.0, 0.0, 0.0)] * 4000)
    _, plots = near.observe(many, np.random.default_rng(2))
    assert 1500 < len(plots) < 2900
    assert plots.range_m.min() > 0


def test_at_the_zenith_there_is_no_azimuth_and_no_plot() -> None:
    azimuth_deg, elevation_deg, _ = enu_to_aer(np.array([0.0, 0.0, 100.0]))
    assert np.isnan(azimuth_deg)
    assert elevation_deg == 90.0
    looks, plots = RADAR.observe(targets((0.0, 0.0, 100.0)), np.random.default_rng(3))
    assert len(looks) == len(plots) == 0


WIDE = {
    "power_w": st.floats(1e-3, 1e7),
    "frequency_hz": st.floats(1e6, 1e12),
    "gain_tx_dbi": st.floats(-20, 80),
    "gain_rx_dbi": st.floats(-20, 80),
    "integration_s": st.floats(1e-6, 10),
    "loss_db": st.floats(0, 60),
    "noise_figure_db": st.floats(0, 40),
    "pfa": st.floats(1e-15, 0.1),
    "n_reference": st.integers(1, 1_000_000),
    "range_resolution_m": st.floats(0.01, 1e4),
    "azimuth_beamwidth_deg": st.floats(0.01, 360),
    "elevation_beamwidth_deg": st.floats(0.01, 180),
}
PLACES = st.tuples(*[st.floats(-5000, 5000)] * 3)


@given(st.fixed_dictionaries(WIDE), st.lists(PLACES, min_size=1, max_size=8), st.floats(1e-6, 1e4))
def test_a_radar_of_any_kind_gives_numbers(
    keys: dict[str, float], places: list[tuple[float, float, float]], rcs_m2: float
) -> None:
    radar = replace(RADAR, **keys)
    seen = targets(*places, rcs_m2=rcs_m2)
    looks, plots = radar.observe(seen, np.random.default_rng(4))
    assert ((looks.pd >= 0) & (looks.pd <= 1)).all()
    for name in ("range_m", "azimuth_deg", "elevation_deg", "snr", "amplitude_dbm"):
        assert np.isfinite(getattr(plots, name)).all(), name
    for name in ("sigma_range_m", "sigma_azimuth_deg", "sigma_elevation_deg", "run_length_deg"):
        assert (getattr(plots, name) >= 0).all(), name
    assert ((plots.azimuth_deg >= 0) & (plots.azimuth_deg < 360)).all()
    assert (np.abs(plots.elevation_deg) <= 90).all()


@given(st.fixed_dictionaries(WIDE), st.floats(1.0, 9999.0), st.floats(1.0, 1.5))
def test_pd_does_not_grow_with_distance(
    keys: dict[str, float], range_m: float, more: float
) -> None:
    radar = replace(RADAR, **keys)
    pd = radar.predict(targets((range_m, 0.0, 0.0), (range_m * more, 0.0, 0.0))).pd
    assert pd[1] <= pd[0] * (1 + 1e-12)


@given(st.fixed_dictionaries(WIDE), st.floats(0, 359), st.floats(0.01, 360))
def test_false_alarms_of_any_radar_lie_in_its_cover(
    keys: dict[str, float], start_deg: float, width_deg: float
) -> None:
    cover = AzimuthCover(start_deg, start_deg + width_deg)
    few_cells = {"range_resolution_m": 5000.0, "azimuth_beamwidth_deg": 20.0, "pfa": 1e-2}
    radar = replace(RADAR, **(keys | few_cells), azimuth_cover=cover)
    radar = replace(radar, elevation_beamwidth_deg=45.0)
    whole_scan = Sector(0, 0, 0, 1_000_000_000, 0.0, 360.0)
    plots = radar.draw_false_alarms(whole_scan, np.random.default_rng(5))
    assert cover.holds(plots.azimuth_deg).all()
    assert ((plots.range_m >= radar.range_min_m) & (plots.range_m <= radar.range_max_m)).all()
