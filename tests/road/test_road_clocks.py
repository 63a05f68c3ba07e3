"""A sensor's clock: what it sends is what it would have sent later, and nothing else is changed."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from support.every_kind import EMITTER, RF

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import from_tree
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.retime_asterix import Retimer
from plotfeed.proto.retime import retime_protobuf
from plotfeed.proto.utc import NS, iso_utc
from plotfeed.testing import START_NS, Feed, fly, held, rotating

CATEGORIES = ("15", "16", "25", "34", "48", "62", "63", "205")
# Whole periods of what is said every ten seconds, which is then said at the same true times.
AHEAD_S = 20
FORMATS = {
    "active": ["asterix-048", "asterix-062", "plots", "sapient"],
    "mimo": ["asterix-015", "plots", "sapient"],
    "passive": ["asterix-015", "plots", "sapient"],
    "microphone": ["asterix-015", "plots", "sapient"],
    "finder": ["asterix-205", "plots", "sapient"],
}
FINDER = RF | {"id": "finder", "frequency_max_hz": 2.48e9, "range_max_m": 20e3, "baseline_m": 0.06}
DRONES = [
    held("far", 45.0, 4.0, 2000.0, rcs_m2=1.0, emitters=[EMITTER]),
    held("near", 40.0, 10.0, 150.0, rcs_m2=0.01, sound_power_db=100.0),
]


@cache
def road(ahead_s: float) -> Feed:
    tree = tomllib.loads((files("plotfeed.feeds.scene.examples") / "section-4.toml").read_text())
    tree["sensor"].append(dict(FINDER))
    tree["drone"] = DRONES
    for sensor in tree["sensor"]:
        sensor["report"] = FORMATS[sensor["id"]]
        if ahead_s:
            sensor["bias"] = {"time_offset_s": ahead_s}
        if sensor["id"] == "active":
            sensor["scan"] = rotating(1.0, 8)
    return fly(from_tree(tree, Path("clocks.toml")), 31.0)


def topics(*ends: str) -> list[str]:
    return [topic for topic in sorted(set(sent(0.0))) if topic.endswith(ends)]


@cache
def sent(ahead_s: float) -> dict[str, list[Message]]:
    """Messages by topic."""
    found: dict[str, list[Message]] = {}
    for message in road(ahead_s).messages:
        found.setdefault(message.topic.removeprefix("plotfeed/"), []).append(message)
    return found


def test_octets_are_those_of_a_right_clock_with_all_times_moved() -> None:
    retimer = Retimer()
    for topic in topics(*CATEGORIES, "/plots"):
        right, ahead = sent(0.0)[topic], sent(AHEAD_S)[topic]
        assert len(right) == len(ahead) > 2
        for one, other in zip(right, ahead, strict=True):
            if topic.endswith("plots"):
                moved = retime_protobuf(one.payload, pb.PlotBatch, AHEAD_S * NS)
            else:
                moved = retimer.retime(one.payload, AHEAD_S * NS).octets
            assert moved == other.payload, topic


def test_sapient_is_stamped_by_that_clock_and_says_the_same() -> None:
    for topic in topics("/sapient"):
        right, ahead = sent(0.0)[topic], sent(AHEAD_S)[topic]
        assert len(right) == len(ahead) > 5
        for one, other in zip(right, ahead, strict=True):
            before, after = (_without_names(m.payload) for m in (one, other))
            before.timestamp.seconds += AHEAD_S
            assert before == after


def _without_names(payload: bytes) -> SapientMessage:
    """A message without those that are made of its time."""
    message = SapientMessage.FromString(payload)
    for part in (message.detection_report, message.status_report):
        part.report_id = ""
    message.detection_report.object_id = ""
    return message


def test_messages_leave_when_they_truly_are_due_and_tell_the_sensors_time() -> None:
    for topic in topics(*CATEGORIES, "/plots", "/sapient"):
        for one, other in zip(sent(0.0)[topic], sent(AHEAD_S)[topic], strict=True):
            assert one.due_utc_ns == other.due_utc_ns
            assert dict(other.properties)["time"] == iso_utc(one.due_utc_ns + AHEAD_S * NS)


def test_the_ledger_keeps_true_time() -> None:
    right, ahead = (road(ahead_s).ledgers for ahead_s in (0.0, AHEAD_S))

    def truth(entry: pb.Ledger) -> pb.Ledger:
        return pb.Ledger(sensor=entry.sensor, scan=entry.scan, looks=entry.looks, plots=entry.plots)

    assert list(map(truth, right)) == list(map(truth, ahead))


@pytest.mark.parametrize("ahead_s", [0.25, -3.0])
def test_what_is_said_every_ten_seconds_is_said_by_the_sensors_own_clock(ahead_s: float) -> None:
    for topic in ("mimo/asterix/025", "active/asterix/063", "passive/asterix/016"):
        for message in sent(ahead_s)[topic]:
            own_ns = message.due_utc_ns + round(ahead_s * NS)
            assert own_ns % (10 * NS) < NS
            assert iso_utc(own_ns) == dict(message.properties)["time"]


def test_a_clock_that_is_set_while_the_sensor_runs_counts_for_its_announcements_too() -> None:
    event: list[dict[str, Any]] = [{"from_s": 8.0, "set": {"bias": {"time_offset_s": 2.0}}}]
    tree = {
        "scene": {"name": "s", "seed": 1, "site": {"latitude_deg": 40.0, "longitude_deg": 0.0,
                                                   "height_m": 0.0}},
        "sapient": {"status_interval_s": 5.0},
        "sensor": [FINDER | {"report": ["sapient"], "event": event}],
    }  # fmt: skip
    statuses = [
        (message.due_utc_ns, SapientMessage.FromString(message.payload).timestamp.ToNanoseconds())
        for message in fly(from_tree(tree, Path("set.toml")), 20.0).messages
        if message.topic.endswith("/sapient")
    ]
    assert len(statuses) > 4
    for due_ns, stamp_ns in statuses:
        assert stamp_ns - due_ns == (2 * NS if due_ns >= START_NS + 8 * NS else 0)
