"""Which format a recording is in, by what it begins with and then by its suffix; its reader."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import BinaryIO, Protocol

from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.asterix_blocks import HEADER_OCTETS
from plotfeed.replay.asterix_files import TRAILER, FinalReader, FinalWriter, RawReader, RawWriter
from plotfeed.replay.json_lines import JsonLinesReader, JsonLinesWriter
from plotfeed.replay.pcap.libpcap import PcapReader, PcapWriter
from plotfeed.replay.pcap.packets import FORMATS as PCAP_FORMATS
from plotfeed.replay.pcap.pcapng import SECTION, PcapngReader
from plotfeed.replay.recorded import Damage, Recorded

MCAP_MAGIC = b"\x89MCAP"
HEAD_OCTETS = 1 << 16
BLOCKS_LOOKED_AT = 8


class FileFormat(StrEnum):
    """Of recordings."""

    MCAP = "mcap"
    PCAP = "pcap"
    PCAPNG = "pcapng"
    FINAL = "final"
    RAW = "raw"
    JSON = "jsonl"
    CSV = "csv"


SUFFIXES: Mapping[str, FileFormat] = {
    ".mcap": FileFormat.MCAP,
    ".pcap": FileFormat.PCAP,
    ".cap": FileFormat.PCAP,
    ".pcapng": FileFormat.PCAPNG,
    ".ntar": FileFormat.PCAPNG,
    ".ff": FileFormat.FINAL,
    ".final": FileFormat.FINAL,
    ".ast": FileFormat.RAW,
    ".asterix": FileFormat.RAW,
    ".raw": FileFormat.RAW,
    ".jsonl": FileFormat.JSON,
    ".ndjson": FileFormat.JSON,
    ".csv": FileFormat.CSV,
}
DATELESS = (FileFormat.FINAL, FileFormat.RAW)
"""Formats that have times of day alone."""
HOLD_STAGES = (FileFormat.MCAP, FileFormat.JSON)
"""Formats that hold messages before their link beside those after it."""


class RecordingReader(Protocol):
    """Reads a recording from its start to its end."""

    @property
    def damage(self) -> list[Damage]:
        """Found so far."""

    @property
    def skipped(self) -> int:
        """Parts that are whole and hold no message, so far."""

    @property
    def at(self) -> int:
        """Octets of the file that were read."""

    def messages(self) -> Iterator[Recorded]:
        """Those of the file, once."""


class RecordingWriter(Protocol):
    """Writes a recording to a file, which stays open."""

    def write(self, message: Recorded, /) -> str | None:
        """Write a message; in a few words why it cannot be held, or None."""

    def notes(self) -> list[str]:
        """Lines that say what was lost of messages that are in the file."""

    def close(self) -> None:
        """Write what is still to be written."""


@dataclass(frozen=True, slots=True)
class Recording:
    """A file that is open for reading."""

    reader: RecordingReader
    format: FileFormat
    octets: int


def format_of(path: Path) -> FileFormat:
    """Of a file that is there. Raises `PlotfeedError` if it cannot be told, and `OSError`."""
    with path.open("rb") as file:
        head = file.read(HEAD_OCTETS)
    found = format_of_content(head) or SUFFIXES.get(path.suffix.lower())
    if found is None:
        what = "its content is no recording that is known" if head else "it is empty"
        raise PlotfeedError(f"{path}: {what}, nor is its suffix one")
    return found


def format_of_suffix(path: Path) -> FileFormat:
    """Of a file that is to be written; raises `PlotfeedError`."""
    found = SUFFIXES.get(path.suffix.lower())
    if found is None:
        raise PlotfeedError(f"{path}: expected one of the suffixes {', '.join(SUFFIXES)}")
    return found


def format_of_content(head: bytes) -> FileFormat | None:
    """Of a file that begins with these octets; None if they tell none."""
    if head.startswith(MCAP_MAGIC):
        return FileFormat.MCAP
    if head[:4] in PCAP_FORMATS:
        return FileFormat.PCAP
    if head.startswith(SECTION):
        return FileFormat.PCAPNG
    if head.lstrip().startswith((b'{"', b"{ ")):
        return FileFormat.JSON
    if _is_final(head):
        return FileFormat.FINAL
    return FileFormat.RAW if _is_raw(head) else None


@contextmanager
def open_recording(
    path: Path, form: FileFormat | None = None, *, date_utc_ns: int = 0
) -> Iterator[Recording]:
    """A file, in the format that it is in unless another is said.

    `date_utc_ns` is midnight of the day on which a file without dates begins. Raises
    `PlotfeedError` if the format cannot be told or read, and `OSError`.
    """
    form = form or format_of(path)
    if form is FileFormat.CSV:
        raise PlotfeedError(f"{path}: {form} is only written")
    with path.open("rb") as file:
        yield Recording(_reader_of(file, form, date_utc_ns), form, path.stat().st_size)


class FileSource:
    """A file that is read as often as is asked for; arguments are those of `open_recording`."""

    def __init__(self, path: Path, form: FileFormat | None = None, *, date_utc_ns: int = 0) -> None:
        self._path = path
        self._form = form or format_of(path)
        self._date_utc_ns = date_utc_ns
        self.damage: list[Damage] = []
        """As the last pass has found it so far."""

    def messages(
        self, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Recorded]:
        """Messages in the order of the file, of log times from `start_ns` on, before `end_ns`."""
        with open_recording(self._path, self._form, date_utc_ns=self._date_utc_ns) as recording:
            self.damage = recording.reader.damage
            for message in recording.reader.messages():
                t_ns = message.log_time_ns
                if (start_ns is None or t_ns >= start_ns) and (end_ns is None or t_ns < end_ns):
                    yield message


def writer_to(file: BinaryIO, form: FileFormat) -> RecordingWriter:
    """Writes that format to a file; raises `PlotfeedError` for one that is only read."""
    if form is FileFormat.CSV:
        from plotfeed.replay.plots_csv import PlotsCsvWriter

        return PlotsCsvWriter(file)
    if form is FileFormat.MCAP:
        from plotfeed.replay.mcap.log_format import (
            McapWriter,
        )

        return McapWriter(file)
    if form not in _WRITERS:
        raise PlotfeedError(f"{form} is only read; pcap holds the same")
    return _WRITERS[form](file)


_READERS: Mapping[FileFormat, Callable[[BinaryIO, int], RecordingReader]] = {
    FileFormat.PCAP: lambda file, _: PcapReader(file),
    FileFormat.PCAPNG: lambda file, _: PcapngReader(file),
    FileFormat.FINAL: lambda file, date_utc_ns: FinalReader(file, date_utc_ns=date_utc_ns),
    FileFormat.RAW: lambda file, date_utc_ns: RawReader(file, date_utc_ns=date_utc_ns),
    FileFormat.JSON: lambda file, _: JsonLinesReader(file),
}
_WRITERS: Mapping[FileFormat, Callable[[BinaryIO], RecordingWriter]] = {
    FileFormat.PCAP: PcapWriter,
    FileFormat.FINAL: FinalWriter,
    FileFormat.RAW: RawWriter,
    FileFormat.JSON: JsonLinesWriter,
}


def _reader_of(file: BinaryIO, form: FileFormat, date_utc_ns: int) -> RecordingReader:
    if form is FileFormat.MCAP:
        from plotfeed.replay.mcap.log_format import (
            McapReader,
        )

        return McapReader(file)
    return _READERS[form](file, date_utc_ns)


def _is_final(head: bytes) -> bool:
    length = int.from_bytes(head[:2], "big")
    return length >= 12 and head[length - 4 : length] == TRAILER


def _is_raw(head: bytes) -> bool:
    """Whether blocks lie back to back: as many as are looked at, or to the end, or two at least."""
    at = whole = 0
    while whole < BLOCKS_LOOKED_AT and at < len(head):
        length = int.from_bytes(head[at + 1 : at + HEADER_OCTETS], "big")
        if at + HEADER_OCTETS > len(head) or not head[at] or length <= HEADER_OCTETS:
            return False
        at += length
        whole += at <= len(head)
    return whole > 0 and (at <= len(head) or whole > 1 or len(head) == HEAD_OCTETS)
