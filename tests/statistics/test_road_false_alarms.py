"""False alarms that leave as bytes: how many, where, when, and that none knows of another."""

from __future__ import annotations

from functools import cache
from itertools import combinations

import numpy as np
import pytest
from scipy import stats
from support.significance import Array, assert_counts, assert_law, assert_sum, assert_uncorrelated

from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, FeedTable, fly, radar, rotating, scene, staring

TURNS = 1200
SECTORS = 5
FEW_CELLS = {  # 10 in range, 2 in azimuth, 3 in elevation: far from a Poisson law
    "pfa": 0.1,
    "range_resolution_m": 200.0,
    "azimuth_beamwidth_deg": 180.0,
    "elevation_beamwidth_deg": 10.0,
}
MANY_CELLS = {  # 100 x 5 x 12, from 260 degrees over north to 50
    "pfa": 1e-3,
    "range_resolution_m": 20.0,
    "azimuth_beamwidth_deg": 30.0,
    "elevation_beamwidth_deg": 2.5,
    "azimuth_min_deg": -100.0,
    "azimuth_max_deg": 50.0,
}
EXTENT = {
    "range_min_m": 200.0,
    "range_max_m": 2200.0,
    "elevation_min_deg": 0.0,
    "elevation_max_deg": 30.0,
}
PERIOD_S = 0.7
CASES = {
    ("staring", "full"): FEW_CELLS | {"scan": staring(PERIOD_S)},
    ("rotating", "full"): FEW_CELLS | {"scan": rotating(PERIOD_S, SECTORS)},
    ("staring", "across north"): MANY_CELLS | {"scan": staring(PERIOD_S)},
    ("rotating", "across north"): MANY_CELLS | {"scan": rotating(PERIOD_S, SECTORS)},
}
CELLS = {"full": 60, "across north": 6000}
PFA = {"full": 0.1, "across north": 1e-3}
EVERY_CASE = pytest.mark.parametrize(("kind", "cover"), CASES)
COVERS = pytest.mark.parametrize("cover", CELLS)


@cache
def alarms(kind: str, cover: str) -> FeedTable:
    sensor = radar(**(EXTENT | CASES[kind, cover]))
    return fly(scene([sensor], seed=51), TURNS * PERIOD_S + 0.1).plots()


def counts(kind: str, cover: str) -> Array:
    """By turn and sector, for the whole turns."""
    table = alarms(kind, cover)
    first = -(-START_NS // round(PERIOD_S * NS))
    sectors = SECTORS if kind == "rotating" else 1
    whole = (table.scan >= first) & (table.scan < first + TURNS - 1)
    cell = (table.scan[whole] - first) * sectors + table.sector[whole]
    return np.bincount(cell, minlength=(TURNS - 1) * sectors).reshape(-1, sectors)


@EVERY_CASE
def test_alarms_of_a_scan_are_binomial_over_its_resolution_cells(kind: str, cover: str) -> None:
    total, n, p = counts(kind, cover).sum(axis=1), CELLS[cover], PFA[cover]
    assert_sum(total.sum(), len(total) * n * p, len(total) * n * p * (1 - p), "mean")
    assert_counts(total, stats.binom(n, p), "law")


def test_alarms_of_few_cells_are_too_regular_for_a_poisson_law() -> None:
    """Six cells that alarm with one scan in ten each, over ten thousand scans."""
    few = EXTENT | FEW_CELLS | {"range_resolution_m": 2000.0, "scan": staring(0.1)}
    scans = 10_000
    table = fly(scene([radar(**few)], seed=52), scans * 0.1).plots()
    found = np.bincount(table.scan - START_NS // (NS // 10), minlength=scans)
    assert_counts(found, stats.binom(6, 0.1))
    with pytest.raises(AssertionError, match="p ="):
        assert_counts(found, stats.poisson(0.6))


def test_alarms_of_a_sector_are_binomial_over_its_own_cells() -> None:
    for sector in counts("rotating", "full").T:
        assert_counts(sector, stats.binom(CELLS["full"] // SECTORS, PFA["full"]))


def test_alarms_of_a_sector_are_as_many_as_its_share_of_the_cover() -> None:
    """Sectors of 72 degrees against a cover from 260 to 50."""
    shares = np.array([50, 0, 0, 28, 72]) / 150
    for total, share in zip(counts("rotating", "across north").sum(axis=0), shares, strict=True):
        mean = (TURNS - 1) * 6000 * 1e-3 * share
        if share:
            assert_sum(total, mean, mean * (1 - 1e-3))
        else:
            assert total == 0


@EVERY_CASE
def test_alarms_are_uniform_in_range_azimuth_and_elevation(kind: str, cover: str) -> None:
    table = alarms(kind, cover)
    assert len(table) > 6000
    low, span = (-100.0, 150.0) if cover == "across north" else (0.0, 360.0)
    assert_law((table.range_m - 200) / 2000, "uniform", "range")
    assert_law((table.azimuth_deg - low) % 360 / span, "uniform", "azimuth")
    assert_law(table.elevation_deg / 30, "uniform", "elevation")


@EVERY_CASE
def test_coordinates_of_an_alarm_do_not_depend_on_each_other(kind: str, cover: str) -> None:
    table = alarms(kind, cover)
    columns = {
        "range": table.range_m,
        "azimuth": (table.azimuth_deg + 100) % 360,
        "elevation": table.elevation_deg,
        "signal": table.snr_db,
    }
    for (a, x), (b, y) in combinations(columns.items(), 2):
        assert_uncorrelated(x, y, f"{a} and {b}")


@EVERY_CASE
def test_a_scan_does_not_know_of_the_alarms_before(kind: str, cover: str) -> None:
    total = counts(kind, cover).sum(axis=1)
    for lag in (1, 2):
        assert_uncorrelated(total[:-lag], total[lag:], f"{lag} scans apart")


@COVERS
def test_a_sector_does_not_know_of_the_alarms_in_others(cover: str) -> None:
    table = counts("rotating", cover)
    table = table[:, table.any(axis=0)]
    for (i, a), (j, b) in combinations(enumerate(table.T), 2):
        assert_uncorrelated(a, b, f"{i} and {j}")
    in_order_of_time = (table - table.mean(axis=0)).ravel()
    assert_uncorrelated(in_order_of_time[:-1], in_order_of_time[1:], "in the order of time")


@COVERS
def test_alarms_of_a_turning_radar_bear_the_time_of_its_beam(cover: str) -> None:
    table = alarms("rotating", cover)
    period_ns = round(PERIOD_S * NS)
    beam_deg = table.time_utc_ns % period_ns * (360 / period_ns)
    off_deg = (table.azimuth_deg - beam_deg + 180) % 360 - 180
    assert np.abs(off_deg).max() <= 360 / period_ns  # a nanosecond's turn
    assert (table.time_utc_ns // period_ns == table.scan).all()
    assert (np.diff(table.time_utc_ns) >= 0).all()


@COVERS
def test_alarms_of_a_staring_radar_bear_the_time_of_its_scans_end(cover: str) -> None:
    table = alarms("staring", cover)
    period_ns = round(PERIOD_S * NS)
    np.testing.assert_array_equal(table.time_utc_ns, (table.scan + 1) * period_ns)
