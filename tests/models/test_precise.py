"""The arithmetic that judges all methods, against values that were worked out independently."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support import precise
from support.given_files import reference_rows
from support.precise import number


def linear(decibels: str) -> Any:
    return number(10) ** (number(decibels) / 10)


def relative(found: Any, expected: str) -> float:
    return float(abs(found / number(expected) - 1))


def test_one_look_has_the_digits_of_the_reference() -> None:
    for row in reference_rows("pd_cacfar_sw1.csv"):
        pd = precise.pd_cfar_swerling1(linear(row["snr_db"]), number(row["pfa"]), int(row["n_ref"]))
        assert relative(pd, row["pd"]) < 1e-19


def test_sums_of_looks_have_the_digits_of_the_reference() -> None:
    for row in reference_rows("nci_cacfar_pd_sw2.csv"):
        snrs = [linear(row["snr_db"])] * int(row["n_integrated"])
        pd = precise.pd_sum_cfar(snrs, number(row["pfa"]), int(row["n_ref_samples"]))
        assert relative(pd, row["pd"]) < 1e-19


def test_energies_have_the_digits_of_the_reference() -> None:
    for row in reference_rows("nci_pd_sw2.csv"):
        pd = precise.pd_energy(linear(row["snr_db"]), number(row["pfa"]), int(row["n_integrated"]))
        assert relative(pd, row["pd"]) < 1e-19


def test_places_have_the_digits_of_the_reference() -> None:
    for row in reference_rows("geodesy_local.csv"):
        here, there = (
            [float(row[f"{whose}_{part}"]) for part in ("lat", "lon", "h")]
            for whose in ("sensor", "target")
        )
        enu = precise.enu_m(here, there)
        for value, name in zip(enu, ("east_m", "north_m", "up_m"), strict=True):
            assert abs(value - number(row[name])) < number("1e-14")
        azimuth, elevation, range_m = precise.azimuth_elevation_range(enu)
        assert abs(range_m - number(row["slant_range_m"])) < number("1e-14")
        if np.hypot(float(row["east_m"]), float(row["north_m"])) > 1:
            turned = float(azimuth - number(row["azimuth_deg"]))
            assert min(abs(turned), abs(abs(turned) - 360)) < 1e-16
            assert abs(elevation - number(row["elevation_deg"])) < number("1e-16")


def test_bistatic_ranges_agree_with_the_reference() -> None:
    for row in reference_rows("bistatic.csv"):
        target, transmitter = (
            [number(row[f"{whose}_{axis}"]) for axis in "enu"] for whose in ("t", "tx")
        )
        found = precise.bistatic_range_m((target[0], target[1], target[2]), transmitter)
        expected = float(row["bistatic_range"])
        assert float(found) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_the_logistic_law_has_the_digits_of_the_reference() -> None:
    for row in reference_rows("logistic.csv"):
        pd = precise.pd_logistic(number(row["snr_minus_sens_db"]), number(0), number(1))
        assert relative(pd, row["pd"]) < 1e-19


def test_many_samples_are_no_trouble() -> None:
    weak, strong = 0.01, 10.0
    assert 0 < precise.pd_energy(weak, 1e-6, 10_000) < 1
    assert precise.pd_energy(strong, 1e-6, 10_000_000) == 1
    assert relative(precise.pd_energy(0.0, 1e-6, 10_000), "1e-6") < 1e-12


@pytest.mark.parametrize("azimuth_deg", [0.0, 45.0, 90.0, 179.999, 180.0, 270.0, 359.5])
def test_angles_come_back(azimuth_deg: float) -> None:
    sine, cosine = precise._sin_cos_deg(azimuth_deg)
    azimuth, _, range_m = precise.azimuth_elevation_range((sine, cosine, number(0)))
    assert float(azimuth) == azimuth_deg
    assert abs(range_m - 1) < number("1e-45")
