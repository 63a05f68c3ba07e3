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

from plotfeed.feeds.scene.scene import from_tree
from plotfeed.models.frames import wrap_180
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, fly

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


def test_a_passive_radar_says_where_its_transmitter_stands() -> None:
    blocks = road().payloads("passive/asterix/016")
    assert len(blocks) == 2 * int((START_NS + DURATION_S * NS) // (10 * NS) - START_NS // (10 * NS))
    components = [
        r for block in blocks for r in decode(block) if r.get("I016/410/0/TID") is not None
    ]
    assert {r.get("I016/410/0/ALT") for r in components} == {750.0}
