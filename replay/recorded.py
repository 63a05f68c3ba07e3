"""What a recording holds, whatever file it is in, and what all readers and writers of them do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import islice
from typing import BinaryIO, NamedTuple, Self

CHUNK_OCTETS = 1 << 18
LATEST_NS = (1 << 64) - 1  # In the year 2554; all that MCAP can hold
SUFFIX, SCENE_NAME = ".mcap", "scene.toml"  # Of a session's record, and of the scene within it
UDP_TOPIC = "udp/"  # How topics of datagrams begin: udp/ADDRESS/PORT of where they went


class Stage(StrEnum):
    """Where a message was when it was recorded."""

    TELEMETRY = "telemetry"  # It came in
    BEFORE = "before"  # A sensor handed it to its link; the log time is when it did
    AFTER = "after"  # It left, as late as its link made it; the log time is when it did
    # It came from a broker or a socket, or was read from a file that others wrote.
    RECEIVED = "received"


# The stages of messages as whoever received them had them.
WHAT_LEFT = (Stage.AFTER, Stage.RECEIVED)


class Recorded(NamedTuple):
    """One message of a recording, by its names: most of the time of reading is that to make one."""

    topic: str  # For a datagram, udp/ADDRESS/PORT of where it went
    payload: bytes
    log_time_ns: int  # UTC since 1970: when it left or was received
    # UTC since 1970: when it was due to leave its sensor; the log time where that is unknown.
    publish_time_ns: int
    content_type: str = ""
    properties: tuple[tuple[str, str], ...] = ()  # User properties of MQTT 5
    retain: bool = False
    qos: int = 0
    stage: Stage = Stage.RECEIVED


MOST_OCTETS = 1 << 20  # Of messages that are handed on together, without the last one


def next_messages(messages: Iterator[Recorded], most: int) -> list[Recorded]:
    """The next messages, at most so many; fewer where they are long or come to their end."""
    some, octets = [], 0
    for each in islice(messages, most):
        some.append(each)
        octets += len(each.payload)
        if octets > MOST_OCTETS:
            break
    return some


@dataclass(frozen=True, slots=True, kw_only=True)
class Damage:
    """A part of a recording that cannot be read."""

    offset: int  # Octet of the file at which it begins
    what: str  # In a line: what is wrong, and what was expected

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
    log_time_ns: int = 0  # UTC since 1970: when it was put there


@dataclass(frozen=True, slots=True, kw_only=True)
class AttachmentEntry:
    """Where an attachment is."""

    name: str
    media_type: str
    octets: int  # Of its data
    offset: int  # Of its record in the file


class RecordingReader(ABC):
    """Reads a recording from its start to its end."""

    skipped = 0  # Parts that are whole and hold no message, so far

    def __init__(self) -> None:
        self.damage = Damages()  # Found so far. It grows as parts are read that only then show it.

    @property
    @abstractmethod
    def at(self) -> int:
        """Octets of the file that were read."""

    @abstractmethod
    def messages(self) -> Iterator[Recorded]:
        """Messages of the file, once."""

    def attachments(self) -> Sequence[AttachmentEntry]:
        """Files within the file."""
        return ()

    def attachment(self, _name: str) -> Attachment | None:
        """The last attachment of that name that is whole; None if there is none."""
        return None

    def close(self) -> None:  # noqa: B027 - most have opened nothing
        """End what was begun to read it; again does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class TableName(StrEnum):
    """What a table has a row for each of."""

    PLOTS = "plots"
    TRUTHS = "truths"
    LOOKS = "looks"
    TRACKS = "tracks"
    MESSAGES = "messages"
    FATES = "fates"
    ASTERIX_015 = "asterix-015"
    ASTERIX_048 = "asterix-048"
    ASTERIX_062 = "asterix-062"
    ASTERIX_205 = "asterix-205"


# Tables of plots, and the category that is in each; None: each plot once, whatever its format.
PLOT_TABLES: Mapping[TableName, int | None] = {
    TableName.PLOTS: None,
    **{name: int(name[-3:]) for name in TableName if name.startswith("asterix-")},
}


class RecordingWriter(ABC):
    """Writes a recording to a file, which stays open."""

    @abstractmethod
    def write(self, message: Recorded) -> str | None:
        """Write a message; in a few words why it cannot be held, or None."""

    def attach(self, _attachment: Attachment) -> bool:
        """Put another file into the file; whether such a file can hold one."""
        return False

    def notes(self) -> list[str]:
        """Lines that say what was lost of messages that are in the file."""
        return []

    def close(self) -> None:  # noqa: B027 - most have nothing left
        """Write what is still to be written."""


class OctetsReader(RecordingReader):
    """Reads a file whose messages lie one behind the other.

    Its octets come in pieces, none larger than what the file holds, whatever is asked for.
    """

    def __init__(self, file: BinaryIO) -> None:
        super().__init__()
        self._file = file
        self._buffer = b""
        self._start = 0  # offset of the buffer in the file
        self._next = 0  # of the buffer

    @property
    def at(self) -> int:
        """Octets of the file that were read, and so the offset of the next one."""
        return self._start + self._next

    def take(self, octets: int) -> bytes:
        """The next so many; fewer at the end of the file."""
        piece = self.peek(octets)
        self._next += len(piece)
        return piece

    def peek(self, octets: int, *, ahead: int = 0) -> bytes:
        """Octets that stay: so many that begin `ahead` of the next one; fewer at the end."""
        if self._next + ahead + octets > len(self._buffer):
            self._start += self._next
            self._buffer, self._next = self._buffer[self._next :], 0
            while len(self._buffer) < ahead + octets and (piece := self._file.read(CHUNK_OCTETS)):
                self._buffer += piece
        begin = self._next + ahead
        return self._buffer[begin : begin + octets]

    def skip(self, octets: int) -> int:
        """Leave so many out, or what there is; how many they were."""
        left = octets
        while left and (piece := self.take(min(left, CHUNK_OCTETS))):
            left -= len(piece)
        return octets - left

    def skip_behind(self, mark: bytes) -> bool:
        """Go to the octet that follows `mark`, or to the end of the file; whether it was found."""
        while True:
            found = self._buffer.find(mark, self._next)
            if found >= 0:
                self._next = found + len(mark)
                return True
            # The mark may begin in the last octets.
            self._next = max(self._next, len(self._buffer) - len(mark) + 1)
            if len(self.peek(len(mark))) < len(mark):
                self._next = len(self._buffer)
                return False
