"""Raw ASTERIX: data blocks back to back, timed by the times of day in their records."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain, pairwise
from typing import BinaryIO

from plotfeed.replay.asterix_payload import (
    CONTENT_TYPE,
    HEADER_OCTETS,
    block_octets,
    is_asterix,
)
from plotfeed.replay.damages import Damages
from plotfeed.replay.octets import Octets
from plotfeed.replay.recorded import Recorded
from plotfeed.replay.time_of_day import time_of_day_ns
from plotfeed.replay.times import BEHIND_NS, DayClock, ahead_ns

Timed = tuple[bytes, int | None]
"""A data block, and the time of day of its first record if that has one."""


class RawReader:
    """The data blocks of a file, each a message. Nothing tells where the next one is after damage.

    A message is of the time of day of its block's first record, and if that has none, or one that
    is alone against those around it, of the time of the message before. No message is earlier than
    the one before it, so that they stay in their order.
    """

    def __init__(self, file: BinaryIO, *, date_utc_ns: int = 0) -> None:
        self._octets = Octets(file)
        self._clock = DayClock(date_utc_ns)
        self._first_utc_ns = date_utc_ns
        self.damage = Damages()
        self.skipped = 0

    @property
    def at(self) -> int:
        """Octets of the file that were read."""
        return self._octets.at

    def messages(self) -> Iterator[Recorded]:
        """Each data block, on the topic asterix/CATEGORY."""
        last_utc_ns = self._first_utc_ns
        timed = ((block, time_of_day_ns(block)) for block, _ in self.blocks())
        for block, time_ns in without_outliers(timed):
            if time_ns is not None:
                last_utc_ns = max(last_utc_ns, self._clock.utc_ns(time_ns))
            yield Recorded(
                topic=f"asterix/{block[0]:03d}",
                payload=block,
                log_time_ns=last_utc_ns,
                publish_time_ns=last_utc_ns,
                content_type=f"{CONTENT_TYPE}; cat={block[0]}",
            )

    def blocks(self) -> Iterator[tuple[bytes, int]]:
        """The data blocks with their headers, and where they begin."""
        octets = self._octets
        while True:
            at = octets.at
            header = octets.peek(HEADER_OCTETS)
            if len(header) < HEADER_OCTETS:
                if header:
                    self.damage.add(at, "the header of a data block is cut off")
                return
            length = int.from_bytes(header[1:], "big")
            if length < HEADER_OCTETS:
                self.damage.add(at, f"a data block of {length} octets has no header")
                return
            block = octets.take(length)
            if len(block) < length:
                self.damage.add(at, f"a data block of {length} octets, {len(block)} are there")
                return
            yield block, at


def without_outliers(timed: Iterable[Timed]) -> Iterator[Timed]:
    """None in place of a time of day far from the one before where the one after is near that."""
    last_ns: int | None = None
    for (block, time_ns), (_, next_ns) in pairwise(chain(timed, [(b"", None)])):
        if time_ns is not None and _alone(last_ns, time_ns, next_ns):
            yield block, None
            continue
        last_ns = last_ns if time_ns is None else time_ns
        yield block, time_ns


def _alone(before_ns: int | None, time_ns: int, after_ns: int | None) -> bool:
    if before_ns is None or after_ns is None:
        return False
    near_by = ahead_ns(before_ns, after_ns) <= BEHIND_NS
    return near_by and ahead_ns(before_ns, time_ns) > BEHIND_NS


class RawWriter:
    """Data blocks back to back. Of what they came with, nothing is kept."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._trailers = 0

    def write(self, message: Recorded) -> str | None:
        """Write a message; why it cannot be held, or None."""
        if not is_asterix(message.content_type, message.payload):
            return "no ASTERIX"
        octets = block_octets(message.payload)
        self._trailers += octets < len(message.payload)
        self._file.write(message.payload[:octets])
        return None

    def notes(self) -> list[str]:
        """What was lost of messages that are in the file."""
        notes = ["it has no times but those of day that its records have, and no topics"]
        if self._trailers:
            notes.append(f"{self._trailers} messages lost what came after their data blocks")
        return notes

    def close(self) -> None:
        """Nothing is left to be written."""
