"""The MIMO radar from the scene to the bytes: detections, errors, signals and false alarms.

Transmitters stand hundreds of metres apart and differ in power, so that the ratios of a look differ
too. Every test fails a right programme for one seed in 10,000.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from scipy import stats
from support import mimo_equations
from support.significance import (
    Array,
    assert_chance,
    assert_counts,
    assert_law,
    assert_sum,
    assert_uncorrelated,
    errors_of,
)

from plotfeed.models.frames import aer_to_enu
from plotfeed.testing import SITE, START_NS, Feed, FeedTable, fly, held, scene, staring

TRANSMITTERS = [
    {"power_w": 2000.0, "east_m": 0.0, "north_m": 800.0, "above_site_m": 15.0},
    {"power_w": 500.0, "east_m": 700.0, "north_m": -400.0, "above_site_m": 5.0},
    {
        "power_w": 2000.0,
        "east_m": -700.0,
        "north_m": -300.0,
        "above_site_m": 0.0,
        "gain_tx_dbi": 15.0,
    },
]
RADAR: dict[str, Any] = {
    "id": "radar",
    "type": "mimo_radar",
    "report": ["plots"],
    "scan": staring(),
    "transmitters": TRANSMITTERS,
    "frequency_hz": 15e9,
    "gain_tx_dbi": 11.6,
    "gain_rx_dbi": 11.6,
    "integration_s": 0.06,
    "loss_db": 1.1,
    "noise_figure_db": 5.0,
    "pfa": 1e-6,
    "n_reference": 10,
    "range_resolution_m": 20.0,
    "range_max_m": 20_000.0,
    "azimuth_beamwidth_deg": 3.0,
    "range_floor_m": 0.0,
    "azimuth_floor_deg": 0.0,
    "elevation_floor_deg": 0.0,
    "elevation_beamwidth_deg": 10.0,
    "elevation_min_deg": -2.0,
    "elevation_max_deg": 30.0,
}
SAMPLES = 30
RANGES_M = (500.0, 1500.0, 2500.0, 3000.0, 3500.0, 4000.0, 4500.0, 5000.0, 5500.0, 6500.0)
AZIMUTHS_DEG = np.arange(20) * 18.0 + 4.0
ELEVATION_DEG = 5.0
SCANS = 250
ALARMS = RADAR | {  # 10 in range, 12 in azimuth, 3 in elevation, 2 in speed: 720
    "pfa": 0.02,
    "n_reference": 4,
    "range_resolution_m": 180.0,
    "range_min_m": 200.0,
    "range_max_m": 2000.0,
    "azimuth_beamwidth_deg": 20.0,
    "azimuth_min_deg": -150.0,
    "azimuth_max_deg": 90.0,
    "elevation_min_deg": 0.0,
    "elevation_max_deg": 30.0,
    "doppler_cells": 2,
}
ALARM_CELLS = 720
ALARM_SCANS = 700


def seen_from_the_site(transmitter: dict[str, float]) -> dict[str, float]:
    """The Earth falls away below the site's horizontal: its height above the site is not its up."""
    flat_enu_m = np.array([transmitter["east_m"], transmitter["north_m"], 0.0])
    rise_m = float(SITE.to_geodetic(flat_enu_m)[2]) - SITE.height_m
    return transmitter | {"above_site_m": transmitter["above_site_m"] - rise_m}


@cache
def snrs() -> Array:
    """By equation 17: ring, drone, transmitter."""
    sensor = RADAR | {"transmitters": [seen_from_the_site(t) for t in TRANSMITTERS]}
    return np.array(
        [
            [
                mimo_equations.signal_snrs(sensor, aer_to_enu(azimuth_deg, ELEVATION_DEG, range_m))
                for azimuth_deg in AZIMUTHS_DEG
            ]
            for range_m in RANGES_M
        ]
    )


@cache
def road() -> Feed:
    """Rings of drones at each of the ranges."""
    drones = [
        held(f"{ring}-{i}", float(azimuth_deg), ELEVATION_DEG, range_m)
        for ring, range_m in enumerate(RANGES_M)
        for i, azimuth_deg in enumerate(AZIMUTHS_DEG)
    ]
    return fly(scene([RADAR], drones, seed=71), float(SCANS))


@cache
def detections() -> tuple[FeedTable, Array, Array]:
    """Plots of drones, with their rings and their numbers."""
    plots = road().plots()
    plots = plots.rows(plots.drone != "")
    ring, number = np.array([name.split("-") for name in plots.drone], dtype=int).T
    return plots, ring, number


def test_signals_of_detections_are_those_of_the_raw_detector() -> None:
    """Against complex Gaussian samples over their thresholds, for drones of several rings."""
    plots, ring, number = detections()
    rng = np.random.default_rng(72)
    for chosen in (1, 3, 5):
        for drone in (0, 7):
            power, _ = mimo_equations.raw_detections(
                snrs()[chosen, drone], RADAR["pfa"], SAMPLES, 60_000, rng
            )
            seen = 10 ** (plots.snr_db[(ring == chosen) & (number == drone)] / 10)
            assert len(seen) > 50
            assert_chance(float(stats.ks_2samp(seen, power / len(TRANSMITTERS)).pvalue))


def test_errors_do_not_depend_on_each_other() -> None:
    plots, *_ = detections()
    columns = {name: error / sigma for name, (error, sigma) in errors_of(plots).items()}
    for a, b in (("range", "azimuth"), ("range", "elevation"), ("azimuth", "elevation")):
        assert_uncorrelated(columns[a], columns[b], f"{a} and {b}")


@cache
def alarms() -> FeedTable:
    return fly(scene([ALARMS], seed=74), ALARM_SCANS + 0.1).plots()


def test_alarms_of_a_scan_are_binomial_over_its_resolution_cells() -> None:
    """However many transmitters there are."""
    first = START_NS // 1_000_000_000
    counts = np.bincount(alarms().scan - first, minlength=ALARM_SCANS)[:ALARM_SCANS]
    n, p = ALARM_CELLS, ALARMS["pfa"]
    assert_sum(float(counts.sum()), len(counts) * n * p, len(counts) * n * p * (1 - p), "mean")
    assert_counts(counts, stats.binom(n, p), "law")


def test_alarms_are_uniform_in_range_azimuth_and_elevation() -> None:
    table = alarms()
    assert_law((table.range_m - 200) / 1800, "uniform", "range")
    assert_law((table.azimuth_deg + 150) % 360 / 240, "uniform", "azimuth")
    assert_law(table.elevation_deg / 30, "uniform", "elevation")


def test_signals_of_alarms_are_those_of_the_raw_detector() -> None:
    rng = np.random.default_rng(75)
    power, _ = mimo_equations.raw_detections(np.zeros(3), ALARMS["pfa"], 12, 500_000, rng)
    seen = 10 ** (alarms().snr_db / 10)
    assert_chance(float(stats.ks_2samp(seen, power / len(TRANSMITTERS)).pvalue))
