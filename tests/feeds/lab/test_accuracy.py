"""What a chart says of the errors of methods is what reference values of 60 digits say of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.chart_cases import MIMO, RADAR, case_of_ratios, case_with, places_at
from support.given_files import reference

from plotfeed.feeds.lab.charted import ChartStage
from plotfeed.feeds.lab.methods import (
    detection_stage,
    errors_stage,
    false_alarms_stage,
    frame_methods,
    frames_stage,
)
from plotfeed.models.frames import enu_to_aer, wrap_180

LATITUDES_DEG = (0.0, 40.4168, 78.2232)
"""Of the sites in the table."""


def errors_of(stage: ChartStage | None) -> dict[str, dict[str, float]]:
    assert stage is not None
    return {m.name: dict(m.errors) for m in stage.methods}


def linear(decibels: object) -> np.ndarray:
    return 10 ** (np.asarray(decibels, dtype=np.float64) / 10)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("latitude_deg", LATITUDES_DEG)
def test_errors_of_frames_are_those_beside_the_reference(latitude_deg: float) -> None:
    table = reference("geodesy_local.csv")
    rows = np.hypot(table["east_m"], table["north_m"]) >= 100
    rows &= table["sensor_lat"] == latitude_deg
    assert rows.sum() >= 4
    here = [float(table[f"sensor_{name}"][rows][0]) for name in ("lat", "lon", "h")]
    there = places_at(*(table[f"target_{name}"][rows] for name in ("lat", "lon", "h")))
    case = case_with(RADAR, there, site=(here[0], here[1], here[2]))
    charted = errors_of(frames_stage(case))
    assert len(charted) == 7
    for name, places in frame_methods(case).items():
        azimuth_deg, elevation_deg, range_m = enu_to_aer(places())
        expected = {
            "range_m": rms(range_m - table["slant_range_m"][rows]),
            "azimuth_deg": rms(wrap_180(azimuth_deg - table["azimuth_deg"][rows])),
            "elevation_deg": rms(elevation_deg - table["elevation_deg"][rows]),
        }
        # What float64 leaves of the differences themselves.
        assert charted[name] == pytest.approx(expected, rel=1e-6, abs=1e-11), name
    assert max(charted["ECEF and rotation"].values()) < 1e-8
    assert charted["flat Earth"]["range_m"] > 1e-3


def test_errors_of_one_look_are_those_beside_the_reference() -> None:
    table = reference("pd_cacfar_sw1.csv")
    rows = (table["pfa"] == 1e-4) & (table["n_ref"] == 10)
    assert rows.sum() > 10
    sensor = RADAR | {"pfa": 1e-4, "n_reference": 10}
    case = case_of_ratios(sensor, linear(table["snr_db"][rows]))
    charted = errors_of(detection_stage(case))
    assert charted["closed form"]["pd"] < 1e-14
    assert charted["as printed, eq 6, 7"]["pd"] < 1e-14
    assert charted["every target"]["pd"] == 0.5  # of looks that all have Pd 0.5, as the case says
    snr = linear(table["snr_db"][rows]).astype(np.float32)
    alpha = np.float32(1e-4 ** (-1 / 10) - 1)
    single = ((1 + snr) / (1 + snr + alpha)).astype(np.float32) ** np.float32(10)
    expected = rms(single - table["pd"][rows])
    assert charted["closed form, float32"]["pd"] == pytest.approx(expected, rel=0.5)
    assert charted["table"]["pd"] < 1e-4


def test_errors_of_printed_sums_are_those_beside_the_reference() -> None:
    cfar, printed = reference("nci_cacfar_pd_sw2.csv"), reference("nci_pd_sw2.csv")
    sums = (cfar["n_integrated"] == 3) & (cfar["n_ref_samples"] == 48) & (cfar["pfa"] == 1e-4)
    column = "pd_as_printed_eq23_half_snr"
    differences, levels_db = [], []
    for level_db, pd in zip(cfar["snr_db"][sums], cfar["pd"][sums], strict=True):
        same = (printed["n_integrated"] == 3) & (printed["pfa"] == 1e-4)
        same &= printed["snr_db"] == level_db
        if same.any():
            differences.append(printed[column][same][0] - pd)
            levels_db.append(level_db)
    assert len(differences) >= 3
    case = case_of_ratios(MIMO | {"pfa": 1e-4, "n_reference": 16}, linear(levels_db))
    charted = errors_of(detection_stage(case))
    # The three transmitters stand together, 5 m beside the receiver.
    assert charted["as printed, eq 18, 23"]["pd"] == pytest.approx(
        rms(np.array(differences)), rel=1e-3
    )
    assert charted["closed form"]["pd"] < 1e-13


@pytest.mark.parametrize("row", range(4))
def test_errors_by_the_mean_ratio_are_those_beside_the_reference(row: int) -> None:
    table = reference("fluctuating_rms_given_detection.csv")
    pfa, snr = float(table["pfa"][row]), float(linear(table["mean_snr_db"][row]))
    ratio = float(table["ratio_to_inv_sqrt_mean_snr"][row])
    # So many reference cells know the noise.
    case = case_of_ratios(RADAR | {"pfa": pfa, "n_reference": 1_000_000}, [snr])
    charted = errors_of(errors_stage(case))
    by_mean_m = 10 / (1.63 * np.sqrt(2 * snr))
    missing_m = by_mean_m * np.sqrt(abs(ratio**2 - 1))
    assert charted["by the mean ratio"]["range_m"] == pytest.approx(missing_m, rel=0.03)
    printed_deg, true_deg = 2 / (2 * np.sqrt(snr)), ratio * 2 / (1.6 * np.sqrt(2 * snr))
    missing_deg = np.sqrt(abs(true_deg**2 - printed_deg**2))
    assert charted["mean ratio, as printed"]["azimuth_deg"] == pytest.approx(missing_deg, rel=0.03)
    assert charted["floor only"]["range_m"] == pytest.approx(ratio * by_mean_m, rel=0.02)
    assert charted["exact draw, given the hit"]["range_m"] == 0


def test_errors_of_numbers_of_false_alarms_are_those_of_the_reference() -> None:
    table = reference("false_alarm_binomial.csv")
    cells, pfa = 180 * 995 * 5, 1e-6
    mean, variance = cells * pfa, cells * pfa * (1 - pfa)
    sensor = RADAR | {
        "pfa": pfa,
        "range_min_m": 50.0,
        "range_max_m": 10_000.0,
        "elevation_min_deg": -2.0,
        "elevation_max_deg": 28.0,
    }
    case = case_of_ratios(sensor, [100.0])
    case = replace(case, own={**case.own, "false_alarms": variance**0.5})
    charted = errors_of(false_alarms_stage(case))
    assert charted["off"]["false_alarms"] == pytest.approx(mean)
    assert charted["Poisson"]["false_alarms"] == pytest.approx((mean - variance) ** 0.5, rel=1e-9)
    assert charted["binomial over cells"]["false_alarms"] == 0
    # The same two moments, where the table has them for other numbers of cells.
    excess = table["mean"] - table["variance"]
    counted = table["cells"] * table["pfa"] ** 2
    np.testing.assert_allclose(excess, counted, rtol=1e-3, atol=1e-15 * table["mean"].max())
