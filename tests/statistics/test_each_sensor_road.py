"""One road for each sensor: hits by their odds, errors as stated, alarms of cells, lawful powers.

What the odds, ratios and stated errors are is held beside the oracle (`feeds/lab/test_oracle.py`).
Each test of significance fails for one seed in 10,000 (`significance.FALSE_ALARM_RATE`); the seeds
are those of the scenes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from scipy import integrate, stats
from scipy.special import gammaincc, gammainccinv, ndtr
from support.every_kind import EMITTER, FAR_SENSORS, MICROPHONES, MIMO, PASSIVE, RADAR, RF
from support.every_kind import SENSORS as OF_ERRORS
from support.every_kind import drones as of_errors
from support.radar_equations import (
    BOLTZMANN_J_K,
    detected_power_cdf,
    detected_power_density,
    mean_snr,
    mimo_snrs,
    raw_detections,
    sigma_range_m,
)
from support.significance import (
    Array,
    assert_chance,
    assert_counts,
    assert_law,
    assert_standard_normal,
    assert_sum,
    assert_uncorrelated,
)

from plotfeed.models.frames import aer_to_enu, wrap_180
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, FeedTable, fly, held, radar, rotating, scene, staring

LIGHT_M_S = 299_792_458.0

# Hits: drones in rings, of which some are nearly always detected and some seldom.


FOUR_M = (5.5e3, 8.5e3, 11.5e3, 15e3)
ODDS: dict[str, tuple[dict[str, Any], tuple[float, ...]]] = {
    "staring": (radar(elevation_max_deg=30.0), FOUR_M),
    "rotating": (radar(elevation_max_deg=30.0, scan=rotating(1.0, 4)), FOUR_M),
    "mimo": (MIMO | {"gain_tx_dbi": 11.6, "gain_rx_dbi": 11.6}, (2.5e3, 3.5e3, 4.5e3)),
    "passive": (PASSIVE | {"gain_rx_dbi": 2.0, "range_max_m": 20e3}, (4e3, 6e3, 9e3)),
    "rf": (RF | {"duty_cycle": 0.4, "loss_db": 12.0}, (3e3, 5e3, 7e3)),
    "microphones": (MICROPHONES | {"sensitivity_db": 20.0}, (110.0, 130.0, 150.0)),
    "camera": (FAR_SENSORS["camera"] | {"scan": staring()}, (5e3, 6e3, 7e3)),
}
AT_EACH, SCANS = 20, 120


@cache
def rings(kind: str) -> Feed:
    sensor, ranges_m = ODDS[kind]
    flown = [
        held(f"{ring}-{i:02}", 18 * i + ring + 1, 4.0, range_m, emitters=[EMITTER], size_m=0.3,
             rcs_m2=0.01, sound_power_db=80.0)
        for ring, range_m in enumerate(ranges_m) for i in range(AT_EACH)
    ]  # fmt: skip
    return fly(scene([sensor], flown, seed=11), float(SCANS))


@pytest.mark.parametrize("kind", ODDS)
def test_hits_are_as_many_as_their_odds_and_know_nothing_of_each_other(kind: str) -> None:
    """Ring by ring, drone by drone, scan by scan; nor of the scan before, or of the next drone."""
    looks = rings(kind).looks()
    looks = looks.rows(np.lexsort((looks.time_utc_ns, looks.drone)))
    drones = len(ODDS[kind][1]) * AT_EACH
    hit, pd = (column.reshape(drones, -1) for column in (looks.detected, looks.pd))
    assert hit.shape[1] >= SCANS - 2  # sound is on its way for a while
    excess, variance = hit - pd, pd * (1 - pd)
    assert variance.sum() > 300
    for ring in range(len(ODDS[kind][1])):
        mine = slice(ring * AT_EACH, (ring + 1) * AT_EACH)
        if variance[mine].sum() > 10:
            assert_sum(float(excess[mine].sum()), 0.0, float(variance[mine].sum()), f"ring {ring}")
    for axis, of in ((1, "drone by drone"), (0, "scan by scan")):
        spread = variance.sum(axis=axis)
        square = float((excess.sum(axis=axis)[spread > 5] ** 2 / spread[spread > 5]).sum())
        law = stats.chi2((spread > 5).sum())
        assert_chance(2 * min(float(law.cdf(square)), float(law.sf(square))), of)
    assert_uncorrelated(excess[:, 1:].ravel(), excess[:, :-1].ravel(), "the scan before")
    assert_uncorrelated(excess[1:].ravel(), excess[:-1].ravel(), "the next drone")


@pytest.mark.parametrize("kind", ODDS)
def test_one_hit_is_one_plot_and_bears_the_time_of_its_look(kind: str) -> None:
    looks, plots = rings(kind).looks(), rings(kind).plots()
    plots, hits = plots.rows(plots.drone != ""), looks.rows(looks.detected)
    pairs = [sorted(zip(table.drone, table.time_utc_ns, strict=True)) for table in (plots, hits)]
    assert pairs[0] == pairs[1]


# Errors: as stated, and so many times as large where a sensor is degraded.


MEASURED = ("range_m", "azimuth_deg", "elevation_deg")


@cache
def measured(kind: str, **degradation: float) -> Feed:
    named = {"degradation": degradation} if degradation else {}
    return fly(scene([OF_ERRORS[kind] | named], of_errors(kind), seed=71), 30)


def errors(plots: FeedTable, kind: str) -> dict[str, Array]:
    """Errors over the standard deviations that plots state, of what the kind measures at once."""
    place = aer_to_enu(plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m)
    true = {name: getattr(plots, f"true_{name}") for name in MEASURED}
    if kind == "passive":
        tower = aer_to_enu(300.0, 0.2, 20_000.0)
        ways_m = np.linalg.norm(place, axis=1) + np.linalg.norm(place - tower, axis=1)
        true = {"bistatic_range_m": ways_m - 20_000.0, "azimuth_deg": true["azimuth_deg"]}
    found = {}
    for name, value in true.items():
        sigma = getattr(plots, f"sigma_{name}")
        error = getattr(plots, name) - value
        if name.endswith("_deg"):
            error = wrap_180(error)
        if not np.isnan(sigma).any() and not (kind == "microphones" and name == "range_m"):
            found[name] = error / sigma
    return found


@pytest.mark.parametrize("kind", OF_ERRORS)
def test_errors_are_normal_as_stated_and_new_each_time(kind: str) -> None:
    """Of a sensor whose errors are three times those stated, and else is as it was."""
    plain, worse = (measured(kind, **more) for more in ({}, {"error_factor": 3.0}))
    tables = [flight.plots() for flight in (plain, worse)]
    before, after = (table.rows(table.drone != "") for table in tables)
    found, right = errors(after, kind), errors(before, kind)
    assert found
    order = np.lexsort((after.time_utc_ns, after.drone))
    for name, error in found.items():
        assert_standard_normal(error / 3.0, name)
        assert_uncorrelated(error[order][1:], error[order][:-1], f"{name}, scan by scan")
        if kind not in ("gate", "passive"):  # theirs depend on the noise of the others
            np.testing.assert_allclose(error, 3 * right[name], atol=1e-6, rtol=1e-6)
    for (a, one), (b, other) in combinations(found.items(), 2):
        assert_uncorrelated(one, other, f"{a} and {b}")
    for name in ("snr_db", "sigma_azimuth_deg", "amplitude_dbm"):
        if kind != "gate":
            np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    for name in ("drone", "pd", "snr_db", "detected"):
        np.testing.assert_array_equal(getattr(plain.looks(), name), getattr(worse.looks(), name))


def test_bearings_state_what_follows_from_their_own_signal() -> None:
    """Barton's for microphones; noise of a phase over 2 pi d/lambda for interferometers."""
    plots = measured("microphones").plots()
    expected_deg = 20.0 / (1.6 * np.sqrt(2 * 10 ** (plots.snr_db / 10)))
    np.testing.assert_allclose(plots.sigma_azimuth_deg, np.hypot(expected_deg, 2.0), rtol=1e-9)
    plots = measured("rf").plots()
    snr, samples = 10 ** (plots.snr_db / 10), 1000
    phase_rad = np.sqrt((1 + 1 / (2 * snr)) / (snr * samples))
    noise_deg = np.degrees(phase_rad * LIGHT_M_S / 2.44e9 / (2 * np.pi * 0.2))
    np.testing.assert_allclose(plots.sigma_azimuth_deg, np.hypot(noise_deg, 0.5), rtol=1e-9)


# Alarms: of cells, of which the cover holds no whole number.


@dataclass(frozen=True)
class Alarms:
    sensor: dict[str, Any]
    cells: float
    laws: dict[str, tuple[float, float]]  # Uniform, from where and how far

    @property
    def count(self) -> Any:
        whole = int(np.ceil(self.cells))
        return stats.binom(whole, self.sensor["pfa"] * self.cells / whole)


EXTENT = {
    "range_min_m": 200.0, "range_max_m": 2200.0, "elevation_min_deg": 0.0,
    "elevation_max_deg": 30.0, "range_resolution_m": 200.0, "azimuth_beamwidth_deg": 40.0,
    "elevation_beamwidth_deg": 10.0, "azimuth_min_deg": -100.0, "azimuth_max_deg": 50.0,
}  # fmt: skip
PERIOD_S, SECTORS, TURNS = 0.7, 5, 1000
ACROSS = {"range_m": (200.0, 2000.0), "azimuth_deg": (-100.0, 150.0), "elevation_deg": (0.0, 30.0)}
LEVEL = {"azimuth_min_deg": -60.0, "azimuth_max_deg": 30.0, "azimuth_beamwidth_deg": 20.0}
ALARMS = {
    "staring": Alarms(radar(**EXTENT, pfa=0.05, scan=staring(PERIOD_S)), 112.5, ACROSS),
    "rotating": Alarms(radar(**EXTENT, pfa=0.05, scan=rotating(PERIOD_S, SECTORS)), 112.5, ACROSS),
    "mimo": Alarms(
        MIMO | EXTENT | {"pfa": 0.03, "doppler_cells": 2, "n_reference": 4,
                         "scan": staring(PERIOD_S)}, 225.0, ACROSS,
    ),
    "rf": Alarms(RF | LEVEL | {"pfa": 0.02, "scan": staring(PERIOD_S)}, 450.0,
                 {"azimuth_deg": (-60.0, 90.0)}),
    "microphones": Alarms(
        MICROPHONES | LEVEL | {"pfa": 0.1, "scan": staring(PERIOD_S)}, 4.5 * 4.5,
        {"azimuth_deg": (-60.0, 90.0), "elevation_deg": (0.0, 90.0)},
    ),
}  # fmt: skip


@cache
def alarms(kind: str) -> FeedTable:
    return fly(scene([ALARMS[kind].sensor], seed=51), TURNS * PERIOD_S + 0.1).plots()


def counts(kind: str) -> Array:
    """By scan and sector, for the whole scans."""
    table, first = alarms(kind), -(-START_NS // round(PERIOD_S * NS))
    sectors = SECTORS if kind == "rotating" else 1
    cell = (table.scan - first) * sectors + table.sector
    whole = (cell >= 0) & (cell < (TURNS - 1) * sectors)
    return np.bincount(cell[whole], minlength=(TURNS - 1) * sectors).reshape(-1, sectors)


@pytest.mark.parametrize("kind", ALARMS)
def test_alarms_of_a_scan_are_binomial_over_its_cells(kind: str) -> None:
    law, total = ALARMS[kind].count, counts(kind).sum(axis=1)
    assert_sum(total.sum(), len(total) * law.mean(), len(total) * law.var(), "mean")
    assert_counts(total, law, "law")
    assert (alarms(kind).drone == "").all()
    for lag in (1, 2):
        # By ranks: a thousand scans at least.
        same = np.corrcoef(total[:-lag], total[lag:])[0, 1]
        assert abs(same) < 4 / np.sqrt(len(total)), f"{lag} scans apart"


@pytest.mark.parametrize("kind", ALARMS)
def test_alarms_are_uniform_in_all_that_is_measured(kind: str) -> None:
    table, shares = alarms(kind), {}
    for name, (low, span) in ALARMS[kind].laws.items():
        value = getattr(table, name) - low
        shares[name] = (value % 360 if name == "azimuth_deg" else value) / span
        assert_law(shares[name], "uniform", name)
    shares["signal"] = table.snr_db
    for (a, one), (b, other) in combinations(shares.items(), 2):
        assert_uncorrelated(one, other, f"{a} and {b}")


def test_alarms_of_sectors_are_as_many_as_their_shares_and_independent() -> None:
    """Sectors of 72 degrees against a cover from 260 to 50."""
    table, law = counts("rotating"), ALARMS["rotating"].count
    for each, share in zip(table.T, np.array([50, 0, 0, 28, 72]) / 150, strict=True):
        mean = len(table) * law.mean() * share
        assert_sum(each.sum(), mean, mean + 1e-9)
    for a, b in combinations(table[:, table.any(axis=0)].T, 2):
        assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(len(a))


@pytest.mark.parametrize("kind", ["staring", "rotating"])
def test_alarms_bear_the_time_of_the_beam_or_of_the_scans_end(kind: str) -> None:
    table, period_ns = alarms(kind), round(PERIOD_S * NS)
    if kind == "staring":
        np.testing.assert_array_equal(table.time_utc_ns, (table.scan + 1) * period_ns)
        return
    beam_deg = table.time_utc_ns % period_ns * (360 / period_ns)
    assert np.abs(wrap_180(table.azimuth_deg - beam_deg)).max() <= 360 / period_ns
    assert (table.time_utc_ns // period_ns == table.scan).all()
    assert (np.diff(table.time_utc_ns) >= 0).all()


def test_alarms_of_an_array_and_of_a_finder_are_as_strong_as_noise_that_crosses() -> None:
    """Levels over the sensitivity are exponential in decibels; energies are those of noise."""
    assert_law(alarms("microphones").snr_db - MICROPHONES["sensitivity_db"], "expon", "levels")
    energies = 1000 * (1 + 10 ** (alarms("rf").snr_db / 10))
    assert_law(energies, lambda x: 1 - gammaincc(1000, x) / ALARMS["rf"].sensor["pfa"], "energies")


# Powers of what was detected.


RANGES_M = (2000.0, 11_000.0, 18_000.0)  # Mean ratios from 50 dB to 12 dB, about the threshold
RADARS = {
    "few reference cells": radar(pfa=1e-4, n_reference=4),
    "the paper's": radar(pfa=1e-6, n_reference=16),
}
NAMES = pytest.mark.parametrize("name", RADARS)


@cache
def plots_of(name: str) -> FeedTable:
    flown = [
        held(f"{ring}-{i}", 12 * i + ring, 4.0, range_m - 1)
        for ring, range_m in enumerate(RANGES_M)
        for i in range(30)
    ]
    return fly(scene([RADARS[name]], flown, seed=41), 80).plots()


@NAMES
def test_powers_of_detections_and_of_alarms_have_the_exact_conditional_law(name: str) -> None:
    """Kolmogorov and Smirnov against the closed form of a fluctuating echo that was detected."""
    sensor, plots = RADARS[name], plots_of(name)
    for ring, range_m in enumerate(RANGES_M):
        power = 10 ** (plots.rows(np.char.startswith(plots.drone, f"{ring}-")).snr_db / 10)
        snr = float(mean_snr(sensor, range_m - 1))
        assert_law(power, lambda x, snr=snr: detected_power_cdf(sensor, x, snr), f"{range_m}")
    noise = 10 ** (plots.rows(plots.drone == "").snr_db / 10)
    assert_law(noise, lambda x: detected_power_cdf(sensor, x, 0.0), "alarms")


@NAMES
def test_amplitudes_are_noise_and_signal_and_whole_decibels_in_category_048(name: str) -> None:
    """Noise of the bandwidth of a range cell, half the speed of light over its length."""
    plots = plots_of(name)
    noise_w = BOLTZMANN_J_K * 290 * 10**0.5 * LIGHT_M_S / (2 * radar()["range_resolution_m"])
    noise_dbm = 10 * np.log10(noise_w) + 30
    np.testing.assert_allclose(plots.amplitude_dbm - plots.snr_db, noise_dbm, rtol=0, atol=1e-9)
    expected = np.clip(np.rint(plots.amplitude_dbm), -128, 127)
    np.testing.assert_array_equal(plots.pam_dbm, expected)


def test_powers_of_several_transmitters_are_those_of_the_raw_detector() -> None:
    """Complex Gaussian samples over their thresholds, of ratios that differ; and of noise alone."""
    apart = [{"power_w": p, "east_m": e, "north_m": n, "above_site_m": 5.0}
             for p, e, n in ((2000.0, 0.0, 800.0), (500.0, 700.0, -400.0))]  # fmt: skip
    sensor = ALARMS["mimo"].sensor | {
        "transmitters": apart, "pfa": 1e-3, "range_max_m": 9000.0, "azimuth_max_deg": 260.0,
        "gain_tx_dbi": 11.6, "gain_rx_dbi": 11.6, "loss_db": 1.1, "noise_figure_db": 5.0,
        "scan": staring(0.1),
    }  # fmt: skip
    flown = [held(f"d{i:03}", 40.0, 4.0, 4000.0, rcs_m2=0.02) for i in range(20)]
    plots = fly(scene([sensor], flown, seed=72), 26).plots()
    snrs = mimo_snrs(sensor, aer_to_enu(40.0, 4.0, 4000.0), 0.02)
    rng = np.random.default_rng(72)
    for mine, ratios in ((plots.drone != "", snrs), (plots.drone == "", 0 * snrs)):
        power, _ = raw_detections(ratios, 1e-3, 8, 400_000, rng)
        seen = 10 ** (plots.snr_db[mine] / 10)
        assert len(seen) > 500
        assert_chance(float(stats.ks_2samp(seen, power / len(ratios)).pvalue))


def test_energies_of_emissions_that_were_found_are_of_those_over_the_threshold() -> None:
    flown = [
        held(f"d{i}", 17.0 * i, 5.0, 800.0, emitters=[EMITTER | {"eirp_dbm": -18.0}])
        for i in range(20)
    ]
    road = fly(scene([RF | {"pfa": 1e-6}], flown, seed=73), 120)
    plots, samples = road.plots(), 1000
    snr = 10 ** (road.looks().snr_db[0] / 10)
    threshold = gammainccinv(samples, 1e-6)
    above = float(gammaincc(samples, threshold / (1 + snr)))
    assert 0.05 < above < 0.99
    energies = samples * (1 + 10 ** (plots.snr_db / 10))
    assert_law(energies, lambda x: 1 - gammaincc(samples, x / (1 + snr)) / above, "found")


# Covers: blind and instrumented range, azimuths through north, elevations.


BLIND_M, FAR_M, RCS_M2 = 1000.0, 1100.0, 2e-6
SHORT = radar(range_resolution_m=300.0, range_min_m=BLIND_M, range_max_m=FAR_M, pfa=1e-4)
INSIDE_M = (1000.5, 1010.0, 1040.0, 1097.0)


def test_the_share_lost_at_an_edge_is_what_errors_carry_over_it() -> None:
    """Of those over the threshold; by quadrature over the power of a detection."""
    flown = [
        held(f"{range_m}:{i}", 10 * i + 5, 8.0, range_m, rcs_m2=RCS_M2)
        for range_m in (*INSIDE_M, 999.5, 1100.5, 3000.0) for i in range(10)
    ]  # fmt: skip
    road = fly(scene([SHORT], flown, seed=31), 300)
    looks, plots = road.looks(), road.plots()
    assert {float(name.partition(":")[0]) for name in looks.drone} == set(INSIDE_M)
    assert BLIND_M <= plots.range_m.min() < BLIND_M + 1
    assert FAR_M - 1 < plots.range_m.max() <= FAR_M
    for range_m in INSIDE_M:
        snr = float(mean_snr(SHORT, range_m, RCS_M2))

        def lost(power: float, range_m: float = range_m, snr: float = snr) -> float:
            sigma_m = sigma_range_m(SHORT, power)
            beyond = ndtr((BLIND_M - range_m) / sigma_m) + ndtr((range_m - FAR_M) / sigma_m)
            return float(beyond * detected_power_density(SHORT, power, snr))

        share = integrate.quad(lost, 0.01, 30 * (1 + snr), limit=400)[0]
        mine, told = (np.char.startswith(table.drone, f"{range_m}:") for table in (looks, plots))
        over, reported = int(looks.detected[mine].sum()), int(told.sum())
        assert over > 2000
        variance = max(share * (1 - share), 1e-9) * over
        assert_sum(over - reported, share * over, variance, f"lost {share:.3f}")


def test_a_two_dimensional_radar_reports_neither_elevation_nor_height() -> None:
    sensor = RADAR | {"measures_elevation": False}
    plots = fly(scene([sensor], [held("d", 10.0, 8.0, 700.0)], seed=34), 20).plots()
    for absent in ("elevation_deg", "height_m", "sigma_elevation_deg", "altitude_ft"):
        assert np.isnan(plots.columns[absent]).all()
    assert np.isfinite(plots.range_m).all()
