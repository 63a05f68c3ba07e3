"""Range rates that leave as bytes: their errors, the notch's share of Pd, blind speeds, folds."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from support.radar_equations import LIGHT_M_S
from support.significance import Array, assert_law, assert_standard_normal, assert_uncorrelated

from plotfeed.models.frames import aer_to_enu, enu_to_aer
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.utc import NS
from plotfeed.testing import Feed, FeedTable, flown, fly, radar, scene, waypoint

RADAR = radar(elevation_max_deg=30.0, range_floor_m=5.0)
CELL_M_S = LIGHT_M_S / RADAR["frequency_hz"] / (2 * RADAR["integration_s"])
SPEED_M_S = 20.0
SCANS = 60


def passing(name: str, azimuth_deg: float, range_m: float, heading_deg: float) -> dict[str, Any]:
    """A drone on a straight line through that place, at an angle to the line of sight."""
    middle = np.asarray(aer_to_enu(azimuth_deg, 4.0, range_m))
    half = np.asarray(aer_to_enu(azimuth_deg + heading_deg, 0.0, SPEED_M_S * SCANS))
    ends = [enu_to_aer(middle + sign * half) for sign in (-1.0, 1.0)]
    path = [waypoint(*(float(x) for x in end)) for end in ends]
    return flown(name, *path, speed_m_s=SPEED_M_S, repeat=False)


def drones(range_m: float, n: int = 60) -> list[dict[str, Any]]:
    """Of all headings, so of all range rates up to their speed."""
    return [passing(f"d{i}", 360 * i / n, range_m, 180 * i / n * 7) for i in range(n)]


@cache
def road(range_m: float, **doppler: Any) -> Feed:
    return fly(scene([RADAR | {"doppler": doppler}], drones(range_m), seed=61), SCANS)


def detections(plots: FeedTable) -> FeedTable:
    return plots.rows(plots.drone != "")


def rates_of(looks: FeedTable) -> Array:
    """How fast ranges change, by differences from scan to scan; NaN at the ends."""
    found = np.full(len(looks), np.nan)
    for drone in np.unique(looks.drone):
        rows = np.flatnonzero(looks.drone == drone)
        range_m, t_s = looks.range_m[rows], (looks.time_utc_ns[rows] - looks.time_utc_ns[0]) / NS
        found[rows[1:-1]] = (range_m[2:] - range_m[:-2]) / (t_s[2:] - t_s[:-2])
    return found


def test_true_range_rates_are_how_fast_the_range_changes() -> None:
    flight = road(6000.0)
    plots = detections(flight.plots())
    rates = dict(
        zip(
            zip(flight.looks().drone, flight.looks().time_utc_ns, strict=True),
            rates_of(flight.looks()),
            strict=True,
        )
    )
    expected = np.array([rates[key] for key in zip(plots.drone, plots.time_utc_ns, strict=True)])
    inner = ~np.isnan(expected)
    assert inner.sum() > 3000
    # A difference over two seconds of a path that curves by v^2/R.
    assert np.abs(plots.true_range_rate_m_s - expected)[inner].max() < 1e-3
    assert plots.true_range_rate_m_s.min() < -19
    assert plots.true_range_rate_m_s.max() > 19


def test_errors_of_range_rates_are_normal_and_as_stated() -> None:
    plots = detections(road(9000.0).plots())
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
    plots = detections(road(6000.0, prf_hz=1000.0).plots())
    span_m_s = LIGHT_M_S / RADAR["frequency_hz"] * 1000.0 / 2
    assert np.abs(plots.range_rate_m_s).max() <= span_m_s / 2
    folds = (plots.true_range_rate_m_s - plots.range_rate_m_s) / span_m_s
    whole = np.rint(folds)
    assert set(whole) == {-1.0, 0.0, 1.0}
    error = (whole - folds) * span_m_s / plots.sigma_range_rate_m_s
    assert_standard_normal(error, "beside whole folds")


@pytest.mark.parametrize("named", [{"rate_max_m_s": 30.0}, {"prf_hz": 4000.0}])
def test_false_alarms_are_uniform_over_what_is_told_apart(named: dict[str, float]) -> None:
    sensor = RADAR | {"pfa": 1e-3, "doppler": named}
    plots = fly(scene([sensor], seed=62), 3).plots()
    assert len(plots) > 3000
    half_m_s = 30.0 if "rate_max_m_s" in named else LIGHT_M_S / RADAR["frequency_hz"] * 1000.0
    assert_law((plots.range_rate_m_s / half_m_s + 1) / 2, "uniform")
    assert np.isnan(plots.true_range_rate_m_s).all()


def test_category_048_has_the_rate_in_whole_metres_a_second() -> None:
    plots = road(6000.0).plots()
    assert np.abs(plots.doppler_m_s - plots.range_rate_m_s).max() <= 0.5 + 1e-9
    assert (plots.doppler_m_s == np.rint(plots.doppler_m_s)).all()


def test_category_015_has_the_rate_in_centimetres_a_second_and_its_error() -> None:
    sensor = RADAR | {"report": ["asterix-015", "plots"], "doppler": {"floor_m_s": 0.2}}
    flight = fly(scene([sensor], drones(6000.0), seed=63), 10)
    plots = flight.plots()
    records = [r for b in flight.payloads("radar/asterix/015") for r in decode(b)]
    for path, column, half in (
        ("I015/626/DV", plots.range_rate_m_s, 0.005),
        ("I015/626/SDDV", np.hypot(plots.sigma_range_rate_m_s, 0.01 / 12**0.5) + 1 / 128, 1 / 128),
    ):
        told = np.array([record.get(path) for record in records], dtype=float)
        assert np.abs(told - column).max() <= half * (1 + 1e-9)
