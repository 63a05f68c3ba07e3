"""Errors of the plots that leave as bytes: as stated, as predicted, and as quantised."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from support.significance import assert_law, assert_mean

from plotfeed.models.frames import aer_to_enu, wrap_180
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.utc import NS
from plotfeed.testing import SITE, START_NS, Feed, FeedTable, fly, held, radar, rotating, scene

# Mean signal-to-noise ratios from 74 dB to 20 dB.
RADAR = radar(elevation_max_deg=30.0)

RHO_LSB_M = 1852 / 256
THETA_LSB_DEG = 360 / 65536
ALTITUDE_LSB_M = 25 * 0.3048
DAY_NS = 86_400 * NS


def detections(plots: FeedTable) -> FeedTable:
    return plots.rows(plots.drone != "")


FINE = radar(
    id="fine",
    pfa=1e-12,
    range_resolution_m=1.0,
    azimuth_beamwidth_deg=0.1,
    elevation_beamwidth_deg=0.1,
)
COARSE = radar(
    id="coarse",
    power_w=0.5,
    pfa=1e-12,
    sic=2,
    range_resolution_m=500.0,
    azimuth_beamwidth_deg=4.0,
    elevation_beamwidth_deg=4.0,
)
UNDULATION_M = 51.0


@cache
def scattered() -> Feed:
    """One look of both at each of many drones that are anywhere between 2 and 4 km."""
    rng = np.random.default_rng(2)
    drones = [
        held(f"d{i}", rng.uniform(0, 360), rng.uniform(5, 40), rng.uniform(2000, 4000), rcs_m2=1.0)
        for i in range(1500)
    ]
    datum = {"telemetry": {"geoid_undulation_m": UNDULATION_M}}
    return fly(scene([FINE, COARSE], drones, seed=22, **datum), 1)


@pytest.mark.parametrize("sensor", ["fine", "coarse"])
def test_rms_of_category_048_is_that_of_the_sensor_and_of_half_an_lsb(sensor: str) -> None:
    """Variances add: sigma squared and LSB squared over 12."""
    plots = detections(scattered().plots(sensor))
    assert len(plots) > 1350
    for of, error, sigma, lsb in (
        ("RHO", plots.rho_nm * 1852 - plots.true_range_m, plots.sigma_range_m, RHO_LSB_M),
        (
            "THETA",
            wrap_180(plots.theta_deg - plots.true_azimuth_deg),
            plots.sigma_azimuth_deg,
            THETA_LSB_DEG,
        ),
    ):
        total = np.sqrt(sigma**2 + lsb**2 / 12)
        assert_mean((error / total) ** 2, 1.0, of)
        assert_mean(error / total, 0.0, f"bias of {of}")
        noise_to_quantisation = np.median(sigma) / lsb * np.sqrt(12)
        assert (noise_to_quantisation > 1) == (sensor == "coarse")


def test_category_015_states_errors_with_their_rounding_and_none_as_zero() -> None:
    """By an echo of 90 dB, whose own errors are far below an LSB of 0.1 m and of 0.0055 degrees."""
    places = [(0.234 * i, 5.0 + 0.0142 * i, 400.0 + 1.474 * i) for i in range(1500)]
    drones = [held(f"d{i}", *place, rcs_m2=10.0) for i, place in enumerate(places)]
    sensor = FINE | {"id": "radar", "report": ["asterix-015", "plots"]}
    flight = fly(scene([sensor], drones, seed=25), 1)
    plots = detections(flight.plots())
    records = [r for block in flight.payloads("radar/asterix/015") for r in decode(block)]
    assert len(plots) == len(records) > 1450
    for path, stated_path, of, lsb in (
        ("I015/625/R", "I015/625/SDR", "range_m", 0.1),
        ("I015/627/AZ", "I015/627/SDASZ", "azimuth_deg", 360 / 2**16),
        ("I015/628/EL", "I015/628/SDEL", "elevation_deg", 180 / 2**16),
    ):
        told, stated = (np.array([r.get(p) for r in records], float) for p in (path, stated_path))
        error = told - plots.columns[f"true_{of}"]
        sigma = plots.columns[f"sigma_{of}"]
        assert np.median(sigma) < lsb / 2
        total = np.sqrt(sigma**2 + lsb**2 / 12)
        assert_mean((error / total) ** 2, 1.0, path)
        assert (stated >= total * (1 - 1e-12)).all()
        assert (stated <= total + 0.1 + 1e-12).all()


@pytest.mark.parametrize("sensor", ["fine", "coarse"])
def test_category_048_is_the_protobuf_to_half_an_lsb(sensor: str) -> None:
    plots = detections(scattered().plots(sensor))
    for difference, lsb in (
        (plots.rho_nm * 1852 - plots.range_m, RHO_LSB_M),
        (wrap_180(plots.theta_deg - plots.azimuth_deg), THETA_LSB_DEG),
        (plots.altitude_ft * 0.3048 + UNDULATION_M - plots.height_m, ALTITUDE_LSB_M),
    ):
        assert np.abs(difference).max() <= lsb / 2 * (1 + 1e-9)
        assert_law((difference / lsb + 0.5), "uniform")


@pytest.mark.parametrize("sensor", ["fine", "coarse"])
def test_altitude_has_the_error_of_range_elevation_and_quantisation(sensor: str) -> None:
    plots = detections(scattered().plots(sensor))
    elevation = np.radians(plots.true_elevation_deg)
    true = aer_to_enu(plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m)
    true_height_m = SITE.to_geodetic(true)[2]
    error = plots.altitude_ft * 0.3048 - (true_height_m - UNDULATION_M)
    variance = (np.sin(elevation) * plots.sigma_range_m) ** 2
    cross_m = plots.true_range_m * np.radians(plots.sigma_elevation_deg)
    variance = variance + (np.cos(elevation) * cross_m) ** 2
    total = np.sqrt(variance + ALTITUDE_LSB_M**2 / 12)
    assert_mean((error / total) ** 2, 1.0, "variance")
    assert_mean(error / total, 0.0, "bias")


def test_height_is_that_of_the_measured_place() -> None:
    plots = detections(scattered().plots("coarse"))
    place = aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
    np.testing.assert_allclose(plots.height_m, SITE.to_geodetic(place)[2], rtol=0, atol=1e-6)


def test_time_of_day_is_the_plots_time_to_half_an_lsb_and_starts_again_at_midnight() -> None:
    drones = [held(f"d{i}", 3.3 * i, 8.0, 1000.0 + i) for i in range(100)]
    midnight_ns = START_NS // DAY_NS * DAY_NS
    sensor = RADAR | {"scan": rotating(0.7, 12)}
    plots = fly(scene([sensor], drones, seed=23), 20, midnight_ns - 10 * NS).plots()
    into_day_s = (plots.time_utc_ns % DAY_NS) / NS
    late_s = (plots.time_of_day_s - into_day_s + 43_200) % 86_400 - 43_200
    assert np.abs(late_s).max() <= 0.5 / 128 + 1e-9
    assert_law(late_s * 128 + 0.5, "uniform")
    assert 0 <= plots.time_of_day_s.min() < 1
    assert 86_399 < plots.time_of_day_s.max() < 86_400
