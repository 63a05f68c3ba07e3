"""FINAL: frames of ASTERIX with a time of day of 10 ms, read and written. They have no date.

===========  ===================================================
octets       part of a frame, big-endian
===========  ===================================================
2            octets of the whole frame, at least 12
1            error
1            line
1            day
3            time of day: 10 ms
n            data blocks
4            A5 A5 A5 A5
===========  ===================================================
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO

from plotfeed.replay.asterix_payload import (
    CONTENT_TYPE,
    block_octets,
    categories,
    is_asterix,
)
from plotfeed.replay.damages import Damages
from plotfeed.replay.octets import Octets
from plotfeed.replay.recorded import Recorded
from plotfeed.replay.times import DAY_NS, DayClock

TICK_NS = 10_000_000
TICKS_A_DAY = DAY_NS // TICK_NS
HEADER_OCTETS = 8
TRAILER = b"\xa5\xa5\xa5\xa5"
MIN_FRAME_OCTETS = HEADER_OCTETS + len(TRAILER)
MAX_FRAME_OCTETS = 0xFFFF
_HEADER = struct.Struct(">HBBBBH")

ERROR, LINE, DAY = "final-error", "final-line", "final-day"
"""Properties that keep what a frame says and a message does not."""


class FinalReader:
    """The frames of a file, each a message. After damage it goes on behind the next trailer."""

    def __init__(self, file: BinaryIO, *, date_utc_ns: int = 0) -> None:
        self._octets = Octets(file)
        self._clock = DayClock(date_utc_ns)
        self._last_utc_ns = date_utc_ns
        self.damage = Damages()
        self.skipped = 0

    @property
    def at(self) -> int:
        """Octets of the file that were read."""
        return self._octets.at

    def messages(self) -> Iterator[Recorded]:
        """Each frame, on the topic line/LINE/asterix."""
        octets = self._octets
        lost_from: int | None = None
        behind_trailer = False
        while octets.peek(1):
            at = octets.at
            frame = self._frame()
            if frame:
                self._lost(lost_from, at)
                lost_from = None
                yield self._message(frame, at)
                continue
            lost_from = at if lost_from is None else lost_from
            if behind_trailer and octets.peek(1) == TRAILER[:1]:
                octets.skip(1)  # more than four of them: the trailer may be the last four
            else:
                behind_trailer = octets.skip_behind(TRAILER)
        self._lost(lost_from, octets.at)

    def _frame(self) -> bytes:
        """Take the frame that begins here; nothing if there is none."""
        length = int.from_bytes(self._octets.peek(2), "big")
        if length < MIN_FRAME_OCTETS:
            return b""
        trailer = self._octets.peek(len(TRAILER), ahead=length - len(TRAILER))
        return self._octets.take(length) if trailer == TRAILER else b""

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
        payload = frame[HEADER_OCTETS : -len(TRAILER)]
        found = categories(payload)
        return Recorded(
            topic=f"line/{line}/asterix",
            payload=payload,
            log_time_ns=self._last_utc_ns,
            publish_time_ns=self._last_utc_ns,
            content_type=f"{CONTENT_TYPE}; cat={found[0]}" if len(found) == 1 else CONTENT_TYPE,
            properties=((ERROR, str(error)), (LINE, str(line)), (DAY, str(day))),
        )


class FinalWriter:
    """ASTERIX in frames. Times are rounded to 10 ms.

    Error, line and day of a frame that was read stay; else the line is the number of the topic, of
    those in the file, and the others are 0.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._lines: dict[str, int] = {}
        self._trailers = 0

    def write(self, message: Recorded) -> str | None:
        """Write a message; why it cannot be held, or None."""
        if not is_asterix(message.content_type, message.payload):
            return "no ASTERIX"
        blocks = message.payload[: block_octets(message.payload)]
        length = MIN_FRAME_OCTETS + len(blocks)
        if length > MAX_FRAME_OCTETS:
            return f"longer than a frame's {MAX_FRAME_OCTETS} octets"
        self._trailers += len(blocks) < len(message.payload)
        kept = dict(message.properties)
        error, day = _octet(kept.get(ERROR), 0), _octet(kept.get(DAY), 0)
        line = _octet(kept.get(LINE), self._line(message.topic))
        ticks = ticks_of_day(message.log_time_ns)
        self._file.write(
            _HEADER.pack(length, error, line, day, ticks >> 16, ticks & 0xFFFF) + blocks + TRAILER
        )
        return None

    def notes(self) -> list[str]:
        """What was lost of messages that are in the file."""
        notes = ["its clock counts 10 ms, and it has no date"]
        if self._trailers:
            notes.append(f"{self._trailers} messages lost what came after their data blocks")
        return notes

    def close(self) -> None:
        """Nothing is left to be written."""

    def _line(self, topic: str) -> int:
        if len(self._lines) > 0xFF and topic not in self._lines:
            return 0xFF
        return self._lines.setdefault(topic, len(self._lines))


def ticks_of_day(t_utc_ns: int) -> int:
    """The nearest 10 ms of the day; half of one is rounded up."""
    return (t_utc_ns + TICK_NS // 2) // TICK_NS % TICKS_A_DAY


def _octet(text: str | None, otherwise: int) -> int:
    """A number of an octet that a property has."""
    if text is None or not (text.isascii() and text.isdecimal() and len(text) <= 3):
        return otherwise
    return int(text) if int(text) <= 0xFF else otherwise
