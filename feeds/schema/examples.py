"""Messages to be examples: what a scene sends that is run, at once, when somebody asks."""

from __future__ import annotations

import asyncio
import json
import tomllib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import from_tree
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto.content_types import JSON
from plotfeed.proto.utc import NS

SCENE, START_NS = "everything.toml", 1_767_268_800 * NS
TASK = {
    "task_id": "01J0000000000000000000000A",
    "control": "CONTROL_START",
    "command": {"request": "Registration"},
}
# What such a session does not send.
BY_HAND: dict[str, Any] = {
    "control": {"sensor": "radar", "set": {"link": {"latency_ms": 250.0}}},
    "cue": {"azimuth_deg": 45.0, "elevation_deg": 5.0, "dwell_s": 4.0},
    "score": {
        "time_utc": "2026-01-01T12:00:30Z",
        "tracks_topic": "plotfeed/tracks",
        "cutoff_m": 50.0,
        "dimensions": 2,
        "drones": 2,
        "tracks": 2,
        "reports": 58,
        "unreadable": 0,
        "problem": "",
        "now": {"gospa_m": 8.1, "completeness": 1.0, "position_error_m": 5.7, "latency_s": 0.04},
        "window_s": 30,
        "window": {"gospa_m": 9.3, "completeness": 0.97, "position_error_m": 6.0},
        "feed_false_rate": 0.01,
        "feed": [{"sensor": "radar", "check": "azimuth", "unit": "deg", "found": 2.01, "of": 58}],
    },
}


class _Asking(Observer):
    """Asks a session that begins for what it refuses, and gives a sensor tasks."""

    def __init__(self, tasks: Sequence[bytes]) -> None:
        self._tasks = tasks

    def begun(self, session: RunningSession) -> None:
        """The session stands, and its time begins."""
        prefix, now_ns = session.scene.mqtt.prefix, session.clock.now_ns()
        inputs = [(f"{prefix}/radar/sapient/task", task, None) for task in self._tasks]
        session.intake.receive([(f"{prefix}/telemetry/nobody", b"{}", JSON), *inputs], now_ns)


def payloads() -> Mapping[str, Sequence[bytes]]:
    """Payloads by CloudEvents type, or by the name of the flow for what has none.

    There are none of SAPIENT without its extra.
    """
    heard: dict[str, list[bytes]] = defaultdict(list)
    for name, told in BY_HAND.items():
        heard[name].append(json.dumps(told).encode())
    if has_sapient := find_spec("sapient_msg") is not None:
        from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

        heard["sapientTask"].append(SapientMessage(task=TASK).SerializeToString())
    tree = tomllib.loads(files("plotfeed.feeds.schema").joinpath(SCENE).read_text("utf-8"))
    for sensor in tree["sensor"]:
        formats = SENSORS[sensor["type"]].formats
        sensor["report"] = [name for name in formats if has_sapient or name != "sapient"]
    session = run(
        from_tree(tree, Path(SCENE)),
        clock=InstantClock(START_NS),
        broker="none",
        observers=[_Asking(heard["sapientTask"])],
        tap=lambda message, _: heard[_type_of(message)].append(message.payload),
    )
    with ThreadPoolExecutor(1) as thread:  # whoever asks may have a loop of his own
        thread.submit(asyncio.run, session).result()
    return heard


def _type_of(message: Message) -> str:
    return dict(message.properties)["type"]
