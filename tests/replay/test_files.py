from __future__ import annotations

import base64
import gzip
import io
import json
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.recordings import (
    MESSAGES,
    START_NS,
    block,
    block_048,
    is_read_whatever_it_is,
    message,
    plots,
    read,
    written,
)

from plotfeed.feeds.recording.foreign_recordings import ForeignReader
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay import files
from plotfeed.replay.asterix_files import FinalReader, RawReader
from plotfeed.replay.files import (
    MOST_UNPACKED,
    SPARE_OCTETS,
    SUFFIXES,
    FileFormat,
    JsonLinesReader,
    JsonLinesWriter,
    UnpackedFile,
    format_of,
    format_of_content,
    format_of_suffix,
    writer_to,
)
from plotfeed.replay.pcap import COOKED, ETHERNET, NULL, RAW, PcapReader, frame, ns_header
from plotfeed.replay.recorded import Recorded, RecordingReader

PCAPNG = struct.pack("<IIIHHqI", 0x0A0D0D0A, 28, 0x1A2B3C4D, 1, 0, -1, 28)
BOTH_WAYS = (FileFormat.MCAP, FileFormat.PCAP, FileFormat.FINAL, FileFormat.RAW, FileFormat.JSON)


def data_of(form: FileFormat, messages: list[Recorded] | None = None) -> bytes:
    if form is FileFormat.PCAPNG:
        return PCAPNG
    return written(lambda file: writer_to(file, form), messages or plots(3))


def file_of(folder: Path, data: bytes, name: str = "file") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


LINES = [message(b"\1\2", 7, topic="t", properties=(("a", "b"),), content_type="c")] * 2


def capture(link_type: int) -> bytes:
    """Packets of either IP."""
    header, data = ns_header(link_type), ns_header(link_type).octets
    for here, there in ((bytes(4), bytes([239, 1, 2, 3])), (bytes(16), b"\xff" * 16)):
        packet = frame(link_type, (here, 4000), (there, 8600), block_048(43_200))
        data += header.record.pack(1, 0, len(packet), len(packet)) + packet
    return data


DAMAGED: dict[str, tuple[Callable[[io.BytesIO], RecordingReader], bytes]] = {
    "raw": (RawReader, b"".join(each.payload for each in plots(4)) + block(250, "00" * 20)),
    "final": (FinalReader, data_of(FileFormat.FINAL, plots(4))),
    "jsonl": (JsonLinesReader, data_of(FileFormat.JSON, LINES)),
    **{f"pcap {kind}": (PcapReader, capture(kind)) for kind in (NULL, ETHERNET, RAW, COOKED)},
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_file_that_is_cut_or_turned_anywhere_is_read_as_far_as_it_is_whole(name: str) -> None:
    # A line is whole without its end.
    is_read_whatever_it_is(*DAMAGED[name], other_parts=2 if name == "jsonl" else 0)


@pytest.mark.parametrize("form", [*BOTH_WAYS, FileFormat.PCAPNG])
def test_content_tells_the_format_whatever_the_suffix(form: FileFormat, tmp_path: Path) -> None:
    for name in ("file", "file.ast", "file.pcap", "file.csv"):
        assert format_of(file_of(tmp_path, data_of(form), name)) is form


def test_the_suffix_tells_what_content_does_not(tmp_path: Path) -> None:
    for suffix, form in SUFFIXES.items():
        for data in (b"", b"\0\1\2"):
            assert format_of(file_of(tmp_path, data, f"file{suffix}")) is form
            assert format_of(file_of(tmp_path, data, f"file{suffix.upper()}")) is form
        assert format_of(file_of(tmp_path, gzip.compress(b""), f"file{suffix}.gz")) is form
        assert format_of_suffix(Path(f"x{suffix}")) is form


def test_raw_files_are_told_by_their_first_blocks_which_a_suffix_outweighs(tmp_path: Path) -> None:
    blocks = block_048(1) + block(34, "c0", "190d", "01")
    for data in (blocks, blocks * 10_000, blocks + b"\x30\xff\xff"):
        assert format_of_content(data) is FileFormat.RAW
    for data in (blocks[:-1], block_048(1) + b"\x30\0\2\0"):
        assert format_of_content(data) is None
    nobody_s = block(222, "00") * 3  # whose lengths may fit by chance
    assert format_of(file_of(tmp_path, nobody_s)) is FileFormat.RAW
    assert format_of(file_of(tmp_path, nobody_s, "file.ff")) is FileFormat.FINAL
    assert format_of(file_of(tmp_path, nobody_s, "file.csv")) is FileFormat.RAW
    assert format_of(file_of(tmp_path, block_048(1), "file.ff")) is FileFormat.RAW


def test_what_has_no_format_or_only_one_way_is_an_error(tmp_path: Path) -> None:
    path = file_of(tmp_path, b"hello, this is no recording")
    with pytest.raises(PlotfeedError, match=f"{path}: its content is no recording"):
        format_of(path)
    with pytest.raises(PlotfeedError, match="it is empty"):
        format_of(file_of(tmp_path, b""))
    with pytest.raises(PlotfeedError, match="expected one of the suffixes"):
        format_of_suffix(Path("x.txt"))
    with pytest.raises(PlotfeedError, match="pcapng is only read"):
        writer_to(io.BytesIO(), FileFormat.PCAPNG)
    for data, name, why in (
        (data_of(FileFormat.CSV), "plots.csv", "csv is only written"),
        (gzip.compress(data_of(FileFormat.MCAP)), "log.mcap.gz", "gunzip it first"),
    ):
        with pytest.raises(PlotfeedError, match=why), ForeignReader(file_of(tmp_path, data, name)):
            pass


@pytest.mark.parametrize("form", [FileFormat.PCAP, FileFormat.MCAP])
def test_a_recording_is_read_again_and_in_parts(tmp_path: Path, form: FileFormat) -> None:
    source = ForeignReader(file_of(tmp_path, data_of(form)))
    whole = list(source.messages(None, None))
    assert len(whole) == 3
    _, second, third = (each.log_time_ns for each in whole)
    for start_ns, end_ns, which in (
        (None, None, slice(None)),
        (second, None, slice(1, None)),
        (None, second, slice(1)),
        (second, third, slice(1, 2)),
    ):
        assert list(source.messages(start_ns, end_ns)) == whole[which]
    assert source.damage == []


@settings(max_examples=50)
@given(st.lists(MESSAGES, max_size=3))
def test_everything_that_a_message_has_comes_back(messages: list[Recorded]) -> None:
    data = written(JsonLinesWriter, messages)
    assert len(data.splitlines()) == len(messages)
    got, reader = read(JsonLinesReader, data)
    assert got == messages
    assert reader.damage == []
    assert reader.at == len(data)


def test_a_line_is_an_object_with_the_fields_by_name_of_which_three_are_enough() -> None:
    (least,), reader = read(
        JsonLinesReader, b'\n{"topic": "t", "payload_base64": "", "log_time_ns": 7}'
    )
    assert least == message(b"", 7, topic="t", content_type="")
    assert reader.damage == []
    (one,) = plots(1)
    (line,) = written(JsonLinesWriter, [one]).splitlines()
    fields = json.loads(line)
    assert base64.b64decode(fields.pop("payload_base64")) == one.payload
    assert fields == {
        "topic": "plotfeed/radar/asterix/048",
        "log_time_ns": START_NS,
        "publish_time_ns": START_NS,
        "stage": "received",
        "content_type": "application/x-asterix; cat=48",
        "properties": [],
        "retain": False,
        "qos": 0,
    }


GOOD = {"topic": "t", "payload_base64": "AAAA", "log_time_ns": 7}


@pytest.mark.parametrize(
    ("line", "what"),
    [
        (b"[]", "a line that is no JSON object"),
        (b"{", "a line that is no JSON"),
        (b"\xff\xfe{}", "a line that is no JSON"),
        (b"[" * 100_000, "a line that is no JSON"),
        (b"9" * 10_000, "a line that is no JSON"),
        ({"topic": 7}, "topic: expected a text"),
        ({"topic": "\ud800"}, "topic: half of a surrogate pair is no character"),
        ({"payload_base64": "A"}, "payload_base64: expected base64"),
        ({"payload_base64": "é==="}, "payload_base64: expected base64"),
        ({"payload_base64": None}, "payload_base64: expected a text"),
        ({"log_time_ns": -1}, "log_time_ns: expected nanoseconds since 1970, up to 2554"),
        ({"log_time_ns": 1.5}, "log_time_ns: expected nanoseconds since 1970, up to 2554"),
        ({"log_time_ns": True}, "log_time_ns: expected nanoseconds since 1970, up to 2554"),
        ({"publish_time_ns": None}, "publish_time_ns: expected nanoseconds since 1970, up to 2554"),
        ({"log_time_ns": 1 << 64}, "log_time_ns: expected nanoseconds since 1970, up to 2554"),
        ({"qos": 3}, "qos: expected one of 0, 1, 2"),
        ({"qos": True}, "qos: expected one of 0, 1, 2"),
        ({"retain": 1}, "retain: expected one of False, True"),
        ({"stage": "x"}, "stage: expected one of telemetry, before, after, received"),
        ({"stage": ["x"]}, "stage: expected one of telemetry, before, after, received"),
        ({"properties": {}}, "properties: expected a list of pairs"),
        ({"properties": [["a"]]}, "properties: expected a list of pairs"),
        ({"properties": [["a", 1]]}, "properties: expected a text"),
        ({"content_type": None}, "content_type: expected a text"),
    ],
)
def test_a_line_that_is_no_message_is_damage_and_the_next_is_read(
    line: bytes | dict[str, object], what: str
) -> None:
    if isinstance(line, dict):
        line = json.dumps(GOOD | line).encode()
    good = json.dumps(GOOD).encode() + b"\n"
    messages, reader = read(JsonLinesReader, good + line + b"\n" + good)
    assert len(messages) == 2
    assert [(each.offset, each.what) for each in reader.damage] == [(len(good), what)]


def test_a_line_without_end_is_damage_and_the_next_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "MAX_LINE_OCTETS", 100)
    good = json.dumps(GOOD).encode() + b"\n"
    long = json.dumps(GOOD | {"topic": "t" * 250}).encode() + b"\n"
    messages, reader = read(JsonLinesReader, good + long + good)
    assert len(messages) == 2
    assert [each.offset for each in reader.damage] == [len(good)]
    assert reader.at == len(good) * 2 + len(long)


def read_file(path: Path) -> tuple[list[Recorded], list[str]]:
    with ForeignReader(path) as recording:
        return list(recording.messages()), [each.what for each in recording.damage]


def unpacked(packed: bytes) -> tuple[int, list[str], bytes]:
    """How many octets come out, what is said of them, and the first."""
    raw, told, octets, first = UnpackedFile(io.BytesIO(packed)), list[str](), 0, b""
    raw.on_damage = lambda _, what: told.append(what)
    with io.BufferedReader(raw, 1 << 18) as file:
        while piece := file.read(1 << 18):
            octets, first = octets + len(piece), first or piece
    return octets, told, first


@pytest.mark.parametrize(
    "form", [FileFormat.PCAP, FileFormat.FINAL, FileFormat.RAW, FileFormat.JSON]
)
def test_a_packed_file_is_read_as_if_it_were_not(form: FileFormat, tmp_path: Path) -> None:
    data = data_of(form, plots(50))
    plain = file_of(tmp_path, data, "plain")
    packed = file_of(tmp_path, gzip.compress(data), "packed.gz")
    assert format_of(packed) is form
    source = ForeignReader(packed)
    for _ in range(2):
        assert (list(source.messages(None, None)), []) == read_file(plain)


@given(st.lists(st.binary(max_size=300), max_size=4), st.integers(0, 20))
def test_members_and_zeros_behind_them(parts: list[bytes], zeros: int) -> None:
    packed = b"".join(map(gzip.compress, parts))
    if parts:
        content = b"".join(parts)
        assert unpacked(packed + bytes(zeros)) == (len(content), [], content)


def test_what_is_cut_off_or_broken_is_told_behind_what_is_whole(tmp_path: Path) -> None:
    packed = gzip.compress(data_of(FileFormat.RAW, plots(2000)))
    path = file_of(tmp_path, packed[: len(packed) // 2], "cut.ast.gz")
    messages, damage = read_file(path)
    assert 100 < len(messages) < 2000
    assert "what gzip packed is cut off" in damage
    path.write_bytes(packed[:-6] + b"\0\0" + packed[-4:])
    messages, damage = read_file(path)
    (told,) = damage
    assert told.startswith("what gzip packed is broken: CRC check failed")


def test_a_small_file_does_not_become_a_machine_s_memory() -> None:
    bomb = gzip.compress(bytes(1 << 26))
    tracemalloc.start()
    octets, told, _ = unpacked(bomb)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert octets <= MOST_UNPACKED * len(bomb) + SPARE_OCTETS
    assert told == [f"it would grow to more than {MOST_UNPACKED} times its octets"]
    assert peak < 4 << 20
