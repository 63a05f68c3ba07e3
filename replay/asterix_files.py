"""Files of ASTERIX blocks, raw and FINAL, and what is said of blocks without their items."""

from __future__ import annotations

import contextlib
import struct
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from itertools import chain, pairwise
from typing import BinaryIO

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import records_in, whole_blocks
from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS, Category
from plotfeed.proto.asterix.codec.retime_asterix import TimeFinder
from plotfeed.proto.asterix.other_categories import OTHER_CATEGORIES
from plotfeed.proto.content_types import ASTERIX, asterix_content_type
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import DAY_NS, NS
from plotfeed.replay.recorded import OctetsReader, Recorded, RecordingWriter

MAX_TRAILER_OCTETS = 16
UNKNOWN = "application/octet-stream"
_OF_CATEGORY = tuple(map(asterix_content_type, range(256)))


def block_octets(payload: bytes) -> int:
    """How many of the first octets are whole data blocks, back to back."""
    if _is_one_block(payload):
        return len(payload)
    return sum(HEADER_OCTETS + len(block.body) for block in whole_blocks(payload))


def categories(payload: bytes) -> tuple[int, ...]:
    """Categories of the whole data blocks at the start of a payload: each once, in their order."""
    return tuple(dict.fromkeys(block.category for block in whole_blocks(payload)))


def record_counts(
    payload: bytes, layouts: Mapping[int, Category] = CATEGORIES
) -> dict[int, int | None]:
    """Whole records of each category; None for one of which nothing tells where they end."""
    counts: dict[int, int | None] = {}
    for block in whole_blocks(payload):
        if layouts.get(block.category) is None:
            counts[block.category] = None
            continue
        count = counts.get(block.category) or 0
        with contextlib.suppress(DecodeError):
            for _ in records_in(block, layouts):
                count += 1
        counts[block.category] = count
    return counts


def trailer_octets(payload: bytes) -> int | None:
    """Octets that a vendor appended to the data blocks, mostly 0; None if it is no ASTERIX.

    Of a payload that nobody has labelled: what could be a block by chance must have a category,
    which 0 is not, and an octet in it.
    """
    octets = block_octets(payload)
    left = len(payload) - octets
    if not octets or left > MAX_TRAILER_OCTETS or not payload[0] or octets == HEADER_OCTETS:
        return None
    return left


def content_type(payload: bytes) -> str:
    """Type of a payload that nobody has labelled: ASTERIX, of one category or many, or unknown."""
    if _is_one_block(payload) and len(payload) > HEADER_OCTETS and payload[0]:
        return _OF_CATEGORY[payload[0]]
    if trailer_octets(payload) is None:
        return UNKNOWN
    found = categories(payload)
    return _OF_CATEGORY[found[0]] if len(found) == 1 else ASTERIX


def is_asterix(content: str, payload: bytes) -> bool:
    """Whether a payload of that content type, empty if unknown, holds a block of ASTERIX."""
    if content and not content.startswith(ASTERIX):
        return False
    return bool(block_octets(payload)) if content else trailer_octets(payload) is not None


def _is_one_block(payload: bytes) -> bool:
    """Whether it is a single block, as most are."""
    octets = len(payload)
    return octets >= HEADER_OCTETS and payload[1] << 8 | payload[2] == octets


LSB_NS = 7_812_500  # 1/128 s
# Categories of which it is known where their records end.
KNOWN_CATEGORIES = frozenset((*CATEGORIES, *OTHER_CATEGORIES))


@cache
def _finder(category: int) -> TimeFinder | None:
    layout = CATEGORIES.get(category) or OTHER_CATEGORIES.get(category)
    return None if layout is None else TimeFinder(layout)


def time_of_day_ns(block: bytes) -> int | None:
    """Time of a whole data block's first record; None if it has none, or none that is known."""
    finder = _finder(block[0]) if block else None
    at = finder.first_time(block, HEADER_OCTETS) if finder else None
    time_ns = DAY_NS + 1 if at is None else LSB_NS * int.from_bytes(block[at : at + 3], "big")
    # Some senders write 86400.0 for midnight; what is beyond that is no time of day.
    return time_ns % DAY_NS if time_ns <= DAY_NS else None


# A data block, and the time of day of its first record if that has one.
Timed = tuple[bytes, int | None]


def raw_topic(category: int) -> str:
    """The topic of a data block that nothing else names."""
    return f"asterix/{category:03d}"


class _DatedReader(OctetsReader):
    """Reads a file that has times of day alone; its first day begins at `date_utc_ns`."""

    def __init__(self, file: BinaryIO, *, date_utc_ns: int = 0) -> None:
        super().__init__(file)
        self._clock = DayClock(date_utc_ns)
        self._last_utc_ns = date_utc_ns  # Of the message before


class RawReader(_DatedReader):
    """The data blocks of a file, each a message. Nothing tells where the next one is after damage.

    A message is of the time of day of its block's first record, and if that has none, or one that
    is alone against those around it, of the time of the message before. No message is earlier than
    the one before it, so that they stay in their order.
    """

    def messages(self) -> Iterator[Recorded]:
        """Each data block, on the topic asterix/CATEGORY."""
        timed = ((block, time_of_day_ns(block)) for block in self._blocks())
        for block, time_ns in _without_outliers(timed):
            if time_ns is not None:
                self._last_utc_ns = max(self._last_utc_ns, self._clock.utc_ns(time_ns))
            yield Recorded(
                topic=raw_topic(block[0]),
                payload=block,
                log_time_ns=self._last_utc_ns,
                publish_time_ns=self._last_utc_ns,
                content_type=asterix_content_type(block[0]),
            )

    def _blocks(self) -> Iterator[bytes]:
        """The data blocks with their headers."""
        while True:
            at = self.at
            header = self.peek(HEADER_OCTETS)
            if len(header) < HEADER_OCTETS:
                if header:
                    self.damage.add(at, "the header of a data block is cut off")
                return
            length = int.from_bytes(header[1:], "big")
            if length < HEADER_OCTETS:
                self.damage.add(at, f"a data block of {length} octets has no header")
                return
            block = self.take(length)
            if len(block) < length:
                self.damage.add(at, f"a data block of {length} octets, {len(block)} are there")
                return
            yield block


def _without_outliers(timed: Iterable[Timed]) -> Iterator[Timed]:
    """None in place of a time of day far from the one before where the one after is near that."""
    last_ns: int | None = None
    for (block, time_ns), (_, next_ns) in pairwise(chain(timed, [(b"", None)])):
        if time_ns is not None and last_ns is not None and next_ns is not None:
            next_is_near = ahead_ns(last_ns, next_ns) <= BEHIND_NS
            if next_is_near and ahead_ns(last_ns, time_ns) > BEHIND_NS:
                yield block, None
                continue
        last_ns = last_ns if time_ns is None else time_ns
        yield block, time_ns


class BlocksWriter(RecordingWriter):
    """Writes the data blocks of messages that are ASTERIX, and nothing of what came after them."""

    lost: str  # What a file of this format does not say

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._trailers = 0

    def write(self, message: Recorded) -> str | None:
        """Write a message; why it cannot be held, or None."""
        if not is_asterix(message.content_type, message.payload):
            return "no ASTERIX"
        blocks = message.payload[: block_octets(message.payload)]
        framed = self.framed(message, blocks)
        if isinstance(framed, str):
            return framed
        self._trailers += len(blocks) < len(message.payload)
        self._file.write(framed)
        return None

    @abstractmethod
    def framed(self, message: Recorded, blocks: bytes) -> bytes | str:
        """The octets that stand in the file for a message, or why none can."""

    def notes(self) -> list[str]:
        """What was lost of messages that are in the file."""
        if not self._trailers:
            return [self.lost]
        return [self.lost, f"{self._trailers} messages lost what came after their data blocks"]


class RawWriter(BlocksWriter):
    """Data blocks back to back. Of what they came with, nothing is kept."""

    lost = "it has no times but those of day that its records have, and no topics"

    def framed(self, _message: Recorded, blocks: bytes) -> bytes:
        """The data blocks as they are."""
        return blocks


TICK_NS = 10_000_000
TICKS_A_DAY = DAY_NS // TICK_NS
FINAL_HEADER_OCTETS = 8
TRAILER = b"\xa5\xa5\xa5\xa5"
MIN_FRAME_OCTETS = FINAL_HEADER_OCTETS + len(TRAILER)
MAX_FRAME_OCTETS = 0xFFFF
_HEADER = struct.Struct(">HBBBBH")

# Properties that keep what a frame says and a message does not.
ERROR, LINE, DAY = "final-error", "final-line", "final-day"


class FinalReader(_DatedReader):
    """The frames of a file, each a message. After damage it goes on behind the next trailer."""

    def messages(self) -> Iterator[Recorded]:
        """Each frame, on the topic line/LINE/asterix."""
        lost_from: int | None = None
        behind_trailer = False
        while self.peek(1):
            at = self.at
            frame = self._frame()
            if frame:
                self._lost(lost_from, at)
                lost_from = None
                yield self._message(frame, at)
                continue
            lost_from = at if lost_from is None else lost_from
            if behind_trailer and self.peek(1) == TRAILER[:1]:
                self.skip(1)  # more than four of them: the trailer may be the last four
            else:
                behind_trailer = self.skip_behind(TRAILER)
        self._lost(lost_from, self.at)

    def _frame(self) -> bytes:
        """Take the frame that begins here; nothing if there is none."""
        length = int.from_bytes(self.peek(2), "big")
        if length < MIN_FRAME_OCTETS:
            return b""
        trailer = self.peek(len(TRAILER), ahead=length - len(TRAILER))
        return self.take(length) if trailer == TRAILER else b""

    def _lost(self, first: int | None, end: int) -> None:
        if first is not None:
            what = f"{end - first} octets that are no frames of 12 octets or more and their trailer"
            self.damage.add(first, what)

    def _message(self, frame: bytes, at: int) -> Recorded:
        _, error, line, day, high, low = _HEADER.unpack_from(frame)
        ticks = high << 16 | low
        if ticks < TICKS_A_DAY:
            self._last_utc_ns = self._clock.utc_ns(ticks * TICK_NS)
        else:
            self.damage.add(
                at, f"a time of day of {ticks // 100} s; that of the frame before is it"
            )
        payload = frame[FINAL_HEADER_OCTETS : -len(TRAILER)]
        found = categories(payload)
        return Recorded(
            topic=f"line/{line}/asterix",
            payload=payload,
            log_time_ns=self._last_utc_ns,
            publish_time_ns=self._last_utc_ns,
            content_type=asterix_content_type(found[0]) if len(found) == 1 else ASTERIX,
            properties=((ERROR, str(error)), (LINE, str(line)), (DAY, str(day))),
        )


class FinalWriter(BlocksWriter):
    """ASTERIX in frames. Times are rounded to 10 ms.

    Error, line and day of a frame that was read stay; else the line is the number of the topic, of
    those in the file, and the others are 0.
    """

    lost = "its clock counts 10 ms, and it has no date"

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file)
        self._lines: dict[str, int] = {}

    def framed(self, message: Recorded, blocks: bytes) -> bytes | str:
        """Header, data blocks and trailer; the header's fields are kept if they can be."""
        length = MIN_FRAME_OCTETS + len(blocks)
        if length > MAX_FRAME_OCTETS:
            return f"longer than a frame's {MAX_FRAME_OCTETS} octets"
        kept = dict(message.properties)
        error, day = _octet(kept.get(ERROR), 0), _octet(kept.get(DAY), 0)
        line = _octet(kept.get(LINE), self._line(message.topic))
        # The nearest; half of one is rounded up.
        ticks = (message.log_time_ns + TICK_NS // 2) // TICK_NS % TICKS_A_DAY
        head = _HEADER.pack(length, error, line, day, ticks >> 16, ticks & 0xFFFF)
        return head + blocks + TRAILER

    def _line(self, topic: str) -> int:
        if len(self._lines) > 0xFF and topic not in self._lines:
            return 0xFF
        return self._lines.setdefault(topic, len(self._lines))


def _octet(text: str | None, otherwise: int) -> int:
    """A number of an octet that a property has."""
    if text is None or not (text.isascii() and text.isdecimal() and len(text) <= 3):
        return otherwise
    return int(text) if int(text) <= 0xFF else otherwise


# How much earlier than the one before it a time of day may be, on the same day.
BEHIND_NS = 3600 * NS


class DayClock:
    """Gives days to times of day that come in their order, or a little out of it.

    The first is of the day that begins at `date_utc_ns`. One that is at most an hour behind the
    one before it is out of order, across midnight too; any other is ahead of it.
    """

    def __init__(self, date_utc_ns: int) -> None:
        self._date_utc_ns = date_utc_ns
        self._last_utc_ns: int | None = None

    def utc_ns(self, time_of_day_ns: int) -> int:
        """The time, not before 1970, of the next time of day."""
        if self._last_utc_ns is None:
            self._last_utc_ns = self._date_utc_ns + time_of_day_ns
        else:
            since_midnight = self._last_utc_ns - self._date_utc_ns
            self._last_utc_ns += ahead_ns(since_midnight, time_of_day_ns)
        return max(self._last_utc_ns, 0)


def ahead_ns(one_ns: int, other_ns: int) -> int:
    """How far the second of two times of day is ahead of the first: from -1 h to 23 h."""
    ahead = (other_ns - one_ns) % DAY_NS
    return ahead - DAY_NS if ahead >= DAY_NS - BEHIND_NS else ahead
