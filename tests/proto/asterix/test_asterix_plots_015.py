from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.asterix_input import plots
from support.asterix_readers import items_of, read_blocks, values_of

from plotfeed.proto.asterix.cat015 import Geometry, PlotEncoder015, Scanning
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.errors import EncodeError

MANY = 100
MONOSTATIC = PlotEncoder015(25, 3)
MULTISTATIC = PlotEncoder015(25, 3, geometry=Geometry.MULTISTATIC)
BEARINGS = PlotEncoder015(25, 3, geometry=Geometry.OTHER)
MEASURED = {
    "sigma_range_m": 1.0,
    "sigma_azimuth_deg": 1.0,
    "elevation_deg": 1.0,
    "sigma_elevation_deg": 1.0,
    "snr": 10.0,
    "amplitude_dbm": -90.0,
    "range_rate_m_s": -12.34,
    "sigma_range_rate_m_s": 0.25,
}


def one_plot(encoder: PlotEncoder015 = MONOSTATIC, **columns: Any) -> Record:
    """One plot there and back, by both paths."""
    (block,) = encoder.blocks(plots(**columns))
    many = encoder.blocks(plots(**{name: [value] * MANY for name, value in columns.items()}))
    (record,) = decode(block)
    if encoder is not MULTISTATIC:  # whose observations are numbered
        assert {other.octets for block in many for other in decode(block)} == {record.octets}
    return record


def test_a_plot_has_all_that_is_measured() -> None:
    encoder = PlotEncoder015(25, 3, scanning=Scanning.FORWARD, classes={"bird": 3})
    (record,) = decode(encoder.blocks(plots(kind="bird", **MEASURED))[0])
    assert record.items == {
        "I015/010": {"SAC": 25, "SIC": 3},
        "I015/000": {"MT": 1, "RG": 0},
        "I015/020": {"MOMU": 0, "TTAX": 3, "SCD": 1},
        "I015/145": 0.0,
        "I015/300": [{"CLS": 3, "PRB": 100}],
        "I015/625": {"R": 1000.0, "SDR": 1.1},
        "I015/626": {"DV": -12.34, "SDDV": 0.265625},
        "I015/627": {"AZ": 0.0, "SDASZ": 1457 * 360 / 2**19},
        "I015/628": {"EL": 364 * 360 / 2**17, "SDEL": 1457 * 360 / 2**19},
        "I015/630": {"RPP": -90.0, "RPS": 10.0},
    }


def test_a_passive_radar_sends_bistatic_ranges_with_pairs_and_numbers() -> None:
    measured = plots(
        bistatic_range_m=[-1.5, 2.5], range_m=9.0, sigma_bistatic_range_m=4.0, channel=[4, 5]
    )
    (block,) = MULTISTATIC.blocks(measured, 2**24 - 1)
    first, second = decode(block)
    assert first.get("I015/625") == {"R": -1.5, "SDR": 4.1}
    assert first.get("I015/400") == {"PID": 4, "ON": 2**24 - 1}
    assert second.get("I015/400") == {"PID": 5, "ON": 0}


def test_microphones_send_no_range() -> None:
    record = one_plot(BEARINGS, azimuth_deg=30.0, range_m=5.0)
    assert record.get("I015/020/MOMU") == 2
    assert record.get("I015/625") is None


def test_unknown_kinds_are_refused() -> None:
    encoder = PlotEncoder015(1, 1, classes={"bird": 3})
    with pytest.raises(EncodeError, match="I015/300/0/CLS: no class for kind 'jet'"):
        encoder.blocks(plots(kind=np.array(["bird", "jet"], np.object_)))
    with pytest.raises(EncodeError, match="I015/300/0/CLS"):
        PlotEncoder015(1, 1, classes={"bird": 512}).blocks(plots(kind="bird"))


@pytest.mark.parametrize("name", MEASURED)
def test_what_is_measured_now_and_then_is_refused(name: str) -> None:
    for rows in ([1.0, math.nan], [math.nan, 1.0]):
        with pytest.raises(EncodeError):
            MONOSTATIC.blocks(plots(**{name: rows}))


@pytest.mark.parametrize("snr", [0.0, -1.0, math.inf])
def test_an_snr_without_a_level_is_refused(snr: float) -> None:
    with pytest.raises(EncodeError, match="I015/630/RPS"):
        MONOSTATIC.blocks(plots(snr=snr))


def test_no_plots_make_no_blocks() -> None:
    assert MONOSTATIC.blocks(plots(range_m=np.empty(0))) == []


def test_bad_settings_are_refused_at_once() -> None:
    with pytest.raises(EncodeError):
        PlotEncoder015(1, 1, max_octets=30)
    with pytest.raises(EncodeError, match="I015/010/SAC"):
        PlotEncoder015(256, 1)


@given(st.floats(-2e6, 2e6))
@example(-838_860.8)
@example(838_860.7)
@example(0.05)
def test_ranges_come_back_to_half_an_lsb_or_saturate(range_m: float) -> None:
    back = one_plot(MULTISTATIC, bistatic_range_m=range_m).get("I015/625/R")
    assert isinstance(back, float)
    assert abs(back - min(max(range_m, -838_860.8), 838_860.7)) <= 0.05 * (1 + 1e-6)


@given(st.floats(-1e5, 1e5))
@example(-83_886.08)
@example(83_886.07)
def test_range_rates_come_back_to_half_an_lsb_or_saturate(rate_m_s: float) -> None:
    back = one_plot(MULTISTATIC, bistatic_range_m=1.0, range_rate_m_s=rate_m_s).get("I015/626/DV")
    assert isinstance(back, float)
    assert abs(back - min(max(rate_m_s, -83_886.08), 83_886.07)) <= 0.005 * (1 + 1e-6)


@given(st.floats(-720, 720))
@example(359.999)
@example(360.0)
def test_azimuths_come_back_round_the_circle(azimuth_deg: float) -> None:
    back = one_plot(azimuth_deg=azimuth_deg).get("I015/627/AZ")
    assert isinstance(back, float)
    assert 0 <= back < 360
    assert abs(math.remainder(back - azimuth_deg, 360)) <= 180 / 65536 + 1e-9


@given(st.floats(-90, 90))
@example(-90.0)
@example(90.0)
def test_elevations_come_back_to_half_an_lsb(elevation_deg: float) -> None:
    record = one_plot(elevation_deg=elevation_deg)
    back = record.get("I015/628/EL")
    assert isinstance(back, float)
    assert abs(back - min(elevation_deg, 32767 * 360 / 2**17)) <= 180 / 2**17


# Column, its LSB, that of its standard deviation, and the bits of the latter.
DEVIATIONS = {
    "I015/625/SDR": ("range_m", 0.1, 0.1, 24),
    "I015/626/SDDV": ("range_rate_m_s", 0.01, 1 / 64, 16),
    "I015/627/SDASZ": ("azimuth_deg", 360 / 2**16, 180 / 2**18, 16),
    "I015/628/SDEL": ("elevation_deg", 180 / 2**16, 180 / 2**18, 16),
}


@pytest.mark.parametrize("path", DEVIATIONS)
@pytest.mark.parametrize("n", [1, 100])
@given(sigma=st.floats(0, 1e9))
@example(sigma=0.0)
@example(sigma=1e-300)
@example(sigma=math.inf)
def test_deviations_hold_the_rounding_of_their_value_and_are_rounded_up(
    path: str, n: int, sigma: float
) -> None:
    """So none is 0, and none less than the error of what was read."""
    name, lsb, own_lsb, bits = DEVIATIONS[path]
    given_plots = plots(**{"range_m": [9.0] * n, name: 9.0, f"sigma_{name}": sigma})
    (block,) = PlotEncoder015(25, 3, max_octets=65_535).blocks(given_plots)
    most = (2**bits - 1) * own_lsb
    exactly = min(math.hypot(sigma, lsb / math.sqrt(12)), most)
    for back in {record.get(path) for record in decode(block)}:
        assert isinstance(back, float)
        assert back > 0
        assert exactly * (1 - 1e-12) <= back <= min(exactly + own_lsb, most) * (1 + 1e-12)


@given(st.integers(0, 2**62))
def test_times_come_back_within_the_day(t_utc_ns: int) -> None:
    back = one_plot(t_utc_ns=t_utc_ns).get("I015/145")
    assert isinstance(back, float)
    assert 0 <= back < 86_400
    turned = math.remainder(back - t_utc_ns % 86_400_000_000_000 / 1e9, 86_400)
    assert abs(turned) <= 0.5 / 128 + 1e-9


def test_asterix_decoder_reads_plots_to_half_an_lsb() -> None:
    n = 300
    rng = np.random.default_rng(5)
    sent = {
        "range_m": rng.uniform(0, 5e5, n),
        "sigma_range_m": rng.uniform(0, 100, n),
        "range_rate_m_s": rng.uniform(-500, 500, n),
        "sigma_range_rate_m_s": rng.uniform(0, 50, n),
        "azimuth_deg": rng.uniform(0, 359.99, n),
        "sigma_azimuth_deg": rng.uniform(0, 40, n),
        "elevation_deg": rng.uniform(0, 80, n),  # it reads those below 0 wrongly
        "sigma_elevation_deg": rng.uniform(0, 40, n),
        "amplitude_dbm": rng.uniform(-150, 0, n),
        "snr": 10 ** rng.uniform(0, 6, n),
    }
    theirs = [r for block in read_blocks(MONOSTATIC.blocks(plots(**sent))) for r in block]
    read = [[v for item in items_of(record).values() for v in values_of(item)] for record in theirs]
    columns = np.array(read, dtype=float).T
    assert columns[:8, 0].tolist() == [25, 3, 1, 0, 0, 3, 3, 0]
    sent["snr"] = 10 * np.log10(sent["snr"])
    halves = (
        0.05,
        0.05,
        0.005,
        1 / 128,
        180 / 2**16,
        180 / 2**19,
        180 / 2**17,
        180 / 2**19,
        0.5,
        0.5,
    )
    for column, (name, value), half in zip(columns[8:], sent.items(), halves, strict=True):
        up = half if name.startswith("sigma") else 0.0  # they are rounded up
        assert np.abs(column - up - value).max() <= 1.03 * half
