"""The formats of recordings: how each is told, read and written, what it holds; and gzip."""

from __future__ import annotations

import base64
import gzip
import io
import json
import os
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol

from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.replay.asterix_files import (
    KNOWN_CATEGORIES,
    TRAILER,
    FinalReader,
    FinalWriter,
    RawReader,
    RawWriter,
    categories,
)
from plotfeed.replay.pcap import FORMATS as PCAP_FORMATS
from plotfeed.replay.pcap import SECTION, PcapngReader, PcapReader, PcapWriter
from plotfeed.replay.recorded import (
    CHUNK_OCTETS,
    LATEST_NS,
    Damage,
    Recorded,
    RecordingReader,
    RecordingWriter,
    Stage,
    TableName,
)

if TYPE_CHECKING:
    from plotfeed.replay.plots_csv import Selection


MAX_LINE_OCTETS = 1 << 26


def to_json(message: Recorded) -> str:
    """One line, without its end; keys are the fields of `Recorded`, the payload is base64."""
    return json.dumps(
        {
            "topic": message.topic,
            "log_time_ns": message.log_time_ns,
            "publish_time_ns": message.publish_time_ns,
            "stage": str(message.stage),
            "content_type": message.content_type,
            "properties": message.properties,
            "retain": message.retain,
            "qos": message.qos,
            "payload_base64": base64.b64encode(message.payload).decode("ascii"),
        }
    )


def from_json(line: bytes) -> Recorded:
    """The message of a line, with at least topic, payload and log time; raises `DecodeError`."""
    try:
        fields = json.loads(line)
    except (ValueError, RecursionError):
        raise DecodeError("a line that is no JSON") from None
    if not isinstance(fields, dict):
        raise DecodeError("a line that is no JSON object")
    log_time_ns = _time(fields, "log_time_ns")
    due = "publish_time_ns" in fields
    try:
        encoded = _text(fields.get("payload_base64"), "payload_base64")
        payload = base64.b64decode(encoded, validate=True)
    except ValueError:
        raise DecodeError("payload_base64: expected base64") from None
    return Recorded(
        topic=_text(fields.get("topic"), "topic"),
        payload=payload,
        log_time_ns=log_time_ns,
        publish_time_ns=_time(fields, "publish_time_ns") if due else log_time_ns,
        content_type=_text(fields.get("content_type", ""), "content_type"),
        properties=_properties(fields.get("properties", [])),
        retain=bool(_one_of(fields.get("retain", False), "retain", (False, True))),
        qos=int(_one_of(fields.get("qos", 0), "qos", (0, 1, 2))),
        stage=Stage(_one_of(fields.get("stage", "received"), "stage", tuple(map(str, Stage)))),
    )


class JsonLinesReader(RecordingReader):
    """The messages of a file. A line that is none is damage, and the next one is read."""

    at = 0

    def __init__(self, file: BinaryIO) -> None:
        super().__init__()
        self._file = file

    def messages(self) -> Iterator[Recorded]:
        """The message of each line that is not blank."""
        while line := self._file.readline(MAX_LINE_OCTETS):
            begin = self.at
            self.at += len(line)
            if len(line) == MAX_LINE_OCTETS and not line.endswith(b"\n"):
                self.damage.add(begin, f"a line of more than {MAX_LINE_OCTETS} octets")
                while line and not line.endswith(b"\n"):
                    line = self._file.readline(MAX_LINE_OCTETS)
                    self.at += len(line)
                continue
            if line.isspace():
                continue
            try:
                message = from_json(line)
            except DecodeError as error:
                self.damage.add(begin, str(error))
                continue
            yield message


class JsonLinesWriter(RecordingWriter):
    """Everything that a message has, a line each."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def write(self, message: Recorded) -> str | None:
        """Write a message; nothing cannot be held."""
        self._file.write(to_json(message).encode("ascii") + b"\n")
        return None


def _time(fields: dict[str, Any], name: str) -> int:
    value = fields.get(name)
    if type(value) is not int or not 0 <= value <= LATEST_NS:
        raise DecodeError(f"{name}: expected nanoseconds since 1970, up to 2554")
    return value


def _text(value: Any, name: str) -> str:
    if not isinstance(value, str):
        raise DecodeError(f"{name}: expected a text")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise DecodeError(f"{name}: half of a surrogate pair is no character") from None
    return value


def _properties(value: Any) -> tuple[tuple[str, str], ...]:
    if not isinstance(value, list) or any(
        not isinstance(pair, list) or len(pair) != 2 for pair in value
    ):
        raise DecodeError("properties: expected a list of pairs")
    return tuple((_text(key, "properties"), _text(text, "properties")) for key, text in value)


def _one_of(value: Any, name: str, allowed: tuple[Any, ...]) -> Any:
    if type(value) is not type(allowed[0]) or value not in allowed:
        raise DecodeError(f"{name}: expected one of {', '.join(map(str, allowed))}")
    return value


MAGIC = b"\x1f\x8b"
# Octets of content for each of a file's that was read, and in any case; as for chunks of MCAP.
MOST_UNPACKED, SPARE_OCTETS = 256, 1 << 20
_SIZE_OCTETS = 4


class UnpackedFile(io.RawIOBase):
    """The content of a file that gzip packed, in one or more members, from its start to its end.

    It ends where the packed octets are broken, cut off, or grow too much, and `on_damage` is
    called with the octet of the file and what is wrong.
    """

    def __init__(self, packed: BinaryIO) -> None:
        super().__init__()
        self.on_damage: Callable[[int, str], None] = lambda _at, _what: None
        self._packed = packed
        self._content = gzip.GzipFile(fileobj=packed)
        self._octets = 0
        self._ended = False

    def readable(self) -> bool:
        """Whether it can be read."""
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        """Fill the beginning of a buffer; 0 at the end."""
        if self._ended:
            return 0
        try:
            piece = self._content.read1(len(buffer))
        except EOFError:
            return self._end("what gzip packed is cut off")
        except (gzip.BadGzipFile, zlib.error) as error:
            return self._end(f"what gzip packed is broken: {error}")
        self._octets += len(piece)
        if self._octets > SPARE_OCTETS + MOST_UNPACKED * self._packed.tell():
            return self._end(f"it would grow to more than {MOST_UNPACKED} times its octets")
        buffer[: len(piece)] = piece
        return len(piece)

    def _end(self, what: str) -> int:
        self._ended = True
        self.on_damage(self._packed.tell(), what)
        return 0


@contextmanager
def unpacked(file: BinaryIO) -> Iterator[tuple[BinaryIO, UnpackedFile | None]]:
    """A file for reading, and what unpacks it if gzip packed it.

    Of a pipe nothing is read here: whoever writes to it may be slow to begin.
    """
    if not file.seekable():
        yield file, None
        return
    is_packed = file.read(len(MAGIC)) == MAGIC
    file.seek(0)
    if not is_packed:
        yield file, None
        return
    content = UnpackedFile(file)
    with io.BufferedReader(content, CHUNK_OCTETS) as buffered:
        yield buffered, content


def unpacked_octets(file: BinaryIO) -> int:
    """The octets that the last member of a packed file says it has; modulo 4 GiB, or its own.

    The file is read from its start afterwards.
    """
    size = file.seek(0, io.SEEK_END)
    file.seek(max(size - _SIZE_OCTETS, 0))
    told = int.from_bytes(file.read(_SIZE_OCTETS), "little")
    file.seek(0)
    return max(size, told)


MCAP_MAGIC = b"\x89MCAP"
HEAD_OCTETS = 1 << 16
BLOCKS_LOOKED_AT = 8


class FileFormat(StrEnum):
    """The formats of recordings."""

    MCAP = "mcap"
    PCAP = "pcap"
    PCAPNG = "pcapng"
    FINAL = "final"
    RAW = "raw"
    JSON = "jsonl"
    CSV = "csv"
    PARQUET = "parquet"


@dataclass(frozen=True, slots=True, kw_only=True)
class FormatFacts:
    """What a format is like."""

    suffixes: tuple[str, ...]
    # Whether files of the format begin with these octets.
    begins: Callable[[bytes], bool] = lambda _: False
    # Reads a file whose first day begins at that time, UTC in ns; None if it is only written.
    reader: Callable[[BinaryIO, int], RecordingReader] | None = None
    # Writes one, of that table or selection of plots if it holds such; None if it is only read.
    writer: Callable[[BinaryIO, TableName, Selection | None], RecordingWriter] | None = None
    has_dates: bool = True  # Whether there is more than times of day
    holds_stages: bool = False  # Whether messages before their link stand beside those after it


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


def _mcap_reader(file: BinaryIO, _date_utc_ns: int) -> RecordingReader:
    from plotfeed.replay.mcap import McapReader

    return McapReader(file)


def _mcap_writer(file: BinaryIO, *_: object) -> RecordingWriter:
    from plotfeed.replay.mcap import McapWriter

    return McapWriter(file)


def _csv_writer(file: BinaryIO, _table: TableName, select: Selection | None) -> RecordingWriter:
    from plotfeed.replay.plots_csv import PlotsCsvWriter

    return PlotsCsvWriter(file, select)


def _parquet_writer(file: BinaryIO, table: TableName, select: Selection | None) -> RecordingWriter:
    try:
        from plotfeed.replay.parquet_tables import ParquetWriter
    except ModuleNotFoundError as error:
        if str(error.name).partition(".")[0] != "pyarrow":
            raise
        raise PlotfeedError("Parquet needs pyarrow: pip install 'plotfeed[parquet]'") from None
    return ParquetWriter(file, table, select)


# In the order in which a file's beginning is tried: lines of JSON can look like raw blocks.
FORMATS: Mapping[FileFormat, FormatFacts] = {
    FileFormat.MCAP: FormatFacts(
        suffixes=(".mcap",),
        begins=lambda head: head.startswith(MCAP_MAGIC),
        reader=_mcap_reader,
        writer=_mcap_writer,
        holds_stages=True,
    ),
    FileFormat.PCAP: FormatFacts(
        suffixes=(".pcap", ".cap"),
        begins=lambda head: head[:4] in PCAP_FORMATS,
        reader=lambda file, _: PcapReader(file),
        writer=lambda file, *_: PcapWriter(file),
    ),
    FileFormat.PCAPNG: FormatFacts(
        suffixes=(".pcapng", ".ntar"),
        begins=lambda head: head.startswith(SECTION),
        reader=lambda file, _: PcapngReader(file),
    ),
    FileFormat.JSON: FormatFacts(
        suffixes=(".jsonl", ".ndjson"),
        begins=lambda head: head.lstrip().startswith((b'{"', b"{ ")),
        reader=lambda file, _: JsonLinesReader(file),
        writer=lambda file, *_: JsonLinesWriter(file),
        holds_stages=True,
    ),
    FileFormat.FINAL: FormatFacts(
        suffixes=(".ff", ".final"),
        begins=_is_final,
        reader=lambda file, date_utc_ns: FinalReader(file, date_utc_ns=date_utc_ns),
        writer=lambda file, *_: FinalWriter(file),
        has_dates=False,
    ),
    FileFormat.RAW: FormatFacts(
        suffixes=(".ast", ".asterix", ".raw"),
        begins=_is_raw,
        reader=lambda file, date_utc_ns: RawReader(file, date_utc_ns=date_utc_ns),
        writer=lambda file, *_: RawWriter(file),
        has_dates=False,
    ),
    FileFormat.CSV: FormatFacts(suffixes=(".csv",), writer=_csv_writer),
    FileFormat.PARQUET: FormatFacts(
        suffixes=(".parquet",), begins=lambda head: head.startswith(b"PAR1"), writer=_parquet_writer
    ),
}
SUFFIXES = {suffix: form for form in FileFormat for suffix in FORMATS[form].suffixes}


def format_of(path: Path) -> FileFormat:
    """The format of a file. Raises `PlotfeedError` if it cannot be told, and `OSError`."""
    with path.open("rb") as file, unpacked(file) as (content, packed):
        head = content.read(HEAD_OCTETS)
    suffix = path.with_suffix("").suffix if packed else path.suffix
    found, named = format_of_content(head), SUFFIXES.get(suffix.lower())
    # Lengths may fit by chance, of categories that nobody has.
    is_guess = found is FileFormat.RAW and not KNOWN_CATEGORIES.issuperset(categories(head))
    if found is None or (is_guess and named and FORMATS[named].reader):
        found = named
    if found is None:
        what = "its content is no recording that is known" if head else "it is empty"
        raise PlotfeedError(f"{path}: {what}, nor is its suffix one")
    return found


def format_of_content(head: bytes) -> FileFormat | None:
    """The format of a file that begins with these octets; None if they tell none."""
    return next((form for form, facts in FORMATS.items() if facts.begins(head)), None)


def format_of_suffix(path: Path) -> FileFormat:
    """The format of a file that is to be written; raises `PlotfeedError`."""
    found = SUFFIXES.get(path.suffix.lower())
    if found is None:
        raise PlotfeedError(f"{path}: expected one of the suffixes {', '.join(SUFFIXES)}")
    return found


def writer_to(
    file: BinaryIO,
    form: FileFormat,
    table: TableName = TableName.PLOTS,
    select: Selection | None = None,
) -> RecordingWriter:
    """Writes that format to a file; raises `PlotfeedError` for one that is only read.

    `table` is for Parquet, which holds one; `select` takes plots for a table of them.
    """
    writer = FORMATS[form].writer
    if writer is None:
        raise PlotfeedError(f"{form} is only read; pcap holds the same")
    return writer(file, table, select)


@contextmanager
def reading(
    file: BinaryIO, form: FileFormat, date_utc_ns: int = 0
) -> Iterator[tuple[RecordingReader, int]]:
    """A reader of a file that is open, in that format, from its start; and the file's octets.

    Of a file that gzip packed, they are those of its content. `date_utc_ns` is midnight of the day
    on which a file without dates begins. Raises `PlotfeedError` if the format cannot be read, and
    `OSError`.
    """
    reader = FORMATS[form].reader
    if reader is None:
        raise PlotfeedError(f"{form} is only written")
    octets = os.fstat(file.fileno()).st_size
    with unpacked(file) as (content, packed):
        if packed:
            if form is FileFormat.MCAP:
                raise PlotfeedError(
                    "an MCAP file is read by its index, not from gzip: gunzip it first"
                )
            octets = unpacked_octets(file)
        opened = reader(content, date_utc_ns)
        if packed:
            packed.on_damage = opened.damage.add
        yield opened, octets


class RepeatableRecording(Protocol):
    """A recording that is read as often as is asked for, and from any time on."""

    @property
    def damage(self) -> Sequence[Damage]:
        """Damages, as the last pass has found them so far."""

    def messages(self, start_ns: int | None, end_ns: int | None) -> Iterator[Recorded]:
        """Messages of log times from `start_ns` on and before `end_ns`."""
