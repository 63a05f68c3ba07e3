"""Errors of what leaves as bytes: quantised, of range rates, systematic and drifting."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from support.every_kind import SENSORS
from support.every_kind import drones as of_kind
from support.radar_equations import LIGHT_M_S
from support.significance import (
    assert_law,
    assert_mean,
    assert_standard_normal,
    assert_uncorrelated,
)

from plotfeed.models.frames import aer_to_enu, enu_to_aer, geodetic_to_ecef, wrap_180
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS
from plotfeed.testing import (
    SITE,
    START_NS,
    Feed,
    FeedTable,
    flown,
    fly,
    held,
    radar,
    rotating,
    scene,
    waypoint,
)

SCANS = 60


def detections(plots: FeedTable) -> FeedTable:
    return plots.rows(plots.drone != "")


# Plots in steps of ASTERIX.


FINE = radar(
    id="fine", pfa=1e-12, range_resolution_m=1.0, azimuth_beamwidth_deg=0.1,
    elevation_beamwidth_deg=0.1,
)  # fmt: skip
COARSE = radar(
    id="coarse", power_w=0.5, pfa=1e-12, sic=2, range_resolution_m=500.0,
    azimuth_beamwidth_deg=4.0, elevation_beamwidth_deg=4.0,
)  # fmt: skip
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
def test_category_048_is_the_protobuf_to_half_an_lsb(sensor: str) -> None:
    plots = detections(scattered().plots(sensor))
    assert len(plots) > 1350
    for difference, lsb in (
        (plots.rho_nm * 1852 - plots.range_m, 1852 / 256),
        (wrap_180(plots.theta_deg - plots.azimuth_deg), 360 / 65536),
        (plots.altitude_ft * 0.3048 + UNDULATION_M - plots.height_m, 25 * 0.3048),
    ):
        assert np.abs(difference).max() <= lsb / 2 * (1 + 1e-9)
        assert_law((difference / lsb + 0.5), "uniform")
    place = aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
    np.testing.assert_allclose(plots.height_m, SITE.to_geodetic(place)[2], rtol=0, atol=1e-6)


def test_category_015_states_errors_with_their_rounding_and_none_as_zero() -> None:
    """By an echo of 90 dB, whose own errors are far below an LSB of 0.1 m and of 0.0055 degrees."""
    places = [(0.234 * i, 5.0 + 0.0142 * i, 400.0 + 1.474 * i) for i in range(1500)]
    drones = [held(f"d{i}", *place, rcs_m2=10.0) for i, place in enumerate(places)]
    sensor = FINE | {"id": "radar", "report": ["asterix-015", "plots"]}
    flight = fly(scene([sensor], drones, seed=25), 1)
    plots, records = detections(flight.plots()), flight.records("radar", 15)
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


def test_time_of_day_is_the_plots_time_to_half_an_lsb_and_starts_again_at_midnight() -> None:
    drones = [held(f"d{i}", 3.3 * i, 8.0, 1000.0 + i) for i in range(100)]
    day_ns = 86_400 * NS
    sensor = radar(elevation_max_deg=30.0, scan=rotating(0.7, 12))
    begins_ns = START_NS // day_ns * day_ns - 10 * NS
    plots = fly(scene([sensor], drones, seed=23), 20, begins_ns).plots()
    into_day_s = (plots.time_utc_ns % day_ns) / NS
    late_s = (plots.time_of_day_s - into_day_s + 43_200) % 86_400 - 43_200
    assert np.abs(late_s).max() <= 0.5 / 128 + 1e-9
    assert_law(late_s * 128 + 0.5, "uniform")
    assert 0 <= plots.time_of_day_s.min() < 1
    assert 86_399 < plots.time_of_day_s.max() < 86_400


# Range rates: their errors, blind speeds and folds.


RADAR = radar(elevation_max_deg=30.0, range_floor_m=5.0)
CELL_M_S = LIGHT_M_S / RADAR["frequency_hz"] / (2 * RADAR["integration_s"])
SPEED_M_S = 20.0


def passing(name: str, azimuth_deg: float, range_m: float, heading_deg: float) -> dict[str, Any]:
    """A drone on a straight line through that place, at an angle to the line of sight."""
    middle = np.asarray(aer_to_enu(azimuth_deg, 4.0, range_m))
    half = np.asarray(aer_to_enu(azimuth_deg + heading_deg, 0.0, SPEED_M_S * SCANS))
    ends = [enu_to_aer(middle + sign * half) for sign in (-1.0, 1.0)]
    path = [waypoint(*(float(x) for x in end)) for end in ends]
    return flown(name, *path, speed_m_s=SPEED_M_S, repeat=False)


def headings(range_m: float, n: int = 60) -> list[dict[str, Any]]:
    """Drones of all headings, so of all range rates up to their speed."""
    return [passing(f"d{i}", 360 * i / n, range_m, 180 * i / n * 7) for i in range(n)]


@cache
def rated(range_m: float, **doppler: Any) -> Feed:
    return fly(scene([RADAR | {"doppler": doppler}], headings(range_m), seed=61), SCANS)


def test_true_range_rates_are_how_fast_the_range_changes() -> None:
    """By differences of looks over two seconds, of a path that curves by v^2/R."""
    looks, plots = rated(6000.0).looks(), detections(rated(6000.0).plots())
    rates, at_ns = dict[tuple[str, int], float](), looks.time_utc_ns
    for drone in np.unique(looks.drone):
        k = np.flatnonzero(looks.drone == drone)
        moved_m = looks.range_m[k[2:]] - looks.range_m[k[:-2]]
        slope = moved_m / ((at_ns[k[2:]] - at_ns[k[:-2]]) / NS)
        rates |= zip([(drone, t) for t in at_ns[k[1:-1]].tolist()], slope, strict=True)
    keys = zip(plots.drone, plots.time_utc_ns.tolist(), strict=True)
    expected = np.array([rates.get(key, np.nan) for key in keys])
    inner = ~np.isnan(expected)
    assert inner.sum() > 3000
    assert np.abs(plots.true_range_rate_m_s - expected)[inner].max() < 1e-3
    assert plots.true_range_rate_m_s.min() < -19
    assert plots.true_range_rate_m_s.max() > 19


def test_errors_of_range_rates_are_normal_and_as_stated() -> None:
    plots = detections(rated(9000.0).plots())
    error = plots.range_rate_m_s - plots.true_range_rate_m_s
    power = 10 ** (plots.snr_db / 10)
    noise = CELL_M_S / (np.pi / np.sqrt(3) * np.sqrt(2 * power))
    stated = np.hypot(noise, CELL_M_S / 20)  # with the floor of a scene that states none
    np.testing.assert_allclose(plots.sigma_range_rate_m_s, stated, rtol=1e-12)
    assert_standard_normal(error / stated)
    range_error = (plots.range_m - plots.true_range_m) / plots.sigma_range_m
    assert_uncorrelated(error / stated, range_error, "with the error of range")


def test_rates_fold_at_half_the_wavelength_times_the_pulse_frequency() -> None:
    """By 1 kHz and 3 cm, 15 m/s: drones of 20 m/s fold."""
    plots = detections(rated(6000.0, prf_hz=1000.0).plots())
    span_m_s = LIGHT_M_S / RADAR["frequency_hz"] * 1000.0 / 2
    assert np.abs(plots.range_rate_m_s).max() <= span_m_s / 2
    folds = (plots.true_range_rate_m_s - plots.range_rate_m_s) / span_m_s
    whole = np.rint(folds)
    assert set(whole) == {-1.0, 0.0, 1.0}
    error = (whole - folds) * span_m_s / plots.sigma_range_rate_m_s
    assert_standard_normal(error, "beside whole folds")


@pytest.mark.parametrize("named", [{"rate_max_m_s": 30.0}, {"prf_hz": 4000.0}])
def test_false_alarms_are_uniform_over_what_is_told_apart(named: dict[str, float]) -> None:
    plots = fly(scene([RADAR | {"pfa": 1e-3, "doppler": named}], seed=62), 3).plots()
    assert len(plots) > 3000
    half_m_s = 30.0 if "rate_max_m_s" in named else LIGHT_M_S / RADAR["frequency_hz"] * 1000.0
    assert_law((plots.range_rate_m_s / half_m_s + 1) / 2, "uniform")
    assert np.isnan(plots.true_range_rate_m_s).all()


def test_categories_have_the_rate_in_steps_of_theirs_and_015_its_error() -> None:
    plots = rated(6000.0).plots()
    assert np.abs(plots.doppler_m_s - plots.range_rate_m_s).max() <= 0.5 + 1e-9
    assert (plots.doppler_m_s == np.rint(plots.doppler_m_s)).all()
    sensor = RADAR | {"report": ["asterix-015", "plots"], "doppler": {"floor_m_s": 0.2}}
    flight = fly(scene([sensor], headings(6000.0), seed=63), 10)
    plots, records = flight.plots(), flight.records("radar", 15)
    for path, column, half in (
        ("I015/626/DV", plots.range_rate_m_s, 0.005),
        ("I015/626/SDDV", np.hypot(plots.sigma_range_rate_m_s, 0.01 / 12**0.5) + 1 / 128, 1 / 128),
    ):
        told = np.array([record.get(path) for record in records], dtype=float)
        assert np.abs(told - column).max() <= half * (1 + 1e-9)


# Systematic errors and drift, in plots and tracks, beside what the ledger says.


BIAS = {
    "range_offset_m": 12.0, "range_scale": 2e-3, "azimuth_offset_deg": 1.5, "tilt_deg": 0.8,
    "tilt_azimuth_deg": 60.0, "time_offset_s": 0.25,
}  # fmt: skip


@cache
def road(kind: str, *, is_biased: bool) -> Feed:
    named = {"bias": BIAS} if is_biased else {}
    return fly(scene([SENSORS[kind] | named], of_kind(kind), seed=81), SCANS)


@pytest.mark.parametrize("kind", SENSORS)
def test_systematic_errors_change_neither_what_is_true_nor_the_odds(kind: str) -> None:
    """The ledger of the same scene without them; a clock that is ahead puts late times on plots."""
    biased, right = (road(kind, is_biased=is_biased) for is_biased in (True, False))
    batches = [pb.PlotBatch.FromString(p) for p in biased.payloads("radar/plots")]
    sent = [plot for batch in batches for plot in batch.plots]
    truths, rightly = (
        [truth for entry in feed.ledgers for truth in entry.plots] for feed in (biased, right)
    )
    late_ns = {p.time_utc_ns - t.time_utc_ns for p, t in zip(sent, truths, strict=True) if t.drone}
    assert late_ns == {250_000_000}

    def places(rows: list[Any]) -> dict[str, tuple[float, float, float]]:
        return {r.drone: (r.azimuth_deg, r.elevation_deg, r.range_m) for r in rows if r.drone}

    def looked_at(feed: Feed) -> list[pb.Look]:
        return [look for entry in feed.ledgers for look in entry.looks]

    for told, expected in ((truths, rightly), map(looked_at, (biased, right))):
        found, true = places(told), places(expected)
        assert len(found.keys() & true.keys()) > 20
        for drone in found.keys() & true.keys():
            assert found[drone] == pytest.approx(true[drone], abs=0.02)
    assert (biased.looks().emitted_utc_ns != 0).all() == (kind == "microphones")
    assert np.mean(biased.looks().pd) == pytest.approx(np.mean(right.looks().pd), abs=2e-3)


@pytest.mark.parametrize(("kind", "sigma_deg"), [("active", 0.5), ("passive", 4.0), ("rf", 20.0)])
def test_drift_is_gauss_markov_and_the_same_for_all_drones_of_a_scan(
    kind: str, sigma_deg: float
) -> None:
    constant_s = 8.0
    drift = {"sigma_azimuth_deg": sigma_deg, "sigma_range_m": 300.0, "time_constant_s": constant_s}
    feed = fly(scene([SENSORS[kind] | {"drift": drift}], of_kind(kind)[:3], seed=820), 1100)
    plots = detections(feed.plots())
    off = wrap_180(plots.azimuth_deg - plots.true_azimuth_deg)
    scans = plots.time_utc_ns // NS
    each = np.bincount(scans - scans.min())
    mean = np.bincount(scans - scans.min(), off) / np.maximum(each, 1)
    noise = off - mean[scans - scans.min()]
    assert np.abs(noise).mean() < 0.2 * sigma_deg
    series = mean[each > 0][1:] / sigma_deg
    kept = np.exp(-1 / constant_s)
    new = (series[1:] - kept * series[:-1]) / np.sqrt(1 - kept**2)
    assert_standard_normal(new, "what is new")
    assert_uncorrelated(new, series[:-1], "with what was")


def test_tracks_are_where_the_sensor_believes_the_drones_to_be() -> None:
    """By axes that stand askew as BIAS says, by spherical trigonometry."""
    sensor = SENSORS["active"] | {"report": ["asterix-062"], "bias": BIAS}
    where = [held("a", 60.0, 0.5, 4000.0, rcs_m2=1.0)]
    records = fly(scene([sensor], where, seed=84), 30).records("radar", 62)
    assert len(records) > 20
    # The drone is where the sensor leans to: the tilt is added to its elevation.
    believed = aer_to_enu(
        60.0 + BIAS["azimuth_offset_deg"],
        0.5 + BIAS["tilt_deg"],
        4000.0 * (1 + BIAS["range_scale"]) + BIAS["range_offset_m"],
    )
    place = np.array([[r.get("I062/105/LAT"), r.get("I062/105/LON")] for r in records])
    seen = SITE.from_ecef(geodetic_to_ecef(*place.T, SITE.height_m))
    assert np.abs(seen[:, :2] - believed[:2]).max() < 2.0
    assert np.linalg.norm(aer_to_enu(60.0, 0.5, 4000.0)[:2] - believed[:2]) > 50.0
