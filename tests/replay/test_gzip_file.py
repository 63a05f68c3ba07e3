from __future__ import annotations

import gzip
import io
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.recordings import plots, written

from plotfeed.feeds.recording.foreign_recordings import RecordingFile, open_recording
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.files import (
    MOST_UNPACKED,
    SPARE_OCTETS,
    FileFormat,
    UnpackedFile,
    format_of,
    writer_to,
)
from plotfeed.replay.recorded import Recorded


def data_of(form: FileFormat, count: int = 50) -> bytes:
    return written(lambda file: writer_to(file, form), plots(count))


def read(path: Path) -> tuple[list[Recorded], list[str]]:
    with open_recording(path) as recording:
        return list(recording.reader.messages()), [each.what for each in recording.reader.damage]


def unpacked(packed: bytes) -> tuple[bytes, list[str]]:
    raw = UnpackedFile(io.BytesIO(packed))
    told: list[str] = []
    raw.on_damage = lambda _, what: told.append(what)
    with io.BufferedReader(raw) as file:
        return file.read(), told


@pytest.mark.parametrize(
    "form", [FileFormat.PCAP, FileFormat.FINAL, FileFormat.RAW, FileFormat.JSON]
)
def test_a_packed_file_is_read_as_if_it_were_not(form: FileFormat, tmp_path: Path) -> None:
    plain, packed = tmp_path / "plain", tmp_path / "packed.gz"
    plain.write_bytes(data_of(form))
    packed.write_bytes(gzip.compress(data_of(form)))
    assert format_of(packed) is form
    assert read(packed) == read(plain)
    source = RecordingFile(packed)
    assert list(source.messages(None, None)) == list(source.messages(None, None)) != []


def test_the_suffix_before_gz_tells_what_content_does_not(tmp_path: Path) -> None:
    path = tmp_path / "empty.pcap.gz"
    path.write_bytes(gzip.compress(b""))
    assert format_of(path) is FileFormat.PCAP


@given(st.lists(st.binary(max_size=300), max_size=4), st.integers(0, 20))
def test_members_and_zeros_behind_them(parts: list[bytes], zeros: int) -> None:
    packed = b"".join(map(gzip.compress, parts))
    if parts:
        assert unpacked(packed + bytes(zeros)) == (b"".join(parts), [])


@given(st.binary(max_size=200))
def test_whatever_follows_the_magic_is_octets_or_damage(rest: bytes) -> None:
    unpacked(b"\x1f\x8b\x08\0" + rest)


def test_what_is_cut_off_or_broken_is_told_behind_what_is_whole(tmp_path: Path) -> None:
    packed = gzip.compress(data_of(FileFormat.RAW, 2000))
    path = tmp_path / "cut.ast.gz"
    path.write_bytes(packed[: len(packed) // 2])
    messages, damage = read(path)
    assert 100 < len(messages) < 2000
    assert "what gzip packed is cut off" in damage
    path.write_bytes(packed[:-6] + b"\0\0" + packed[-4:])
    messages, damage = read(path)
    (told,) = damage
    assert told.startswith("what gzip packed is broken: CRC check failed")


def test_a_small_file_does_not_become_a_machine_s_memory() -> None:
    bomb = gzip.compress(bytes(1 << 26))
    raw = UnpackedFile(io.BytesIO(bomb))
    told: list[str] = []
    raw.on_damage = lambda _, what: told.append(what)
    tracemalloc.start()
    octets = 0
    with io.BufferedReader(raw, 1 << 18) as file:
        while piece := file.read(1 << 18):
            octets += len(piece)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert octets <= MOST_UNPACKED * len(bomb) + SPARE_OCTETS
    assert told == [f"it would grow to more than {MOST_UNPACKED} times its octets"]
    assert peak < 4 << 20


def test_a_packed_mcap_says_what_to_do(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap.gz"
    path.write_bytes(gzip.compress(data_of(FileFormat.MCAP)))
    with pytest.raises(PlotfeedError, match="gunzip it first"), open_recording(path):
        pass
    with pytest.raises(PlotfeedError, match="gunzip it first"):
        RecordingFile(path)
