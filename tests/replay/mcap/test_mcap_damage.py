"""MCAP that is cut, damaged or made to do harm: what is whole is read, the rest is told of."""

from __future__ import annotations

import io
import struct
import time
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer
from support.recordings import START_NS, mcap_of, messages

from plotfeed.proto.errors import DecodeError
from plotfeed.replay import mcap as mcap_file
from plotfeed.replay.mcap import DEFINE_EVERY, McapReader
from plotfeed.replay.recorded import Recorded

CHUNK = 4  # Messages in each
MAGIC = b"\x89MCAP0\r\n"
RECORDED = [
    Recorded(
        topic="t",
        payload=b"%06d" % n,
        log_time_ns=START_NS + n,
        publish_time_ns=START_NS,
        properties=(("id", str(n)),) if n % CHUNK == 0 else (),
    )
    for n in range(3 * CHUNK)
]


def read(data: bytes) -> tuple[list[Recorded], McapReader]:
    reader = McapReader(io.BytesIO(data))
    found = list(reader.messages())
    assert all(0 <= damage.offset <= len(data) for damage in reader.damage)
    assert all(damage.what and "\n" not in damage.what for damage in reader.damage)
    assert reader.counts.total() >= 0
    reader.attachment("scene.toml")
    return found, reader


def chunks_of(found: list[Recorded]) -> set[int]:
    """Which chunks are there; all of each, in order."""
    assert found == [m for m in RECORDED if m in found]
    numbers = {RECORDED.index(m) // CHUNK for m in found}
    assert len(found) == CHUNK * len(numbers)
    return numbers


@pytest.mark.parametrize("close", [True, False])
def test_a_file_cut_anywhere_has_every_chunk_before_the_cut(close: bool) -> None:
    data = mcap_of(RECORDED, flush_every=CHUNK, close=close)
    ends = [len(mcap_of(RECORDED[: CHUNK * n], flush_every=CHUNK, close=False)) for n in (1, 2, 3)]
    for octets in range(len(data)):
        found, reader = read(data[:octets])
        # The indexes of a chunk's messages, which come after it, are not needed.
        whole = [n for n, end in enumerate(ends) if end <= octets]
        assert chunks_of(found) in (set(whole), {*whole, len(whole)})
        assert not reader.is_indexed
        assert reader.damage


@pytest.mark.parametrize("close", [True, False])
def test_an_octet_changed_left_out_or_put_in_costs_one_chunk_at_most(close: bool) -> None:
    data = mcap_of(RECORDED, flush_every=CHUNK, close=close)
    costly = 0
    for at in range(len(data)):
        changed = bytearray(data)
        changed[at] ^= (0x01, 0xFF)[at % 2]
        try:
            found, reader = read(bytes(changed))
        except DecodeError:
            assert at < len(MAGIC) + 1  # what kind of file it is
            continue
        costly += is_little_lost(found, reader, close=close)
        more = (data[:at] + data[at + 1 :], data[:at] + b"\x06" + data[at:])[at // 2 % 2]
        if at > len(MAGIC):
            is_little_lost(*read(more), close=False)
    assert costly > 100


def is_little_lost(found: list[Recorded], reader: McapReader, *, close: bool) -> bool:
    """One chunk, and without an index also what that alone has told of; whether it is."""
    lost = {0, 1, 2} - chunks_of(found)
    assert len(lost) <= 1 or (not close and 0 in lost)
    assert reader.damage or not lost
    return bool(lost)


def test_the_loss_of_a_chunk_takes_nothing_along_once_channels_are_told_of_again() -> None:
    recorded = messages((DEFINE_EVERY + 1) * 8)
    data = bytearray(mcap_of(recorded, flush_every=8, close=False))
    data[data.index(b"\x28\xb5\x2f\xfd") + 9] ^= 0xFF
    found, reader = read(bytes(data))
    assert found == recorded[8:]
    assert [damage.offset for damage in reader.damage][1:] == [len(data)]


@given(st.binary(max_size=200), st.integers(0, 2000))
def test_anything_at_all_is_read_or_refused(noise: bytes, at: int) -> None:
    data = mcap_of(RECORDED, flush_every=CHUNK)
    for damaged in (noise, MAGIC + noise, data[:at] + noise + data[at:], data[:at] + noise):
        try:
            read(damaged)
        except DecodeError as error:
            assert "expected an MCAP file" in str(error)


def record(opcode: int, body: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


def chunk(
    content: bytes, size: int, name: bytes = b"zstd", content_size: int | None = None
) -> bytes:
    fields = struct.pack("<QQQI", 0, 1, size, 0) + struct.pack("<I", len(name)) + name
    octets = len(content) if content_size is None else content_size
    return record(6, fields + struct.pack("<Q", octets) + content)


HEADER = record(1, bytes(8))
HUGE = (1 << 63) - 1
ZSTD_HUGE = bytes.fromhex("28b52ffd e0") + HUGE.to_bytes(8, "little") + bytes(20)
HOSTILE = {
    "record": record(6, bytes(50), HUGE),
    "chunk": chunk(bytes(50), HUGE, b""),
    "zstd": chunk(ZSTD_HUGE, HUGE),
    "zstd, less": chunk(ZSTD_HUGE, 1 << 28),
    "lz4": chunk(bytes.fromhex("04224d18 6c40") + bytes(40), HUGE, b"lz4"),
    "lz4, less": chunk(bytes.fromhex("04224d18 6c40") + bytes(40), 8000, b"lz4"),
    "content": chunk(bytes(50), 50, b"", HUGE),
    "unknown compression": chunk(bytes(50), 50, b"bzip2"),
    "text": record(4, struct.pack("<HHI", 1, 0, 0xFFFFFFFF) + bytes(20)),
    "map": record(4, struct.pack("<HHIII", 1, 0, 0, 0, 0xFFFFFFFF) + bytes(20)),
    "attachment": record(9, struct.pack("<QQIIQ", 0, 0, 0, 0, HUGE) + bytes(20)),
    "zeros": bytes(5000),
    "records of no length": record(0x42, b"") * 1000,
    "message": record(5, bytes(10)),
    "unknown channel": record(5, bytes(22)),
    "unknown channel in a chunk": chunk(record(5, bytes(22)), 31, b""),
    "record in a chunk": chunk(record(5, bytes(22), HUGE), 31, b""),
    "short message in a chunk": chunk(record(5, bytes(9)) + record(5, bytes(9)), 36, b""),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_length_that_lies_allocates_nothing_and_hides_nothing(name: str) -> None:
    good = mcap_of(RECORDED, flush_every=CHUNK, close=False)[len(MAGIC) :]
    data = MAGIC + HEADER + HOSTILE[name] + good
    tracemalloc.start()
    try:
        found, reader = read(data)
        _, most_octets = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert found == RECORDED
    assert reader.damage
    assert most_octets < 4 << 20


def footer(summary: bytes, start: int) -> bytes:
    return summary + record(2, struct.pack("<QQI", start, 0, 0)) + MAGIC


def statistics(chunks: int) -> bytes:
    return record(11, struct.pack("<QHIIIIQQI", 9, 0, 0, 0, 0, chunks, 0, 0, 0))


@pytest.mark.parametrize(
    ("times", "at", "says"), [(1000, len(mcap_of([], close=False)), "overlap"), (1, 1 << 62, "")]
)
def test_an_index_that_points_at_one_chunk_again_and_again_or_nowhere_is_not_believed(
    times: int, at: int, says: str
) -> None:
    data = mcap_of(RECORDED, flush_every=CHUNK, close=False)
    place = record(8, struct.pack("<QQQQIQIQQ", 0, 1 << 63, at, 200, 0, 0, 0, 0, 0))
    index = place * times + statistics(times)
    found, reader = read(data + record(15, bytes(4)) + footer(index, len(data) + 13))
    assert found == RECORDED
    assert any(says in damage.what for damage in reader.damage)


def test_an_index_may_be_larger_than_any_record(monkeypatch: pytest.MonkeyPatch) -> None:
    data = mcap_of(RECORDED * 40, flush_every=CHUNK)
    at = data.index(record(15, bytes(4))[:9])  # the end of the data, after which the index begins
    monkeypatch.setattr(mcap_file, "MAX_RECORD_OCTETS", (len(data) - at) // 4)
    reader = McapReader(io.BytesIO(data))
    assert reader.is_indexed
    assert not reader.damage
    assert reader.counts.total() == 40 * len(RECORDED)


def test_a_broken_list_of_damage_ends() -> None:
    data = MAGIC + HEADER + record(5, bytes(22)) * 20_000
    _, reader = read(data)
    assert len(reader.damage) == 1001


def test_what_is_broken_everywhere_takes_no_longer_than_it_should() -> None:
    """Each piece claims the rest of the file, so that reading all of each would never end."""
    piece = chunk(b"", 1, b"")
    count = 20_000
    pieces = []
    for n in range(count):
        left = (count - n) * len(piece) - len(piece)
        length = left + len(piece) - 9
        fields = struct.pack("<QQQI", 0, 1, 1, 0) + bytes(4) + struct.pack("<Q", left)
        pieces.append(struct.pack("<BQ", 6 if n % 2 else 9, length) + fields)
    began = time.process_time()
    _, reader = read(MAGIC + HEADER + b"".join(pieces))
    assert reader.damage
    assert time.process_time() - began < 60


def test_foreign_messages_outside_chunks_survive_damage_between_them() -> None:
    file = io.BytesIO()
    writer = Writer(file, use_chunking=False)
    writer.start()
    channel = writer.register_channel("t", "json", 0)
    for n in range(9):
        writer.add_message(channel, n, b"{}", n)
    data = file.getvalue()
    at = data.rindex(struct.pack("<BQ", 5, 24), 0, len(data) - 40)
    changed = data[:at] + b"\x55" + data[at + 1 :]
    found, reader = read(changed)
    assert len(found) == 8
    assert [damage.offset for damage in reader.damage] == [at, len(data)]
