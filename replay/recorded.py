"""What a recording holds, whatever file it is in: messages with their times, and damages."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

LATEST_NS = (1 << 64) - 1
"""In the year 2554; all that MCAP can hold."""


class Stage(StrEnum):
    """Where a message was when it was recorded."""

    TELEMETRY = "telemetry"
    """It came in."""
    BEFORE = "before"
    """A sensor handed it to its link; the log time is when it did."""
    AFTER = "after"
    """It left, as late as its link made it; the log time is when it did."""
    RECEIVED = "received"
    """It came from a broker or a socket, or was read from a file that others wrote."""


WHAT_LEFT = (Stage.AFTER, Stage.RECEIVED)
"""The stages of messages as whoever received them had them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """One message of a recording."""

    topic: str
    """For a datagram, udp/ADDRESS/PORT of where it went."""
    payload: bytes
    log_time_ns: int
    """UTC since 1970: when it left or was received."""
    publish_time_ns: int
    """UTC since 1970: when it was due to leave its sensor; the log time where that is unknown."""
    content_type: str = ""
    properties: tuple[tuple[str, str], ...] = ()
    """User properties of MQTT 5."""
    retain: bool = False
    qos: int = 0
    stage: Stage = Stage.RECEIVED


@dataclass(frozen=True, slots=True, kw_only=True)
class Damage:
    """A part of a recording that cannot be read."""

    offset: int
    """Octet of the file at which it begins."""
    what: str
    """In a line: what is wrong, and what was expected."""

    def __str__(self) -> str:
        return f"octet {self.offset}: {self.what}"


MAX_DAMAGES = 1000


class Damages(list[Damage]):
    """The first ones, each place once, and one entry more that says that there are others."""

    def __init__(self) -> None:
        super().__init__()
        self._offsets: set[int] = set()

    def add(self, offset: int, what: str) -> None:
        """Note what is wrong with the octets from `offset` on, unless something was already."""
        if offset in self._offsets or len(self) > MAX_DAMAGES:
            return
        self._offsets.add(offset)
        what = what if len(self) < MAX_DAMAGES else "from here on, more that is not listed"
        self.append(Damage(offset=offset, what=what))


@dataclass(frozen=True, slots=True, kw_only=True)
class Attachment:
    """A file within the file, such as the scene."""

    name: str
    media_type: str
    data: bytes
    log_time_ns: int = 0
    """UTC since 1970: when it was put there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttachmentEntry:
    """Where an attachment is."""

    name: str
    media_type: str
    octets: int
    """Of its data."""
    offset: int
    """Of its record in the file."""
