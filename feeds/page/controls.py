"""What a viewer may ask of a session, in the words of `{prefix}/control`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Protocol

from plotfeed.proto.errors import PlotfeedError

MAX_COMMAND_OCTETS = 64 << 10
SUBJECTS = ("sensor", "clock", "session", "record", "replay")
"""Of a command: exactly one of these keys says what it is for."""


class Controls(Protocol):
    """Makes changes to a running session."""

    async def apply(self, command: dict[str, Any]) -> Mapping[str, Any]:
        """Do it; `{"ok": true, "in_force": ...}`, or `{"ok": false, "error": "one line"}`."""


class NoControls:
    """A session that cannot be changed: a picture to look at."""

    async def apply(self, _command: dict[str, Any]) -> Mapping[str, Any]:
        """Refuse it."""
        return refused("this session takes no commands")


def refused(why: str) -> dict[str, Any]:
    """The answer to what was not done."""
    return {"ok": False, "error": " ".join(why.split())}


def command_in(text: str) -> tuple[int, dict[str, Any]]:
    """The number and the command of a viewer's message; raises `PlotfeedError`."""
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise PlotfeedError("expected JSON") from None
    if not isinstance(message, dict) or not isinstance(message.get("command"), dict):
        raise PlotfeedError("expected an object with a command")
    number, command = message.get("number"), message["command"]
    if not isinstance(number, int):
        raise PlotfeedError("number: expected a whole number")
    if sum(subject in command for subject in SUBJECTS) != 1:
        raise PlotfeedError(f"expected a command with one of {', '.join(SUBJECTS)}")
    return number, command
