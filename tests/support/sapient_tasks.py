"""Tasks of SAPIENT, as somebody sends them to a node."""

from __future__ import annotations

from typing import Any

from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.task_pb2 import Task

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
