from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.given_flights import moved_m, speeds

from plotfeed.feeds.telemetry.flights import smoothed
from plotfeed.feeds.telemetry.flights.flight import Flight
from plotfeed.feeds.telemetry.flights.smoothed import (
    DEGREE_DECIMALS,
    METRE_DECIMALS,
    quantum,
    samples_per_step,
)
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.models.state import AltitudeReference

S = 1_000_000_000
M_PER_DEG = 111_229.0  # of latitude at 50 north
SEA = AltitudeReference.MEAN_SEA_LEVEL
Floats = NDArray[np.float64]


def flight(t_s: Floats, north_m: Floats, decimals: int = 12, east_deg: float = 3.0) -> Flight:
    latitudes = np.round(50.0 + north_m / M_PER_DEG, decimals)
    reports = tuple(
        PositionReport(round(t * S), float(latitude), east_deg, 100.0, SEA)
        for t, latitude in zip(t_s, latitudes, strict=True)
    )
    return Flight(name="a", reports=reports)


@pytest.mark.parametrize(("rate_hz", "speed_m_s"), [(1.0, 2.0), (5.0, 6.0), (30.0, 15.0)])
def test_steady_flight_in_eleven_metre_steps_gives_its_speed(
    rate_hz: float, speed_m_s: float
) -> None:
    t_s = np.arange(0, 60, 1 / rate_hz)
    coarse = flight(t_s, t_s * speed_m_s, decimals=4)
    smooth = smoothed(coarse)
    assert moved_m(coarse, smooth) < 15
    inner = speeds(smooth)[len(t_s) // 6 : -len(t_s) // 6]
    assert inner == pytest.approx(speed_m_s, abs=0.25 * speed_m_s + 0.5)
    assert inner.mean() == pytest.approx(speed_m_s, rel=0.05)


def test_a_fine_log_is_left_as_it_is() -> None:
    t_s = np.arange(0, 60, 0.2)
    fine = flight(t_s, 50 * np.sin(t_s / 5), decimals=7)
    smooth = smoothed(fine)
    assert moved_m(fine, smooth) < 0.02
    assert speeds(smooth)[5:-5] == pytest.approx(np.abs(10 * np.cos(t_s / 5))[5:-5], abs=0.3)


def test_a_break_in_the_log_is_not_bridged() -> None:
    t_s = np.concatenate([np.arange(20.0), np.arange(80.0, 100.0)])
    north_m = np.concatenate([np.arange(20.0) * 10, 200 - np.arange(20.0) * 10])
    smooth = smoothed(flight(t_s, north_m, decimals=4))
    north_m_s = [r.velocity_enu_m_s[1] for r in smooth.reports]
    assert north_m_s[15:20] == pytest.approx([10.0] * 5, abs=4)
    assert north_m_s[20:25] == pytest.approx([-10.0] * 5, abs=4)


def test_a_sparse_log_is_one_stretch_and_a_single_report_is_left_as_it_was() -> None:
    t_s = np.arange(0, 300.0, 10.0)
    assert speeds(smoothed(flight(t_s, t_s * 7))) == pytest.approx(7.0, rel=1e-3)
    one = flight(np.zeros(1), np.zeros(1))
    assert smoothed(one) == one


def test_recorded_velocity_is_kept_and_its_gaps_are_filled() -> None:
    t_s = np.arange(30.0)
    whole = flight(t_s, t_s * 5)
    told = tuple(r._replace(velocity_enu_m_s=(1.0, math.nan, math.nan)) for r in whole.reports)
    velocity = smoothed(replace(whole, reports=told)).reports[10].velocity_enu_m_s
    assert velocity == pytest.approx((1.0, 5.0, 0.0), abs=1e-3)


def test_the_antimeridian_is_crossed_without_a_jump() -> None:
    t_s = np.arange(20.0)
    across = flight(t_s, 0 * t_s)
    east = tuple(
        r._replace(longitude_deg=(179.999 + i * 1e-4 + 180) % 360 - 180)
        for i, r in enumerate(across.reports)
    )
    smooth = smoothed(replace(across, reports=east))
    assert speeds(smooth) == pytest.approx(7.17, abs=0.05)
    assert all(-180 <= r.longitude_deg <= 180 for r in smooth.reports)
    assert moved_m(replace(across, reports=east), smooth) < 0.1


@pytest.mark.parametrize(
    ("values", "decimals", "expected"),
    [
        ([36.6146, 36.6147, 36.6172], DEGREE_DECIMALS, 1e-4),
        ([-35.3623714, -35.3623715], DEGREE_DECIMALS, 1e-7),
        ([50 + k / 600_000 for k in (0, 0, 1, 1, 1, 2, 4, 4, 4, 4)], DEGREE_DECIMALS, 1 / 600_000),
        ([math.pi, math.e, math.sqrt(2), 1.1], DEGREE_DECIMALS, 0.0),
        # One that is damaged does not hide the step.
        ([50.00000123, *np.round(50 + np.arange(60) * 1e-4, 4)], DEGREE_DECIMALS, 1e-4),
        ([0.3, 87.9, -0.1], METRE_DECIMALS, 0.1),
        ([5.0, 7.0, 5.0], METRE_DECIMALS, 1.0),
    ],
)
def test_the_step_in_which_values_are_written(
    values: list[float], decimals: range, expected: float
) -> None:
    assert quantum(np.array(values), decimals) == pytest.approx(expected, rel=1e-3)


def test_samples_of_one_value_in_a_row_are_counted() -> None:
    assert samples_per_step(np.repeat(np.arange(9.0), 4)) == 4.0
    assert samples_per_step(np.arange(9.0)) == 1.0
    assert samples_per_step(np.zeros(9)) == 1.0
