"""A viewer of the page: what waits to be sent to one browser, and what it may ask."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

from plotfeed.feeds.messages.bounded_queue import BoundedQueue, QueueStatistics
from plotfeed.feeds.page.view import Update
from plotfeed.proto.errors import PlotfeedError

MAX_COMMAND_OCTETS = 64 << 10
MAX_WATCHED = 16
SUBJECTS = ("sensor", "clock", "session", "record", "replay")
"""Of a command: exactly one of these keys says what it is for."""


class ViewRequest(NamedTuple):
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


def request_in(text: str) -> ViewRequest | ControlRequest:
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


def _look_in(look: object) -> ViewRequest:
    watched = look.get("watch", []) if isinstance(look, dict) else None
    if not isinstance(watched, list) or not all(isinstance(name, str) for name in watched):
        raise PlotfeedError("look: expected truth and a list to watch")
    truth = isinstance(look, dict) and look.get("truth") is True
    return ViewRequest(truth, tuple(watched[:MAX_WATCHED]))


MAX_QUEUED = 20
"""Updates; when there are more, all are dropped, and a snapshot makes up for them."""
MAX_QUEUED_OCTETS = 8 << 20


class Viewer:
    """What waits to be sent to one browser, and what it looks at."""

    def __init__(self, snapshot: Callable[[], Update]) -> None:
        self.sees_truth = False
        self.watched: tuple[str, ...] = ()
        self._snapshot = snapshot
        self._needs_all = True
        self._queue = BoundedQueue[bytes](MAX_QUEUED, limit_octets=MAX_QUEUED_OCTETS, octets_of=len)
        self._filled = asyncio.Event()
        self._filled.set()

    def offer(self, update: Update) -> None:
        """The next update, for when there is time to send it."""
        if self._needs_all:
            return
        if not self._queue.put(self._octets_of(update)):
            self.start_again()
        self._filled.set()

    def start_again(self) -> None:
        """Forget what waits; a snapshot is next."""
        self._queue.drop_all()
        self._needs_all = True
        self._filled.set()

    def statistics(self) -> QueueStatistics:
        """What has waited so far; dropped are updates that it was too slow for."""
        return self._queue.statistics()

    def show_truth(self, *, shown: bool) -> None:
        """Show the drones or do not, from a snapshot on."""
        if shown != self.sees_truth:
            self.sees_truth = shown
            self.start_again()

    async def next(self) -> bytes:
        """The next update to send; waits for one."""
        await self._filled.wait()
        if self._needs_all:
            self._needs_all = False
            octets = self._octets_of(self._snapshot())
        else:
            octets = self._queue.take()
        if not self._queue and not self._needs_all:
            self._filled.clear()
        return octets

    def _octets_of(self, update: Update) -> bytes:
        return update.public + update.truth if self.sees_truth else update.public
