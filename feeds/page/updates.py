"""What passes between the page and a browser: updates, requests, and what waits to be sent.

An update is one WebSocket message, little-endian. Its header is `PLF1`, flags (uint32), its number
(uint64) and the session's time in milliseconds of UTC (float64). Sections follow to its end. A
section has a header of its kind, its rows, the number of its first row and the octets of its body
(four uint32), and then its columns one after the other, each filled up with zeros to a multiple of
8 octets, so that a browser lays typed arrays over them without copying. A reader skips kinds that
it does not know.
"""

from __future__ import annotations

import asyncio
import json
import struct
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from enum import IntEnum, IntFlag
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.feeds.page.page_access import Audience, Role, name_in
from plotfeed.proto.errors import PlotfeedError

MAGIC = b"PLF1"
HEADER = struct.Struct("<4sIQd")
SECTION = struct.Struct("<4I")
ALIGNMENT = 8
COUNT_MASK = 0xFFFF_FFFF  # Numbers of rows begin again after this


class UpdateFlag(IntFlag):
    """What an update is."""

    SNAPSHOT = 1  # All that there is to see: what came before is forgotten


class SectionKind(IntEnum):
    """What a section holds."""

    NEWS = 1  # JSON in UTF-8: one object whose keys replace those of earlier news
    PLOTS = 2  # Plots as they were delivered
    # Of the plots with the same numbers: whose they are. Only for who asks for the truth.
    PLOT_TRUTHS = 3
    # Plots that no message brought; their latency is NaN. Only for who asks for the truth.
    LOST_PLOTS = 4
    DRONES = 5  # Every drone that there is or lately was. Only for who asks for the truth.
    TRACKS = 6  # News of tracks of the tracker under test
    TRUE_NEWS = 7  # As NEWS. Only for who asks for the truth.


class PlotFlag(IntFlag):
    """What there is to know of a plot beside its numbers."""

    BEARING = 1  # It has no range: east and north are where its ray leaves the sensor's cover
    NOWHERE = 2  # It has no direction either: something was noticed, and that is all


class TrackFlag(IntFlag):
    """The state of a track."""

    TENTATIVE = 1
    COASTED = 2
    ENDED = 4


_PLOT = (
    ("t_utc_ms", "f8"),
    ("east_m", "f4"),
    ("north_m", "f4"),
    ("range_m", "f4"),
    ("azimuth_deg", "f4"),
    ("elevation_deg", "f4"),
    ("height_m", "f4"),
    ("snr_db", "f4"),
    ("latency_ms", "f4"),
    ("sensor", "u2"),
    ("flags", "u1"),
)
_TRUTH = (
    ("true_east_m", "f4"),
    ("true_north_m", "f4"),
    ("true_range_m", "f4"),
    ("true_azimuth_deg", "f4"),
    ("true_elevation_deg", "f4"),
    ("drone", "i4"),
    ("merged", "u1"),
)
# Columns and their types, as NumPy writes them. East and north are from the site, along its own
# horizontal. NaN is for what is not known; `gone_ms` of a drone that is there is 0, `drone` of a
# false alarm -1, and `merged` counts the drones besides.
LAYOUTS: Mapping[SectionKind, tuple[tuple[str, str], ...]] = {
    SectionKind.PLOTS: _PLOT,
    SectionKind.PLOT_TRUTHS: _TRUTH,
    SectionKind.LOST_PLOTS: (*_PLOT, *_TRUTH),
    SectionKind.DRONES: (
        ("drone", "u4"),
        ("east_m", "f4"),
        ("north_m", "f4"),
        ("up_m", "f4"),
        ("velocity_east_m_s", "f4"),
        ("velocity_north_m_s", "f4"),
        ("gone_ms", "f4"),
    ),
    SectionKind.TRACKS: (
        ("t_utc_ms", "f8"),
        ("track", "u4"),
        ("east_m", "f4"),
        ("north_m", "f4"),
        ("velocity_east_m_s", "f4"),
        ("velocity_north_m_s", "f4"),
        ("flags", "u1"),
    ),
}


class Update(NamedTuple):
    """An update: what a presenter sees, and what follows for who sees the truth."""

    public: bytes
    truth: bytes
    is_snapshot: bool
    # What an audience sees that is not given the truth, if that is not the same.
    audience: bytes | None = None


def header(number: int, now_utc_ns: int, flags: int = 0) -> bytes:
    """The beginning of an update."""
    return HEADER.pack(MAGIC, flags, number, now_utc_ns / 1e6)


def section(kind: SectionKind, columns: Mapping[str, ArrayLike], first: int = 0) -> bytes:
    """Rows of that kind; no octet if there are none."""
    typed = [np.asarray(columns[name], dtype=f"<{dtype}") for name, dtype in LAYOUTS[kind]]
    rows = len(typed[0])
    if not rows:
        return b""
    if any(len(column) != rows for column in typed):
        raise ValueError("columns of a section are equally long")
    body = b"".join(_aligned(column.tobytes() for column in typed))
    return SECTION.pack(kind, rows, first & COUNT_MASK, len(body)) + body


def news(text: bytes, kind: SectionKind = SectionKind.NEWS) -> bytes:
    """A section of JSON; its rows are its octets."""
    body = b"".join(_aligned([text]))
    return SECTION.pack(kind, len(text), 0, len(body)) + body


def _aligned(columns: Iterable[bytes]) -> Iterable[bytes]:
    for column in columns:
        yield column
        yield bytes(-len(column) % ALIGNMENT)


MAX_COMMAND_OCTETS = 64 << 10
# Sensors whose details are worked out: for one viewer, and for all of them together.
MAX_WATCHED = 16
# Of a command: exactly one of these keys says what it is for.
SUBJECTS = ("sensor", "clock", "story", "undo", "session", "record", "replay", "audience")


class ViewRequest(NamedTuple):
    """What a viewer looks at."""

    truth: bool
    watched: tuple[str, ...]  # Sensors whose details it shows
    name: str = ""  # What who looks calls himself


class ControlRequest(NamedTuple):
    """What a viewer asks for; the answer has the same number."""

    number: int
    command: dict[str, Any]


class Controls(Protocol):
    """Makes changes to a running session."""

    async def apply(self, command: dict[str, Any]) -> Mapping[str, Any]:
        """Do it; what is in force then. Raises `PlotfeedError`."""


class NoControls:
    """A session that cannot be changed: a picture to look at."""

    async def apply(self, _command: dict[str, Any]) -> Mapping[str, Any]:
        """Refuse it."""
        raise PlotfeedError("this session takes no commands")


def request_in(text: str | None) -> ViewRequest | ControlRequest:
    """What a viewer's message says, None where it is octets; raises `PlotfeedError`."""
    if text is None:
        raise PlotfeedError("expected text, not octets")
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise PlotfeedError("expected JSON") from None
    if not isinstance(message, dict):
        raise PlotfeedError("expected an object with look or command")
    if "look" in message:
        look = message["look"] if isinstance(message["look"], dict) else {"watch": None}
        watched = look.get("watch", [])
        if not isinstance(watched, list) or not all(isinstance(name, str) for name in watched):
            raise PlotfeedError("look: expected truth and a list to watch")
        name = name_in(look.get("name", ""))
        return ViewRequest(look.get("truth") is True, tuple(watched[:MAX_WATCHED]), name)
    number, command = message.get("number"), message.get("command")
    if not isinstance(number, int) or not isinstance(command, dict):
        raise PlotfeedError("expected an object with a number and a command")
    if sum(subject in command for subject in SUBJECTS) != 1:
        raise PlotfeedError(f"expected a command with one of {', '.join(SUBJECTS)}")
    return ControlRequest(number, command)


MAX_QUEUED = 20  # Updates; when there are more, all are dropped, and a snapshot makes up for them
MAX_QUEUED_OCTETS = 8 << 20


class Viewer:
    """What waits to be sent to one browser, and what it looks at."""

    def __init__(
        self, snapshot: Callable[[], Update], audience: Audience, role: Role = Role.PRESENTER
    ) -> None:
        """`audience` says what its part of the viewers may see, and what this one is called."""
        self.role = role
        self.name = ""
        self._audience = audience
        self._called = audience.called(role)
        self.sees_truth = False
        self.watched: tuple[str, ...] = ()
        self._snapshot = snapshot
        self._needs_all = True
        self._missed = 0
        self._queue = deque[bytes]()
        self._filled = asyncio.Event()
        self._filled.set()

    @property
    def who(self) -> str:
        """Who looks, as others are told."""
        return f"{self.name} ({self._called})" if self.name else self._called

    def offer(self, update: Update) -> None:
        """The next update, for when there is time to send it."""
        if self._needs_all:
            self._missed += self._missed > 0
            return
        octets, queue = self._octets_of(update), self._queue
        if len(queue) < MAX_QUEUED and sum(map(len, queue), len(octets)) <= MAX_QUEUED_OCTETS:
            queue.append(octets)
        else:
            self._missed += len(queue) + 1
            self.start_again()
        self._filled.set()

    def start_again(self) -> None:
        """Forget what waits; a snapshot is next."""
        self._queue.clear()
        self._needs_all = True
        self._filled.set()

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
            if self._missed:
                octets += news(json.dumps({"missed_updates": self._missed}).encode())
                self._missed = 0
        else:
            octets = self._queue.popleft()
        if not self._queue and not self._needs_all:
            self._filled.clear()
        return octets

    def _octets_of(self, update: Update) -> bytes:
        if self.role is Role.AUDIENCE and not self._audience.truth:
            return update.public if update.audience is None else update.audience
        return update.public + update.truth if self.sees_truth else update.public
