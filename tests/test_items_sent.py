"""The items of ASTERIX that sessions send are those that docs/topics.md lists, and no others."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from support.random_scenes import random_tree

from plotfeed import testing
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.output_keys import WaysOut
from plotfeed.feeds.scene.scene import Scene, example, from_tree, load
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.proto.asterix.codec.decode import decode

ROOT = Path(__file__).parents[1]
SECONDS = 8.0
RANDOM = 40
# With numbers that a scene has agreed on with its receiver.
CLASSES = {
    "claims": ["drone", "bird"],
    "confusion": {"drone": [0.9, 0.1]},
    "otherwise": [0.5, 0.5],
    "codes": {"drone": 3, "bird": 4},
}


def scenes() -> Iterator[Scene]:
    """Shipped scenes, those of the examples, and random ones in every format that sensors have."""
    yield from map(example, summaries())
    yield from map(load, sorted((ROOT / "examples" / "scenes").glob("*.toml")))
    for seed in range(RANDOM):
        tree = random_tree(seed)
        for sensor in tree["sensor"]:
            sensor.pop("event", None)
            sensor.pop("link", None)
            fixed = "mount" in sensor or not sensor.get("measures_azimuth", True)
            if "type" in sensor and not fixed and sensor["scan"]["kind"] != "electronic":
                formats = SENSORS[sensor["type"]].formats
                found = [name for name in formats if name.startswith("asterix")]
                sensor["report"] = found or ["plots"]
            if sensor.get("type") == "active_radar":
                sensor["classifier"] = CLASSES
        known = ("scene", "telemetry", "sensor", "drone")
        yield from_tree({key: tree[key] for key in known}, Path("scene.toml"))


def listed() -> dict[int, set[str]]:
    """Items of each category in the table of docs/topics.md."""
    table = (ROOT / "docs" / "topics.md").read_text().partition("## ASTERIX\n")[2]
    rows = re.findall(r"^\| (\d{3}) \| (.*) \|$", table.partition("\n## ")[0], re.MULTILINE)
    return {int(category): set(re.findall(r"\b\d{3}\b", items)) for category, items in rows}


def test_what_is_sent_is_what_is_listed() -> None:
    sent: defaultdict[int, set[str]] = defaultdict(set)
    for scene in scenes():
        for message in testing.fly(scene.sent_to(WaysOut()), SECONDS).messages:
            if "/asterix/" in message.topic:
                for record in decode(message.payload):
                    sent[record.category] |= {item.partition("/")[2] for item in record.items}
    found = listed()
    assert {category: sorted(items) for category, items in sent.items()} == {
        category: sorted(items) for category, items in found.items()
    }
