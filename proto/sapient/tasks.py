"""Tasks as a node is given them, and what it answers: TaskAck, or Error to what is no task."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from google.protobuf.message import DecodeError as ProtobufDecodeError
from sapient_msg.bsi_flex_335_v2_0.error_pb2 import Error
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.task_ack_pb2 import TaskAck
from sapient_msg.bsi_flex_335_v2_0.task_pb2 import Task

from plotfeed.proto.errors import DecodeError
from plotfeed.proto.sapient.encode_node import DEG_M, ELLIPSOID, LAT_LNG, TRUE_NORTH
from plotfeed.proto.sapient.envelope import envelope

MAX_REASON = 300
ULID = re.compile("[0-7][0-9A-HJKMNP-TV-Z]{25}", re.IGNORECASE)
CONTROLS = {Task.CONTROL_START: "start", Task.CONTROL_STOP: "stop", Task.CONTROL_PAUSE: "pause"}
LIMITS = ("task_end_time", "region")
"""Fields that would make a task hold for a time or a place alone."""

TaskStatus = Literal["ACCEPTED", "REJECTED", "COMPLETED"]


@dataclass(frozen=True, slots=True)
class AskedTask:
    """What a node is asked to do: a command with its value, and when to begin or end."""

    task_id: str
    control: str
    """start, stop, pause, or empty."""
    command: str
    """By the standard's name, such as mode_change; empty for none."""
    value: str
    """Of the command; thresholds are LOW, MEDIUM or HIGH."""
    start_utc_ns: int | None
    destination_id: str
    """The node that it is for; empty for whoever gets it."""
    limits: tuple[str, ...]
    """Which of `LIMITS` it has."""
    look_at: Mapping[str, float] | None = None
    """Of that command: azimuth_deg, elevation_deg and horizontal_fov_deg, as far as given, or
    latitude_deg, longitude_deg and height_m; None where it says so in other units."""


def decode_task(data: bytes) -> AskedTask:
    """The task in a SapientMessage; raises `DecodeError`."""
    try:
        message = SapientMessage.FromString(data)
    except ProtobufDecodeError:
        raise DecodeError(f"{len(data)} octets that are not a SAPIENT message") from None
    if not message.HasField("task"):
        raise DecodeError(f"{message.WhichOneof('content') or 'nothing'} where a task was expected")
    task = message.task
    if not ULID.fullmatch(task.task_id):
        raise DecodeError(f"task_id: expected a ULID, not {task.task_id[:40]!a}")
    command = task.command.WhichOneof("command") or ""
    value = str(getattr(task.command, command)) if command in {"request", "mode_change"} else ""
    if command.endswith(("_threshold", "_rate")):
        value = _threshold(getattr(task.command, command))
    present = {field.name for field, _ in task.ListFields()}
    try:
        start_utc_ns = (
            task.task_start_time.ToNanoseconds() if "task_start_time" in present else None
        )
    except ValueError as error:
        raise DecodeError(f"task_start_time: {error}") from None
    return AskedTask(
        task_id=task.task_id.upper(),
        control=CONTROLS.get(task.control, ""),
        command=command,
        value=value,
        start_utc_ns=start_utc_ns,
        destination_id=message.destination_id,
        limits=tuple(name for name in LIMITS if name in present),
        look_at=_look_at(task.command.look_at) if command == "look_at" else None,
    )


def _look_at(asked: Any) -> Mapping[str, float] | None:
    """Where a task asks to look, in degrees from true north or on the ellipsoid."""
    if asked.HasField("range_bearing"):
        cone = asked.range_bearing
        if (cone.coordinate_system, cone.datum) != (DEG_M, TRUE_NORTH):
            return None
        found = {"azimuth_deg": cone.azimuth} if cone.HasField("azimuth") else {}
        if cone.HasField("elevation"):
            found["elevation_deg"] = cone.elevation
        if cone.HasField("horizontal_extent"):
            found["horizontal_fov_deg"] = cone.horizontal_extent
        return found
    if len(asked.location_list.locations) != 1:
        return None
    (place,) = asked.location_list.locations
    if (place.coordinate_system, place.datum) != (LAT_LNG, ELLIPSOID):
        return None
    return {"latitude_deg": place.y, "longitude_deg": place.x, "height_m": place.z}


def _threshold(number: int) -> str:
    known = Task.DiscreteThreshold.DESCRIPTOR.values_by_number
    return known[number].name.removeprefix("DISCRETE_THRESHOLD_") if number in known else ""


def task_ack(
    node_id: str, t_utc_ns: int, task_id: str, status: TaskStatus, reason: str = ""
) -> bytes:
    """A serialised SapientMessage with a TaskAck; raises `EncodeError`."""
    message = envelope(node_id, t_utc_ns)
    message.task_ack.CopyFrom(
        TaskAck(
            task_id=task_id,
            task_status=f"TASK_STATUS_{status}",
            reason=[reason[:MAX_REASON]] if reason else [],
        )
    )
    return message.SerializeToString()


def error(node_id: str, t_utc_ns: int, packet: bytes, reason: str) -> bytes:
    """A serialised SapientMessage with an Error about what came; raises `EncodeError`."""
    message = envelope(node_id, t_utc_ns)
    message.error.CopyFrom(Error(packet=packet, error_message=[reason[:MAX_REASON]]))
    return message.SerializeToString()
