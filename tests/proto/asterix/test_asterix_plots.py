from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.asterix_input import plots

from plotfeed.proto.asterix.cat048 import PlotEncoder048, ServiceEncoder034
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.errors import EncodeError

FIRST = np.array([0])

MIDNIGHT_NS = 1_700_006_400 * 10**9
PLACE = (40.45, -3.73, 650.0)
THREE_D = {"height_m": 700.0, "run_length_deg": 1.4, "amplitude_dbm": -71.6}


def one_plot(encoder: PlotEncoder048 | None = None, **columns: Any) -> Record:
    (block,) = (encoder or PlotEncoder048(25, 3)).blocks(plots(**columns))
    (record,) = decode(block)
    return record


def test_a_plot_of_a_3d_radar_has_all_its_items() -> None:
    record = one_plot(
        t_utc_ns=MIDNIGHT_NS + 1_500_000_000, range_m=18520.0, azimuth_deg=90, **THREE_D
    )
    assert record.items == {
        "I048/010": {"SAC": 25, "SIC": 3},
        "I048/140": 1.5,
        "I048/020": {"TYP": 1, "SIM": 1, "RDP": 0, "SPI": 0, "RAB": 0},
        "I048/040": {"RHO": 10.0, "THETA": 90.0},
        "I048/130": {"PRL": 32 * 360 / 8192, "PAM": -72.0},
        "I048/110": 2300.0,
    }


@pytest.mark.parametrize(
    ("columns", "items"),
    [
        ({}, set()),
        ({"height_m": 1.0}, {"I048/110"}),
        ({"amplitude_dbm": 1.0}, {"I048/130/PAM"}),
        ({"run_length_deg": 1.0}, {"I048/130/PRL"}),
        ({"range_rate_m_s": 1.0}, {"I048/120/CAL"}),
    ],
)
def test_what_is_not_measured_is_not_sent(columns: dict[str, float], items: set[str]) -> None:
    record = one_plot(range_m=1.0, **columns)
    optional = {"I048/110", "I048/120/CAL", "I048/130/PAM", "I048/130/PRL"}
    assert {path for path in optional if record.get(path) is not None} == items


@pytest.mark.parametrize("name", ["height_m", "amplitude_dbm", "run_length_deg", "range_rate_m_s"])
@pytest.mark.parametrize("values", [[1.0, math.nan], [math.nan, 1.0]])
@pytest.mark.parametrize("repeats", [1, 100])
def test_a_column_that_is_measured_now_and_then_is_refused(
    name: str, values: list[float], repeats: int
) -> None:
    with pytest.raises(EncodeError):
        PlotEncoder048(1, 1).blocks(plots(**{name: np.repeat(values, repeats)}))


def test_heights_are_above_the_geoid() -> None:
    heights_m, levels_m = np.array([52.0 + 762.0, 0.0, -100.0]), np.array([52.0, 52.0, -100.0])
    (block,) = PlotEncoder048(1, 1).blocks(plots(height_m=heights_m), levels_m)
    assert [record.get("I048/110") for record in decode(block)] == [2500.0, -175.0, 0.0]
    (block,) = PlotEncoder048(1, 1).blocks(plots(height_m=heights_m), 52.0)
    assert [record.get("I048/110") for record in decode(block)] == [2500.0, -175.0, -500.0]


@pytest.mark.parametrize(
    ("column", "value", "path", "expected"),
    [
        ("range_m", 500_000.0, "I048/040/RHO", 65535 / 256),
        ("range_m", -5.0, "I048/040/RHO", 0.0),
        ("azimuth_deg", 359.999, "I048/040/THETA", 0.0),
        ("amplitude_dbm", -300.0, "I048/130/PAM", -128.0),
        ("amplitude_dbm", 300.0, "I048/130/PAM", 127.0),
        ("run_length_deg", 20.0, "I048/130/PRL", 255 * 360 / 8192),
        ("height_m", 1e6, "I048/110", 8191 * 25.0),
        ("height_m", -1e6, "I048/110", -8192 * 25.0),
        ("range_rate_m_s", -12.4, "I048/120/CAL/CAL", -12.0),
        ("range_rate_m_s", -600.0, "I048/120/CAL/CAL", -512.0),
        ("range_rate_m_s", 600.0, "I048/120/CAL/CAL", 511.0),
        ("t_utc_ns", MIDNIGHT_NS - 3_906_251, "I048/140", 86_399.9921875),
        ("t_utc_ns", MIDNIGHT_NS - 3_906_250, "I048/140", 0.0),
        ("t_utc_ns", MIDNIGHT_NS, "I048/140", 0.0),
    ],
)
def test_edges(column: str, value: float, path: str, expected: float) -> None:
    assert one_plot(**{column: value}).get(path) == expected


def test_what_is_always_measured_must_be_a_number() -> None:
    with pytest.raises(EncodeError, match="I048/040/RHO: nan"):
        one_plot(range_m=math.nan)


def test_no_plots_make_no_blocks() -> None:
    assert PlotEncoder048(1, 1).blocks(plots(range_m=np.empty(0))) == []


def test_blocks_fit_a_datagram_and_keep_the_order() -> None:
    azimuth_deg = np.linspace(0, 359, 500)
    blocks = PlotEncoder048(1, 1, max_octets=300).blocks(plots(azimuth_deg=azimuth_deg, **THREE_D))
    assert max(map(len, blocks)) <= 300
    records = [record for block in blocks for record in decode(block)]
    back = np.array([record.get("I048/040/THETA") for record in records], dtype=float)
    np.testing.assert_allclose(back, azimuth_deg, atol=180 / 65536)


@pytest.mark.parametrize("arguments", [(256, 0), (0, -1)])
def test_a_bad_source_is_refused_at_once(arguments: tuple[int, int]) -> None:
    with pytest.raises(EncodeError, match="I048/010"):
        PlotEncoder048(*arguments)
    with pytest.raises(EncodeError, match="I034/010"):
        ServiceEncoder034(*arguments, antenna_period_s=1, place=PLACE)


@pytest.mark.parametrize("octets", [20, 70_000])
def test_a_bad_block_length_is_refused_at_once(octets: int) -> None:
    with pytest.raises(EncodeError, match="max_octets"):
        PlotEncoder048(1, 1, max_octets=octets)


def test_service_messages() -> None:
    encoder = ServiceEncoder034(25, 3, antenna_period_s=4.0, place=PLACE)
    (marker,) = encoder.north_markers([MIDNIGHT_NS + 10**9], FIRST)
    (crossing,) = encoder.sector_crossings([MIDNIGHT_NS - 1], [348.75], FIRST)
    north, sector = decode(marker + crossing)
    source = {"SAC": 25, "SIC": 3}
    place = {
        "HGT": 650.0,
        "LAT": pytest.approx(40.45, abs=1.1e-5),
        "LON": pytest.approx(-3.73, abs=1.1e-5),
    }
    assert north.items == {
        "I034/010": source,
        "I034/000": 1,
        "I034/030": 1.0,
        "I034/041": 4.0,
        "I034/120": place,
    }
    assert sector.items == {"I034/010": source, "I034/000": 2, "I034/030": 0.0, "I034/020": 348.75}


def test_the_sector_at_north_is_0() -> None:
    encoder = ServiceEncoder034(25, 3, antenna_period_s=4.0, place=PLACE)
    assert decode(encoder.sector_crossings([0], [360.0], FIRST)[0])[0].get("I034/020") == 0.0


@pytest.mark.parametrize(
    "place", [(91.0, 0.0, 0.0), (0.0, 181.0, 0.0), (0.0, 0.0, 4e4), (np.nan,) * 3]
)
def test_an_impossible_place_of_a_radar_is_refused(place: tuple[float, float, float]) -> None:
    with pytest.raises(EncodeError, match="I034/120"):
        ServiceEncoder034(1, 1, antenna_period_s=1.0, place=place)


@pytest.mark.parametrize("period_s", [512.0, -1.0, math.nan])
def test_an_impossible_rotation_period_is_refused(period_s: float) -> None:
    with pytest.raises(EncodeError, match="I034/041"):
        ServiceEncoder034(1, 1, antenna_period_s=period_s, place=PLACE)


# Byte for byte what libasterix sends; vectors/make_vectors.py made and explains them.


VECTORS = json.loads((Path(__file__).parent / "vectors" / "vectors.json").read_text())
SOURCE = VECTORS["sac"], VECTORS["sic"]


@pytest.mark.parametrize("vector", VECTORS["plots"], ids=lambda v: v["case"])
@pytest.mark.parametrize("n", [1, 1000])
def test_plots(vector: dict[str, Any], n: int) -> None:
    expected = bytes.fromhex(vector["block"])
    encoder = PlotEncoder048(*SOURCE, max_octets=3 + len(expected[3:]) * 2 - 1 if n > 1 else 1400)
    many = plots(**{name: [value] * n for name, value in vector["plot"].items()})
    assert encoder.blocks(many) == [expected] * n


@pytest.mark.parametrize("vector", VECTORS["services"], ids=lambda v: v["case"])
def test_service_messages_are_those_of_libasterix(vector: dict[str, Any]) -> None:
    encoder = ServiceEncoder034(
        *SOURCE, antenna_period_s=VECTORS["antenna_period_s"], place=VECTORS["place"]
    )
    t_utc_ns, azimuth_deg = vector["t_utc_ns"], vector["azimuth_deg"]
    (block,) = (
        encoder.north_markers([t_utc_ns], FIRST)
        if azimuth_deg is None
        else encoder.sector_crossings([t_utc_ns], [azimuth_deg], FIRST)
    )
    assert block == bytes.fromhex(vector["block"])
