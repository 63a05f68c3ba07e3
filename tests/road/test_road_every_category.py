"""Every category that a scene of all kinds of sensors sends, read by asterix-decoder as it left.

Category 016 has no second reader, 062 and 063 are read in the tests of tracks.
"""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.asterix_readers import items_of, read_blocks, values_of
from support.every_kind import RF

from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene, from_tree
from plotfeed.models.frames import aer_to_enu, geoid_undulation_m, wrap_180
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, fly, held, radar, rotating, scene

DURATION_S = 349.0
EMITTER = {"frequency_hz": 2.44e9, "bandwidth_hz": 10e6, "eirp_dbm": 20.0, "kind": "control"}
FINDER = RF | {
    "id": "finder", "sic": 5, "frequency_max_hz": 2.48e9, "channel_bandwidth_hz": 10e6,
    "baseline_m": 0.1, "range_max_m": 8000.0,
}  # fmt: skip


@cache
def road() -> Feed:
    """The whole approach of section 4, whose drone is also heard by its radio."""
    tree = tomllib.loads((files("plotfeed.feeds.scene.examples") / "section-4.toml").read_text())
    tree["sensor"].append(FINDER)
    tree["drone"][0]["emitters"] = [EMITTER]
    return fly(from_tree(tree, Path("all.toml")), DURATION_S)


@cache
def theirs(topic: str) -> list[dict[str, list[Any]]]:
    blocks = road().payloads(topic)
    records = [record for block in read_blocks(blocks) for record in block]
    return [{name: values_of(item) for name, item in items_of(r).items()} for r in records]


# The least that one approach gives of each.
TOPICS = {
    "mimo/asterix/015": 200,
    "mimo/asterix/025": 30,
    "passive/asterix/015": 200,
    "microphone/asterix/015": 2,
    "microphone/asterix/025": 30,
    "finder/asterix/205": 300,
    "finder/asterix/025": 30,
}


@pytest.mark.parametrize("topic", TOPICS)
def test_it_reads_as_many_records_and_the_same_items(topic: str) -> None:
    ours = [record for block in road().payloads(topic) for record in decode(block)]
    assert len(ours) >= TOPICS[topic]
    assert [set(record) for record in theirs(topic)] == [set(r.items) for r in ours]


@pytest.mark.parametrize(
    ("topic", "item", "column", "lsb"),
    [
        ("mimo/asterix/015", "I015/627", "azimuth_deg", 360 / (1 << 16)),
        ("passive/asterix/015", "I015/627", "azimuth_deg", 360 / (1 << 16)),
        ("passive/asterix/015", "I015/625", "bistatic_range_m", 0.1),
        ("finder/asterix/205", "I205/070", "azimuth_deg", 0.01),
    ],
)
def test_what_is_read_is_the_protobuf_to_half_a_step(
    topic: str, item: str, column: str, lsb: float
) -> None:
    read = np.array([record[item][0] for record in theirs(topic)])
    sent = getattr(road().plots(topic.partition("/")[0]), column)
    assert np.abs(wrap_180(read - sent)).max() <= lsb / 2 * (1 + 1e-6)


def test_reports_of_205_are_numbered_anew_from_scan_to_scan() -> None:
    """Sixteen numbers a scan, of 256: no report is taken for one of the scan before."""
    numbers = [record.get("I205/040") for record in road().records("finder", 205)]
    assert set((np.diff(numbers) % 256).tolist()) == {16}


def test_a_passive_radar_says_where_its_transmitter_stands() -> None:
    blocks = road().payloads("passive/asterix/016")
    assert len(blocks) == 2 * int((START_NS + DURATION_S * NS) // (10 * NS) - START_NS // (10 * NS))
    components = [
        r for block in blocks for r in decode(block) if r.get("I016/410/0/TID") is not None
    ]
    assert {r.get("I016/410/0/ALT") for r in components} == {750.0}


# Whose height is above mean sea level and whose above the ellipsoid, on every wire.


FOOT_M = 0.3048


def far_off(**more: Any) -> Scene:
    """Drones 100 km off, where sea level is another one than at the radars."""
    drones = [held(f"d{i}", 30.0 * i, 4.0, 100_000.0) for i in range(12)]
    far = {"range_max_m": 200_000.0, "power_w": 1e6, "id": "turning", "scan": rotating(1.0, 8)}
    sensors = [
        radar(sic=1, **far),
        radar(id="staring", sic=2, report=["asterix-015", "plots"], position_enu_m=[9e4, 0, 0]),
    ]
    return scene(sensors, drones, seed=3, **more)


def values(flown: Feed, topic: str, path: str) -> list[float]:
    found = [r.get(path) for p in flown.payloads(topic) for r in decode(p)]
    return [value for value in found if isinstance(value, float)]


@pytest.mark.parametrize("stated_m", [None, 20.0])
def test_heights_of_048_are_above_the_sea_where_the_plot_is(stated_m: float | None) -> None:
    more = {} if stated_m is None else {"telemetry": {"geoid_undulation_m": stated_m}}
    there_is = far_off(**more)
    flown = fly(there_is, 12.0)
    plots = flown.plots("turning")
    here = frame_at(there_is.scene.site, there_is.sensor[0].position_enu_m)
    there = aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
    level_m = geoid_undulation_m(*here.to_geodetic(there)[:2])
    assert np.ptp(level_m) > 4.0
    if stated_m is not None:
        level_m = np.full_like(level_m, stated_m)
    altitude_m = np.array(values(flown, "turning/asterix/048", "I048/110")) * FOOT_M
    assert len(altitude_m) == len(plots) > 50
    told = np.abs(plots.height_m) < 60e3  # beyond which 048 has no numbers
    off_m = np.abs(altitude_m + level_m - plots.height_m)[told]
    assert len(off_m) > 50
    assert off_m.max() < 12.5 * FOOT_M + 1e-6


def test_the_place_of_025_is_above_the_sea_where_the_sensor_is() -> None:
    there_is = far_off()
    flown = fly(there_is, 12.0)
    here = frame_at(there_is.scene.site, there_is.sensor[1].position_enu_m)
    level_m = geoid_undulation_m(here.latitude_deg, here.longitude_deg)
    said = values(flown, "staring/asterix/025", "I025/610")
    assert said
    assert said == pytest.approx([here.height_m - level_m] * len(said), abs=0.126)
