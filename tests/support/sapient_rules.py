"""What a SAPIENT message must be: for sapient-pydantic, for the standard's marks, and for us.

sapient-pydantic takes a confidence of 1.4 and an azimuth of 999, an id in lower case, and mandatory
fields that are missing further down; here they are refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

from google.protobuf.descriptor import Descriptor
from google.protobuf.message import Message
from sapient_msg import proto_options_pb2 as options
from sapient_msg.bsi_flex_335_v2_0.detection_report_pb2 import DetectionReport
from sapient_msg.bsi_flex_335_v2_0.registration_pb2 import Registration
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.status_report_pb2 import StatusReport
from sapient_msg.bsi_flex_335_v2_0.task_pb2 import Task
from sapient_msg_pydantic.bsi_flex_335_v2_0.sapient_message import SapientMessage as Model

UUID4 = re.compile("[0-9a-f]{8}-[0-9a-f]{4}-4[0-9a-f]{3}-[89ab][0-9a-f]{3}-[0-9a-f]{12}")
ULID = re.compile("[0-7][0-9A-HJKMNP-TV-Z]{25}")
LIMITS = {
    "azimuth": (0.0, math.nextafter(360, 0)),
    "elevation": (-90.0, 90.0),
    "range": (0.0, 1e9),
    "horizontal_extent": (0.0, 360.0),
    "vertical_extent": (0.0, 180.0),
    "x": (-180.0, 180.0),
    "y": (-90.0, 90.0),
    "confidence": (0.0, 1.0),
    "detection_confidence": (0.0, 1.0),
    "centre_frequency": (1.0, 1e12),
}


def checked(payload: bytes) -> SapientMessage:
    """The message, if nothing whatever is wrong with it."""
    message = SapientMessage.FromString(payload)
    assert Model.from_pb2(message).to_pb2() == message
    faults = list(_faults(message, "SapientMessage"))
    assert not faults, faults
    assert message.timestamp.nanos % 1000 == 0
    assert not message.detection_report.track_info
    return message


def checked_together(messages: Sequence[SapientMessage]) -> None:
    """What one connection brings, in order, as Apex takes it.

    Registered first, by one node; after each Registration a status that is new, before any that is
    unchanged; unchanged only if the system is as in the last that was new; nothing after goodbye.
    """
    system = None
    assert messages[0].HasField("registration")
    assert len({message.node_id for message in messages}) == 1
    for message in messages:
        assert system != StatusReport.SYSTEM_GOODBYE
        if message.HasField("registration"):
            system = None
        if message.HasField("status_report"):
            if message.status_report.info == StatusReport.INFO_NEW:
                system = message.status_report.system
            assert message.status_report.system == system


@cache
def _marks(kind: Descriptor) -> tuple[list[str], dict[str, Any]]:
    """What the standard marks in a kind of message: its mandatory choices, and of each field."""
    oneofs: Any = options.oneof_options
    fields: Any = options.field_options
    return (
        [one.name for one in kind.oneofs if one.GetOptions().Extensions[oneofs].is_mandatory],
        {field.name: field.GetOptions().Extensions[fields] for field in kind.fields},
    )


def _faults(message: Message, path: str) -> Iterator[str]:
    choices, marks = _marks(message.DESCRIPTOR)
    present = {field.name: (field, value) for field, value in message.ListFields()}
    for name in choices:
        if message.WhichOneof(name) is None:
            yield f"{path}: none of {name}"
    for name, of_field in marks.items():
        if name in present:
            field, value = present[name]
            for each in value if field.is_repeated else [value]:
                yield from _value_faults(field, of_field, each, f"{path}.{name}")
        elif of_field.is_mandatory:
            yield f"{path}.{name}: missing"


def _value_faults(field: Any, marks: Any, value: Any, here: str) -> Iterator[str]:
    if isinstance(value, Message):
        if value.DESCRIPTOR.full_name.startswith("sapient_msg."):
            yield from _faults(value, here)
    elif field.enum_type is not None:
        if field.enum_type.values_by_number[value].name.endswith("UNSPECIFIED"):
            yield f"{here}: unspecified"
    elif isinstance(value, float):
        low, high = LIMITS.get(field.name, (-math.inf, math.inf))
        if not (math.isfinite(value) and low <= value <= high):
            yield f"{here}: {value}"
        if field.name.endswith("_error") and value < 0:
            yield f"{here}: {value}"
    elif isinstance(value, str):
        if not value:
            yield f"{here}: empty"
        if marks.is_uuid and not UUID4.fullmatch(value):
            yield f"{here}: {value}"
        if marks.is_ulid and not ULID.fullmatch(value):
            yield f"{here}: {value}"


def assert_declared(registration: Registration, detection: DetectionReport) -> None:
    """Whatever a detection tells of was registered."""
    mode = registration.mode_definition[0]  # the other one is that of a sensor that is off
    (defined,) = mode.detection_definition
    told = {field.name for field, _ in detection.ListFields()}
    always = {"report_id", "object_id", "detection_confidence", "id"}
    assert told <= always | {
        "range_bearing", "location", "object_info", "classification", "signal"
    }  # fmt: skip
    place: Any = detection.range_bearing
    declared: int = defined.location_type.range_bearing_units
    datum: int = defined.location_type.range_bearing_datum
    if "location" in told:
        place = detection.location
        declared, datum = defined.location_type.location_units, defined.location_type.location_datum
    assert declared
    assert (place.coordinate_system, place.datum) == (declared, datum)
    if any(field.name.endswith("_error") for field, _ in place.ListFields()):
        assert defined.HasField("geometric_error")
    reports = {(each.category, each.type) for each in defined.detection_report}
    kind = Registration.DetectionReportCategory
    for info in detection.object_info:
        assert (kind.DETECTION_REPORT_CATEGORY_OBJECT, info.type) in reports
    for signal in detection.signal:
        for field, _ in signal.ListFields():
            name = field.name.replace("_", " ")
            assert (kind.DETECTION_REPORT_CATEGORY_SIGNAL, name) in reports
    classes = {
        each.type: {sub.type: sub.level for sub in each.sub_class}
        for definition in defined.detection_class_definition
        for each in definition.class_definition
    }
    for found in detection.classification:
        assert found.type in classes
        for sub in found.sub_class:
            assert classes[found.type][sub.type] == sub.level


ONE, TWO, THREE = (f"01J0000000000000000000000{n}" for n in "ABC")


def task(
    task_id: str = ONE,
    control: Any = Task.CONTROL_START,
    *,
    to: str = "",
    more: dict[str, Any] | None = None,
    **command: Any,
) -> bytes:
    asked: dict[str, Any] = {"task_id": task_id, "control": control, **(more or {})}
    if command:
        asked["command"] = command
    message = SapientMessage(task=asked)
    if to:
        message.destination_id = to
    return message.SerializeToString()
