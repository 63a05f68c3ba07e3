"""Where a radar looks: blind range, instrumented range, and covers in azimuth and elevation."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy import integrate
from scipy.special import ndtr
from support.radar_equations import detected_power_density, mean_snr, sigma_range_m
from support.significance import assert_sum

from plotfeed.testing import Feed, fly, held, radar, rotating, scene, staring

BLIND_M, FAR_M = 1000.0, 1100.0
RCS_M2 = 2e-6
SHORT = radar(range_resolution_m=300.0, range_min_m=BLIND_M, range_max_m=FAR_M, pfa=1e-4)
INSIDE_M = (1000.5, 1003.0, 1010.0, 1040.0, 1090.0, 1097.0, 1099.5)
OUTSIDE_M = (10.0, 950.0, 999.5, 1100.5, 1150.0, 3000.0)
SCANS = 400


@cache
def edges() -> Feed:
    drones = [
        held(f"{range_m}:{i}", 10 * i + 5, 8.0, range_m, rcs_m2=RCS_M2)
        for range_m in INSIDE_M + OUTSIDE_M
        for i in range(10)
    ]
    return fly(scene([SHORT], drones, seed=31), SCANS)


def test_looks_begin_at_the_blind_range_and_end_at_the_instrumented_one() -> None:
    looks = edges().looks()
    seen, times = np.unique(looks.drone, return_counts=True)
    assert set(seen) == {f"{range_m}:{i}" for range_m in INSIDE_M for i in range(10)}
    assert set(times) == {SCANS}


def test_nothing_is_reported_outside_the_range_that_is_reported() -> None:
    plots = edges().plots()
    assert BLIND_M <= plots.range_m.min() < BLIND_M + 1
    assert FAR_M - 1 < plots.range_m.max() <= FAR_M
    assert np.abs(plots.rho_nm * 1852 - plots.range_m).max() <= 1852 / 512 + 1e-9


@pytest.mark.parametrize("range_m", INSIDE_M)
def test_the_share_lost_at_an_edge_is_what_errors_carry_over_it(range_m: float) -> None:
    """Of those over the threshold; by quadrature over the power of a detection."""
    snr = float(mean_snr(SHORT, range_m, RCS_M2))

    def lost(power: float) -> float:
        sigma_m = sigma_range_m(SHORT, power)
        beyond = ndtr((BLIND_M - range_m) / sigma_m) + ndtr((range_m - FAR_M) / sigma_m)
        return float(beyond * detected_power_density(SHORT, power, snr))

    share = integrate.quad(lost, 0.01, 30 * (1 + snr), limit=400)[0]
    looks, plots = edges().looks(), edges().plots()
    mine = np.char.startswith(looks.drone, f"{range_m}:")
    over = int(looks.detected[mine].sum())
    reported = int(np.char.startswith(plots.drone, f"{range_m}:").sum())
    assert over > 3000
    variance = max(share * (1 - share), 1e-9) * over
    assert_sum(over - reported, share * over, variance, f"lost {share:.3f}")


COVERS = [(-20.0, 35.0), (340.0, 360.0), (200.0, 350.0), (-180.0, 180.0), (-350.0, -5.0)]


@pytest.mark.parametrize("scan", [staring(), rotating(1.0, 5), rotating(1.0, 32)])
@pytest.mark.parametrize("cover", COVERS)
def test_a_cover_holds_what_lies_clockwise_between_its_azimuths(
    cover: tuple[float, float], scan: dict[str, object]
) -> None:
    low, high = cover
    sensor = radar(scan=scan, azimuth_min_deg=low, azimuth_max_deg=high, pfa=1e-5)
    drones = [held(str(azimuth), azimuth, 8.0, 700.0) for azimuth in np.arange(0.5, 360.0, 5.0)]
    road = fly(scene([sensor], drones, seed=32), 20)
    seen, times = np.unique(road.looks().drone, return_counts=True)
    within = [d["id"] for d in drones if (float(d["id"]) - low) % 360 < high - low]
    assert sorted(seen) == sorted(within)
    assert set(times) == {20}
    alarms = road.plots().rows(road.plots().drone == "")
    assert len(alarms) > 30
    assert ((alarms.azimuth_deg - low) % 360 <= high - low).all()


@pytest.mark.parametrize("scan", [staring(), rotating(1.0, 8)])
def test_a_cover_in_elevation_holds_what_lies_between(scan: dict[str, object]) -> None:
    sensor = radar(scan=scan, elevation_min_deg=2.0, elevation_max_deg=20.0, pfa=1e-5)
    drones = [held(str(el), 100.0 + el, el, 700.0) for el in np.arange(-10.25, 90.0, 0.5)]
    road = fly(scene([sensor], drones, seed=33), 20)
    seen, times = np.unique(road.looks().drone, return_counts=True)
    assert sorted(seen) == sorted(d["id"] for d in drones if 2 < float(d["id"]) < 20)
    assert set(times) == {20}
    alarms = road.plots().rows(road.plots().drone == "")
    assert 2 <= alarms.elevation_deg.min() < 2.5
    assert 19.5 < alarms.elevation_deg.max() <= 20


def test_a_two_dimensional_radar_reports_neither_elevation_nor_height() -> None:
    sensor = radar(measures_elevation=False)
    plots = fly(scene([sensor], [held("d", 10.0, 8.0, 700.0)], seed=34), 20).plots()
    for absent in ("elevation_deg", "height_m", "sigma_elevation_deg", "altitude_ft"):
        assert np.isnan(plots.columns[absent]).all()
    assert np.isfinite(plots.range_m).all()
