"""SAPIENT bytes to plain values, what a node must hear; and what it answers: TaskAck, or Error."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any, Literal

from google.protobuf import json_format
from google.protobuf.message import DecodeError as ProtobufDecodeError
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.task_pb2 import Task

from plotfeed.proto.errors import DecodeError
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.retime import retime_protobuf
from plotfeed.proto.sapient.encode_sapient import (
    AGE,
    BISTATIC_RANGE,
    DEG_M,
    ELLIPSOID,
    LAT_LNG,
    TRUE_NORTH,
)
from plotfeed.proto.sapient.envelope import serialised, set_stamp, stamp_ns
from plotfeed.proto.utc import NS

MAX_REASONS = 3  # That are read of an answer, however many it has


@dataclass(frozen=True, slots=True)
class Heard:
    """What a middleware said to a node: of its registration, that something is wrong, or a task."""

    what: Literal["accepted", "refused", "error", "task", "other"]
    reasons: tuple[str, ...] = ()  # The first of a refusal, or of an error message


def decode(data: bytes) -> dict[str, Any]:
    """A SapientMessage as a JSON mapping with the names of the standard; raises `DecodeError`."""
    message = _parsed(data)
    try:
        return json_format.MessageToDict(message, preserving_proto_field_name=True)
    except (json_format.Error, ValueError, RecursionError, OverflowError) as error:
        # Such as a timestamp of the year 10,000.
        raise DecodeError(f"not a SAPIENT message: {error}") from None


def decode_heard(data: bytes) -> Heard:
    """What a message says to a node that reports; raises `DecodeError`."""
    message = _parsed(data)
    what = message.WhichOneof("content")
    if what == "registration_ack":
        ack = message.registration_ack
        reasons = tuple(islice(ack.ack_response_reason, MAX_REASONS))
        return Heard("accepted" if ack.acceptance else "refused", reasons)
    if what == "error":
        return Heard("error", tuple(islice(message.error.error_message, MAX_REASONS)))
    return Heard("task" if what == "task" else "other")


def plots_in_sapient(data: bytes) -> MeasuredPlots:
    """The detection of a message, if it tells of one; raises `DecodeError`.

    Its time is that of the message, less the age that a plot is told to have.
    """
    message = _parsed(data)
    if not message.HasField("detection_report"):
        return MeasuredPlots.of(())
    report = message.detection_report
    infos = {info.type: info.value for info in report.object_info}
    try:
        age_s, bistatic_m = float(infos.get(AGE, 0)), float(infos.get(BISTATIC_RANGE, "nan"))
        t_utc_ns = message.timestamp.ToNanoseconds() - round(age_s * NS)
    except (ValueError, OverflowError) as error:
        raise DecodeError(f"not a number in object_info: {error}") from None
    told = {"t_utc_ns": t_utc_ns, "bistatic_range_m": bistatic_m}
    place = report.range_bearing
    for name, ours in _PLACES.items():
        if place.HasField(name):
            told[ours] = getattr(place, name)
    return MeasuredPlots.of([told])


# Columns of plots, by what SAPIENT calls them.
_PLACES = {
    "range": "range_m",
    "azimuth": "azimuth_deg",
    "elevation": "elevation_deg",
    "range_error": "sigma_range_m",
    "azimuth_error": "sigma_azimuth_deg",
    "elevation_error": "sigma_elevation_deg",
}


def _parsed(data: bytes) -> SapientMessage:
    try:
        message: SapientMessage = SapientMessage.FromString(data)
    except ProtobufDecodeError:
        raise DecodeError(f"{len(data)} octets that are not a SAPIENT message") from None
    if message.WhichOneof("content") is None:
        raise DecodeError(f"{len(data)} octets that are a SAPIENT message without content")
    return message


def restamped_later(data: bytes, by_ns: int) -> bytes:
    """A serialised SapientMessage as if sent so much later; raises `DecodeError`, `EncodeError`."""
    message = _parsed(data)
    stamp = message.timestamp
    set_stamp(message, stamp.seconds * NS + stamp.nanos + by_ns)
    return message.SerializeToString()


def retime_sapient(data: bytes, shift_ns: int) -> bytes:
    """A serialised SapientMessage later by that; raises `DecodeError`.

    The shift is rounded down to whole microseconds, so that stamps of microseconds stay such and
    none is ahead of the time at which it leaves.
    """
    return retime_protobuf(data, SapientMessage, stamp_ns(shift_ns))


MAX_REASON = 300
ULID = re.compile("[0-7][0-9A-HJKMNP-TV-Z]{25}", re.IGNORECASE)
CONTROLS = {Task.CONTROL_START: "start", Task.CONTROL_STOP: "stop", Task.CONTROL_PAUSE: "pause"}
# Fields that would make a task hold for a time or a place alone.
LIMITS = ("task_end_time", "region")

TaskStatus = Literal["ACCEPTED", "REJECTED", "COMPLETED"]


@dataclass(frozen=True, slots=True)
class AskedTask:
    """What a node is asked to do: a command with its value, and when to begin or end."""

    task_id: str
    control: str  # start, stop, pause, or empty
    command: str  # By the standard's name, such as mode_change; empty for none
    value: str  # Of the command; thresholds are LOW, MEDIUM or HIGH
    start_utc_ns: int | None
    destination_id: str  # The node that it is for; empty for whoever gets it
    limits: tuple[str, ...]  # Which of `LIMITS` it has
    # Of that command: azimuth_deg, elevation_deg and horizontal_fov_deg, as far as given, or
    # latitude_deg, longitude_deg and height_m; None where it says so in other units.
    look_at: Mapping[str, float] | None = None


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
    ack = {
        "task_id": task_id,
        "task_status": f"TASK_STATUS_{status}",
        "reason": [reason[:MAX_REASON]] if reason else [],
    }
    return serialised(node_id, t_utc_ns, task_ack=ack)


def error(node_id: str, t_utc_ns: int, packet: bytes, reason: str) -> bytes:
    """A serialised SapientMessage with an Error about what came; raises `EncodeError`."""
    told = {"packet": packet, "error_message": [reason[:MAX_REASON]]}
    return serialised(node_id, t_utc_ns, error=told)
