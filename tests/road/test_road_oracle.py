"""asterix-decoder reads some minutes of a whole scene, and it reads what the ledger says."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from support.asterix_readers import items_of, read_blocks, values_of
from support.significance import Array

from plotfeed.proto.utc import NS
from plotfeed.testing import SITE, Feed, flown, fly, radar, rotating, scene, waypoint

UNDULATION_M = 51.0
PERIOD_S = 2.0
PLACE = [
    round(SITE.height_m),
    pytest.approx(SITE.latitude_deg, abs=1.1e-5),
    pytest.approx(SITE.longitude_deg, abs=1.1e-5),
]
SECTORS = 32
TURNS = 90
DAY_NS = 86_400 * NS


@cache
def road() -> Feed:
    """Three minutes of sixty drones, a radar that turns and one that stares."""
    rng = np.random.default_rng(91)
    drones = [
        flown(
            f"d{i}",
            *(
                waypoint(rng.uniform(0, 360), rng.uniform(1, 12), rng.uniform(500, 6000))
                for _ in range(4)
            ),
            speed_m_s=float(rng.uniform(5, 30)),
        )
        for i in range(60)
    ]
    sensors = [
        radar(id="turning", sac=25, sic=3, scan=rotating(PERIOD_S, SECTORS)),
        radar(id="staring", sac=25, sic=4, measures_elevation=False),
    ]
    datum = {"telemetry": {"geoid_undulation_m": UNDULATION_M}}
    return fly(scene(sensors, drones, seed=92, **datum), TURNS * PERIOD_S)


@cache
def theirs(sensor: str, category: int) -> list[dict[str, list[Any]]]:
    """Values by item, record by record, as asterix-decoder reads them."""
    blocks = road().payloads(f"{sensor}/asterix/{category:03}")
    records = [record for block in read_blocks(blocks) for record in block]
    assert {record["category"] for record in records} == {category}
    return [{n: values_of(item) for n, item in items_of(r).items()} for r in records]


def column(records: list[dict[str, list[Any]]], item: str, part: int = 0) -> Array:
    return np.array([record[item][part] for record in records])


def assert_half_an_lsb(read: Array, sent: Array, lsb: float, modulus: float = np.inf) -> None:
    difference = read - sent
    if modulus < np.inf:
        difference = (difference + modulus / 2) % modulus - modulus / 2
    assert np.abs(difference).max() <= lsb / 2 * (1 + 1e-6)


def test_it_reads_every_plot_to_half_an_lsb() -> None:
    for sensor, sic, optional in (("turning", 3, {"I048/110"}), ("staring", 4, set[str]())):
        plots, records = road().plots(sensor), theirs(sensor, 48)
        assert len(records) == len(plots) > 4000
        always = {"I048/010", "I048/020", "I048/040", "I048/130", "I048/140"}
        assert all(set(record) == always | optional for record in records)
        assert all(record["I048/010"] == [25, sic] for record in records)
        assert all(record["I048/020"] == [1, 1, 0, 0, 0] for record in records)
        into_day_s = plots.time_utc_ns % DAY_NS / NS
        assert_half_an_lsb(column(records, "I048/140"), into_day_s, 1 / 128, 86_400)
        assert_half_an_lsb(column(records, "I048/040"), plots.range_m / 1852, 1 / 256)
        theta = column(records, "I048/040", 1)
        assert_half_an_lsb(theta, plots.azimuth_deg, 360 / 65536, 360)
        amplitude = column(records, "I048/130", 1)
        assert_half_an_lsb(amplitude, np.maximum(plots.amplitude_dbm, -128), 1)
        if optional:
            above_sea_ft = (plots.height_m - UNDULATION_M) / 0.3048
            assert_half_an_lsb(column(records, "I048/110"), above_sea_ft, 25)


def test_it_reads_what_we_read() -> None:
    for sensor in ("turning", "staring"):
        plots, records = road().plots(sensor), theirs(sensor, 48)
        for ours, item, part in (
            (plots.time_of_day_s, "I048/140", 0),
            (plots.rho_nm, "I048/040", 0),
            (plots.theta_deg, "I048/040", 1),
            (plots.prl_deg, "I048/130", 0),
            (plots.pam_dbm, "I048/130", 1),
        ):
            np.testing.assert_allclose(column(records, item, part), ours, rtol=1e-6, atol=1e-9)


def test_it_reads_every_north_marker_and_every_sector_crossing() -> None:
    records = theirs("turning", 34)
    assert len(records) == TURNS * (SECTORS + 1)
    ends_ns = (np.arange(TURNS * SECTORS) + 1) * round(PERIOD_S * NS / SECTORS)
    ends_ns += 1_700_000_000 * NS
    expected: list[dict[str, list[Any]]] = []
    for k, end_ns in enumerate(ends_ns.tolist(), start=1):
        time_s = float(np.rint(end_ns % DAY_NS * 128 / NS) / 128)
        source: dict[str, list[Any]] = {"I034/010": [25, 3], "I034/030": [time_s]}
        if k % SECTORS == 0:
            expected.append(source | {"I034/000": [1], "I034/041": [PERIOD_S], "I034/120": PLACE})
        azimuth_deg = k % SECTORS * 360 / SECTORS
        expected.append(source | {"I034/000": [2], "I034/020": [azimuth_deg]})
    assert records == expected


def test_a_staring_radar_sends_no_service_messages() -> None:
    assert road().payloads("staring/asterix/034") == []
