"""Whatever is wrong in a recording is named: the sensor, and the quantity that is off."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.ledgers import changed, record_session, told
from support.random_scenes import toml_of
from support.road import SITE

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.recorded import Recorded

Keys = dict[str, Any]
Change = Callable[[pb.PlotBatch], None]
SECONDS = 90.0
LINK = {
    "latency_ms": 200.0,
    "jitter_ms": 60.0,
    "duplicate": 0.05,
    "loss": {"kind": "random", "probability": 0.1},
}
RADAR = {
    "type": "active_radar",
    "power_w": 3.0,
    "frequency_hz": 10e9,
    "gain_tx_dbi": 25.0,
    "gain_rx_dbi": 30.0,
    "integration_s": 0.02,
    "pfa": 1e-5,
    "range_resolution_m": 10.0,
    "range_max_m": 6000.0,
    "azimuth_beamwidth_deg": 2.0,
    "elevation_beamwidth_deg": 6.0,
    "elevation_min_deg": -10.0,
    "elevation_max_deg": 60.0,
    "scan": {"kind": "rotating", "period_s": 0.5, "sectors": 4},
}
TREE: Keys = {
    "scene": {
        "name": "faults",
        "seed": 5,
        "site": {
            "latitude_deg": SITE.latitude_deg,
            "longitude_deg": SITE.longitude_deg,
            "height_m": SITE.height_m,
        },
    },
    "telemetry": {"geoid_undulation_m": 51.0},
    "sensor": [
        RADAR
        | {"id": "fine", "sic": 1, "report": ["plots"], "link": LINK, "doppler": {}}
        | {"bias": {"azimuth_offset_deg": 2.0, "range_offset_m": 30.0, "time_offset_s": 0.5}},
        RADAR | {"id": "coarse", "sic": 2, "report": ["asterix-048"]},
        {
            "id": "ears",
            "sic": 3,
            "type": "acoustic",
            "noise_db": 20.0,
            "sensitivity_db": 3.0,
            "microphones": 32,
            "range_max_m": 2500.0,
            "azimuth_beamwidth_deg": 10.0,
            "elevation_beamwidth_deg": 10.0,
            "report": ["plots"],
            "scan": {"kind": "staring", "period_s": 0.5},
        },
    ],
    "drone": [
        {
            "id": f"drone-{n}",
            "rcs_m2": 0.02,
            "sound_power_db": 105.0,
            "speed_m_s": 20.0,
            "repeat": True,
            "path": [
                {"east_m": -1200.0 + 900 * n, "north_m": 900.0 - 300 * n, "above_site_m": 150.0},
                {"east_m": 1300.0, "north_m": 1400.0 - 500 * n, "above_site_m": 250.0},
            ],
        }
        for n in range(3)
    ],
}


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(TREE, tmp_path_factory.mktemp("faults"))


def recorded(tree: Keys, folder: Path) -> Path:
    scene = folder / "scene.toml"
    scene.write_text(toml_of(tree))
    return record_session(scene, folder / "record.mcap", SECONDS)


def found_in(path: Path) -> dict[str, set[str]]:
    """What is named, by sensor."""
    wrong: dict[str, set[str]] = {}
    for verdict in told(path).verdicts.wrong:
        wrong.setdefault(verdict.sensor, set()).add(verdict.quantity)
    return wrong


def test_nothing_is_wrong_where_all_is_right(record: Path) -> None:
    report = told(record)
    assert report.verdicts.wrong == []
    assert report.verdicts.judged > 60
    assert {sensor.joined == sensor.plots > 100 for sensor in report.sensors} == {True}
    assert [sensor.contradicted + sensor.times_off for sensor in report.sensors] == [0, 0, 0]


def each_plot(change: Callable[[pb.Plot], None]) -> Change:
    def of_batch(batch: pb.PlotBatch) -> None:
        for plot in batch.plots:
            change(plot)

    return of_batch


def azimuth_off(plot: pb.Plot) -> None:
    plot.azimuth_deg = (plot.azimuth_deg + 0.3) % 360


def scaled(plot: pb.Plot) -> None:
    plot.range_m *= 1.01


def late(plot: pb.Plot) -> None:
    plot.time_utc_ns += 10**9


def too_sure(plot: pb.Plot) -> None:
    plot.sigma_azimuth_deg /= 2.5


def above_the_sea(plot: pb.Plot) -> None:
    plot.height_m -= 51.0


def approaching(plot: pb.Plot) -> None:
    plot.range_rate_m_s = -plot.range_rate_m_s


def one_short(batch: pb.PlotBatch) -> None:
    del batch.plots[1:]


def one_wild(batch: pb.PlotBatch) -> None:
    if batch.scan % 50 == 0:
        each_plot(lambda plot: setattr(plot, "range_m", plot.range_m + 500.0))(batch)


ON_THE_WIRE: dict[str, tuple[Change, str]] = {
    "azimuth off by 0.3 degrees": (each_plot(azimuth_off), "azimuth"),
    "ranges one per cent too long": (each_plot(scaled), "range"),
    "times a second late": (each_plot(late), "time"),
    "sigma two and a half times too small": (each_plot(too_sure), "azimuth"),
    "heights above the sea for the ellipsoid": (each_plot(above_the_sea), "height"),
    "range rates of the other sign": (each_plot(approaching), "range rate"),
    "plots that are not sent": (one_short, "plots"),
    "a few plots half a kilometre off": (one_wild, "range"),
}


@pytest.mark.parametrize("fault", ON_THE_WIRE)
def test_what_is_wrong_on_the_wire_is_named(fault: str, record: Path, tmp_path: Path) -> None:
    change, quantity = ON_THE_WIRE[fault]

    def on_the_wire(messages: Iterable[Recorded]) -> Iterator[Recorded]:
        for each in messages:
            if each.topic.endswith("fine/plots"):
                batch = pb.PlotBatch.FromString(each.payload)
                change(batch)
                yield replace(each, payload=batch.SerializeToString())
            else:
                yield each

    assert found_in(changed(record, tmp_path / "a.mcap", on_the_wire)) == {"fine": {quantity}}


def seldom(entry: pb.Ledger, rng: np.random.Generator) -> None:
    for look in entry.looks:
        look.detected &= bool(rng.random() < 0.6)


def scans_are_missed(entry: pb.Ledger, _: np.random.Generator) -> None:
    if entry.scan % 20 == 0:
        entry.Clear()


def with_link(**keys: Any) -> Callable[[pb.Ledger, np.random.Generator], None]:
    asked = {key: value for key, value in (LINK | keys).items() if value is not None}

    def says(entry: pb.Ledger, _: np.random.Generator) -> None:
        entry.link = json.dumps(asked)

    return says


IN_THE_LEDGER: dict[str, tuple[Callable[[pb.Ledger, np.random.Generator], None], str]] = {
    "three in five are detected": (seldom, "detection"),
    "scans are missed": (scans_are_missed, "missed scans"),
    "a delay that is too long": (with_link(latency_ms=170.0), "delay"),
    "more loss than asked": (with_link(loss={"kind": "random", "probability": 0.03}), "loss"),
    "duplicates that nobody asked for": (with_link(duplicate=None), "duplicates"),
    "order that is not kept": (with_link(in_order=True), "order"),
}


@pytest.mark.parametrize("fault", IN_THE_LEDGER)
def test_what_is_wrong_in_the_ledger_is_named(fault: str, record: Path, tmp_path: Path) -> None:
    change, quantity = IN_THE_LEDGER[fault]
    rng = np.random.default_rng(3)

    def in_the_ledger(messages: Iterable[Recorded]) -> Iterator[Recorded]:
        for each in messages:
            if each.topic.endswith("/truth"):
                entry = pb.Ledger.FromString(each.payload)
                if entry.sensor == "fine":
                    change(entry, rng)
                if not entry.sensor:
                    continue
                yield replace(each, payload=entry.SerializeToString())
            else:
                yield each

    assert found_in(changed(record, tmp_path / "a.mcap", in_the_ledger)) == {"fine": {quantity}}


IN_THE_SESSION: dict[str, tuple[str, Keys, set[str]]] = {
    "bias of the other sign": (
        "fine",
        {"bias": {"azimuth_offset_deg": -2.0, "range_offset_m": 30.0, "time_offset_s": 0.5}},
        {"azimuth"},
    ),
    "four times the false alarms": ("fine", {"pfa": 4e-5}, {"false alarms"}),
    "errors that are larger than stated": (
        "fine",
        {"degradation": {"error_factor": 2.0}},
        {"range", "azimuth", "elevation", "height", "range rate"},
    ),
    "more clutter": ("fine", {"degradation": {"false_alarm_factor": 4.0}}, {"false alarms"}),
    "another north": ("coarse", {"bias": {"azimuth_offset_deg": 0.3}}, {"azimuth"}),
    "a clock that is ahead": ("coarse", {"bias": {"time_offset_s": 1.0}}, {"time"}),
}


@pytest.mark.parametrize("fault", IN_THE_SESSION)
def test_a_session_that_does_something_else_is_named(
    fault: str, record: Path, tmp_path: Path
) -> None:
    sensor, keys, quantities = IN_THE_SESSION[fault]
    tree = deepcopy(TREE)
    (does,) = (each for each in tree["sensor"] if each["id"] == sensor)
    does.update(keys)
    other = recorded(tree, tmp_path)
    asked = changed(other, tmp_path / "a.mcap", list, scene=record)
    assert found_in(asked) == {sensor: quantities}


def test_mean_sea_level_taken_for_the_ellipsoid_is_named(record: Path, tmp_path: Path) -> None:
    tree = deepcopy(TREE)
    tree["telemetry"] = {"geoid_undulation_m": 0.0}
    asked = changed(recorded(tree, tmp_path), tmp_path / "a.mcap", list, scene=record)
    assert found_in(asked) == {"coarse": {"height"}}
