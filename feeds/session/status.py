"""What a session says of its sensors, retained for whoever comes later: status and settings."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.telemetry.receiver import to_json
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import JSON
from plotfeed.proto.utc import iso_utc


def status_message(prefix: str, status: pb.SensorStatus, now_utc_ns: int) -> Message:
    """A sensor's status."""
    status.time_utc.FromNanoseconds(now_utc_ns)
    sensor = status.sensor
    return _retained(f"{prefix}/{sensor}", "status", to_json(status), now_utc_ns, sensor=sensor)


def settings_message(
    prefix: str, sensor: Sensor, controlled: Mapping[str, Any], now_utc_ns: int
) -> Message:
    """What a sensor's keys are at the moment, and which of them control has changed."""
    said = {
        "sensor": sensor.id,
        "time_utc": iso_utc(now_utc_ns),
        "controlled": controlled,
        "in_force": sensor.model_dump(mode="json", exclude_unset=True, exclude={"event"}),
    }
    payload, source = json.dumps(said).encode(), f"{prefix}/{sensor.id}"
    return _retained(source, "settings", payload, now_utc_ns, sensor=sensor.id)


def session_message(scene: Scene, start_utc_ns: int) -> Message:
    """Which scene runs, and since when."""
    said = {
        "scene": scene.scene.name,
        "seed": scene.scene.seed,
        "start_utc": iso_utc(start_utc_ns),
        "start_utc_ns": start_utc_ns,
        "sensors": [sensor.id for sensor in scene.sensor],
        "plotfeed": version("plotfeed"),
    }
    return _retained(scene.mqtt.prefix, "session", json.dumps(said).encode(), start_utc_ns)


def _retained(source: str, kind: str, payload: bytes, now_utc_ns: int, **more: str) -> Message:
    return Message(
        topic=f"{source}/{kind}",
        payload=payload,
        content_type=JSON,
        due_utc_ns=now_utc_ns,
        properties=attributes(source, kind, str(now_utc_ns), now_utc_ns, **more),
        retain=True,
        qos=1,
    )
