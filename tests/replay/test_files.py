from __future__ import annotations

import io
import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.given_recordings import CAPTURES, FRAMES
from support.recordings import block, block_048, is_read_whatever_it_is, message, plots, written

from plotfeed.feeds.recording.foreign_recordings import RecordingFile, open_recording
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.asterix_files import FinalReader, RawReader
from plotfeed.replay.files import (
    FORMATS,
    SUFFIXES,
    FileFormat,
    JsonLinesReader,
    format_of,
    format_of_content,
    format_of_suffix,
    writer_to,
)
from plotfeed.replay.pcap import COOKED, ETHERNET, NULL, RAW, PcapReader, frame, ns_header
from plotfeed.replay.recorded import Recorded, RecordingReader, Stage

PCAPNG = struct.pack("<IIIHHqI", 0x0A0D0D0A, 28, 0x1A2B3C4D, 1, 0, -1, 28)
BOTH_WAYS = (FileFormat.MCAP, FileFormat.PCAP, FileFormat.FINAL, FileFormat.RAW, FileFormat.JSON)


def data_of(form: FileFormat, messages: list[Recorded] | None = None) -> bytes:
    if form is FileFormat.PCAPNG:
        return PCAPNG
    return written(lambda file: writer_to(file, form), messages or plots(3))


def stored(folder: Path, data: bytes, name: str = "file") -> Path:
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
        assert format_of(stored(tmp_path, data_of(form), name)) is form


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_suffix_tells_what_content_does_not(suffix: str, tmp_path: Path) -> None:
    for data in (b"", b"\0\1\2"):
        assert format_of(stored(tmp_path, data, f"file{suffix}")) is SUFFIXES[suffix]
        assert format_of(stored(tmp_path, data, f"file{suffix.upper()}")) is SUFFIXES[suffix]
    assert format_of_suffix(Path(f"x{suffix}")) is SUFFIXES[suffix]


def test_what_neither_tells_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    path = stored(tmp_path, b"hello, this is no recording")
    with pytest.raises(PlotfeedError, match=f"{path}: its content is no recording"):
        format_of(path)
    with pytest.raises(PlotfeedError, match="it is empty"):
        format_of(stored(tmp_path, b""))
    with pytest.raises(PlotfeedError, match="expected one of the suffixes"):
        format_of_suffix(Path("x.txt"))


def test_raw_files_are_told_by_their_first_blocks() -> None:
    blocks = block_048(1) + block(34, "c0", "190d", "01")
    assert format_of_content(blocks) is FileFormat.RAW
    assert format_of_content(blocks * 10_000) is FileFormat.RAW
    assert format_of_content(blocks + b"\x30\xff\xff") is FileFormat.RAW
    assert format_of_content(blocks[:-1]) is None
    assert format_of_content(block_048(1) + b"\x30\0\2\0") is None


def test_a_suffix_outweighs_lengths_that_fit_by_chance(tmp_path: Path) -> None:
    nobody_s = block(222, "00") * 3
    assert format_of(stored(tmp_path, nobody_s)) is FileFormat.RAW
    assert format_of(stored(tmp_path, nobody_s, "file.ff")) is FileFormat.FINAL
    assert format_of(stored(tmp_path, nobody_s, "file.csv")) is FileFormat.RAW
    assert format_of(stored(tmp_path, block_048(1), "file.ff")) is FileFormat.RAW


@given(st.binary(max_size=100))
def test_any_content_has_a_format_or_none(head: bytes) -> None:
    found = format_of_content(head)
    assert found is None or found in FileFormat


@pytest.mark.parametrize("form", BOTH_WAYS)
def test_what_is_written_is_read_by_the_reader_that_its_content_asks_for(
    form: FileFormat, tmp_path: Path
) -> None:
    path = stored(tmp_path, data_of(form))
    with open_recording(path, date_utc_ns=1_767_225_600_000_000_000) as recording:
        assert recording.format is form
        assert recording.octets == path.stat().st_size
        got = list(recording.reader.messages())
        assert (recording.reader.damage, recording.reader.skipped) == ([], 0)
        assert 0 <= recording.reader.at <= recording.octets
    assert [each.payload for each in got] == [each.payload for each in plots(3)]
    if FORMATS[form].has_dates:
        assert [each.log_time_ns for each in got] == [each.log_time_ns for each in plots(3)]


def test_the_format_can_be_said(tmp_path: Path) -> None:
    path = stored(tmp_path, block_048(1), "odd.pcap")
    with open_recording(path, FileFormat.PCAP) as recording:
        assert list(recording.reader.messages()) == []
        assert recording.reader.damage != []


def test_a_table_of_plots_is_not_read_and_pcapng_is_not_written(tmp_path: Path) -> None:
    path = stored(tmp_path, data_of(FileFormat.CSV), "plots.csv")
    with pytest.raises(PlotfeedError, match="csv is only written"), open_recording(path):
        pass
    with pytest.raises(PlotfeedError, match="pcapng is only read"):
        writer_to(io.BytesIO(), FileFormat.PCAPNG)


def test_recordings_of_others_are_told_by_their_content() -> None:
    assert {format_of(each.path) for each in CAPTURES} == {FileFormat.PCAP}
    assert {format_of_content(path.read_bytes()) for path in FRAMES} == {FileFormat.FINAL}


@pytest.mark.parametrize("form", [FileFormat.PCAP, FileFormat.MCAP])
def test_a_recording_is_read_again_and_in_parts(tmp_path: Path, form: FileFormat) -> None:
    source = RecordingFile(stored(tmp_path, data_of(form)))
    whole = list(source.messages(None, None))
    times_ns = [each.log_time_ns for each in whole]
    assert len(whole) == 3
    assert list(source.messages(None, None)) == whole
    assert list(source.messages(times_ns[1], None)) == whole[1:]
    assert list(source.messages(None, times_ns[1])) == whole[:1]
    assert list(source.messages(times_ns[1], times_ns[2])) == whole[1:2]
    assert source.damage == []


def test_mcap_keeps_all_that_a_message_has(tmp_path: Path) -> None:
    sent = [
        message(b"\1", 5, topic="a", publish_time_ns=4, properties=(("k", "v"),), qos=1),
        message(b"\2", 6, topic="a", retain=True, stage=Stage.BEFORE, content_type=""),
    ]
    with open_recording(stored(tmp_path, data_of(FileFormat.MCAP, sent))) as recording:
        assert list(recording.reader.messages()) == sent


def test_what_mcap_cannot_hold_is_told() -> None:
    writer = writer_to(io.BytesIO(), FileFormat.MCAP)
    reason = writer.write(message(b"", -1))
    assert reason is not None
    assert "1970" in reason
