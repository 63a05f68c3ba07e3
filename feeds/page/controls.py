"""What a viewer may ask of a session, in the words of `{prefix}/control`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from plotfeed.proto.errors import PlotfeedError

MAX_COMMAND_OCTETS = 64 << 10
MAX_WATCHED = 16
SUBJECTS = ("sensor", "clock", "session", "record", "replay")
"""Of a command: exactly one of these keys says what it is for."""


class Look(NamedTuple):
    """What a viewer looks at."""

    truth: bool
    watched: tuple[str, ...]
    """Sensors whose details it shows."""


class ControlRequest(NamedTuple):
    """What a viewer asks for; the answer has the same number."""

    number: int
    command: dict[str, Any]


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


def wish_in(text: str) -> Look | ControlRequest:
    """What a viewer's message says; raises `PlotfeedError`."""
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise PlotfeedError("expected JSON") from None
    if not isinstance(message, dict):
        raise PlotfeedError("expected an object with look or command")
    if "look" in message:
        return _look_in(message["look"])
    number, command = message.get("number"), message.get("command")
    if not isinstance(number, int) or not isinstance(command, dict):
        raise PlotfeedError("expected an object with a number and a command")
    if sum(subject in command for subject in SUBJECTS) != 1:
        raise PlotfeedError(f"expected a command with one of {', '.join(SUBJECTS)}")
    return ControlRequest(number, command)


def _look_in(look: object) -> Look:
    watched = look.get("watch", []) if isinstance(look, dict) else None
    if not isinstance(watched, list) or not all(isinstance(name, str) for name in watched):
        raise PlotfeedError("look: expected truth and a list to watch")
    truth = isinstance(look, dict) and look.get("truth") is True
    return Look(truth, tuple(watched[:MAX_WATCHED]))
