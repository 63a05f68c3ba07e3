"""MCAP of ours and of others, whole and damaged, read by ours and by the official library."""

from __future__ import annotations

import errno
import io
import json
import struct
import time
import tracemalloc
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path

import pytest
import zstandard
from google.protobuf import json_format
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer
from support.recordings import MESSAGES, MS, SCENE, START_NS, mcap_of, messages, read_log

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import DecodeError
from plotfeed.replay import mcap as mcap_file
from plotfeed.replay.mcap import (
    CHUNK_OCTETS,
    DEFINE_EVERY,
    ChannelKey,
    McapReader,
    McapWriter,
    properties_of_json,
)
from plotfeed.replay.recorded import Recorded, Stage

TOPICS = st.sampled_from(["a", "a/b", "before/a", "properties/a"])
TYPES = st.sampled_from(
    [
        "",
        "application/json",
        "application/x-protobuf; messageType=plotfeed.v1.PlotBatch",
        "application/x-protobuf; messageType=no.such.Thing",
        "application/x-asterix; cat=48",
    ]
)
# Of few topics and types, so that channels are used again.
RECORDED = MESSAGES | st.builds(
    lambda message, topic, kind: message._replace(topic=topic, content_type=kind),
    MESSAGES, TOPICS, TYPES,
)  # fmt: skip
Official = tuple[Schema | None, Channel, Message]


def recorded(topic: str = "t", content_type: str = "", payload: bytes = b"{}") -> Recorded:
    return Recorded(topic, payload, 1, 1, content_type)


def official(data: bytes) -> list[Official]:
    """What the official library reads, with every CRC checked; properties left out."""
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    return [
        found
        for found in reader.iter_messages(log_time_order=True)
        if found[1].metadata["plotfeed.holds"] == "messages"
    ]


@given(st.lists(RECORDED, max_size=20), st.integers(0, 5))
def test_whatever_is_written_is_read_back(written: list[Recorded], flush_every: int) -> None:
    data = mcap_of(written, flush_every=flush_every)
    found, reader = read_log(data)
    # Only within a chunk, and between chunks that are apart, those of one time keep their order.
    assert sorted(map(repr, found)) == sorted(map(repr, written))
    assert [m.log_time_ns for m in found] == sorted(m.log_time_ns for m in written)
    if not flush_every:
        assert found == sorted(written, key=lambda m: m.log_time_ns)
    assert reader.damage == []
    assert (reader.counts.total(), reader.is_indexed) == (len(written), True)
    assert sorted((m.log_time, m.publish_time, m.data) for _, _, m in official(data)) == sorted(
        (m.log_time_ns, m.publish_time_ns, m.payload) for m in written
    )
    never_ended = mcap_of(written, flush_every=flush_every, close=False)
    found, cut = read_log(never_ended)
    assert sorted(map(repr, found)) == sorted(map(repr, written))
    assert [damage.offset for damage in cut.damage] == [len(never_ended)]
    assert not cut.is_indexed
    assert (cut.counts, cut.times_ns) == (reader.counts, reader.times_ns)
    assert cut.attachments() == reader.attachments()
    # What is flushed again has nothing new, which is no chunk.
    assert never_ended == mcap_of(written, flush_every=flush_every, close=False, flushes=2)


def test_the_official_reader_finds_what_the_index_says() -> None:
    sent = messages(6000, octets=100)
    data = mcap_of(sent)
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    found = summary.statistics
    assert found is not None
    assert found.message_count == 2 * len(sent)  # properties have their own
    assert found.message_start_time == sent[0].log_time_ns
    assert found.message_end_time == sent[-1].log_time_ns
    assert found.chunk_count == len(summary.chunk_indexes) > 3
    chunks = StreamReader(io.BytesIO(data), emit_chunks=True, validate_crcs=True).records
    opcodes = [type(record).__name__ for record in chunks]
    assert opcodes[:2] == ["Header", "Attachment"]
    assert opcodes.count("Chunk") == len(summary.chunk_indexes)
    for index in summary.chunk_indexes:
        assert index.compression == "zstd"
        assert index.uncompressed_size < CHUNK_OCTETS + 1000
        assert data[index.chunk_start_offset] == 6
        assert index.message_index_offsets
        for channel_id, offset in index.message_index_offsets.items():
            assert data[offset] == 7
            assert int.from_bytes(data[offset + 9 : offset + 11], "little") == channel_id
    (attachment,) = reader.iter_attachments()
    assert (attachment.name, attachment.data) == (SCENE.name, SCENE.data)
    # A time in the middle, of one topic.
    topic, start, end = sent[0].topic, START_NS + 3000 * MS, START_NS + 3100 * MS
    theirs = reader.iter_messages([f"before/{topic}"], starting_at=start, ending_before=end)
    ours = McapReader(io.BytesIO(data)).messages(start, end, [topic], [Stage.BEFORE])
    assert [m.data for _, _, m in theirs] == [m.payload for m in ours] != []


def test_channels_say_what_their_messages_are() -> None:
    before, after = messages(2)
    telemetry = recorded("plotfeed/telemetry/d1", "application/x-protobuf")
    telemetry = telemetry._replace(stage=Stage.TELEMETRY)
    reader = make_reader(io.BytesIO(mcap_of([before, after, telemetry])))
    summary = reader.get_summary()
    assert summary is not None
    channels = {channel.topic: channel for channel in summary.channels.values()}
    topic = before.topic
    names = {f"before/{topic}", topic, f"properties/before/{topic}", f"properties/{topic}"}
    assert set(channels) == names | {telemetry.topic}
    first = channels[f"before/{topic}"]
    assert (first.message_encoding, first.schema_id) == ("asterix", 0)
    assert first.metadata == {
        "plotfeed.topic": topic,
        "plotfeed.stage": "before",
        "plotfeed.content_type": before.content_type,
        "plotfeed.retain": "false",
        "plotfeed.qos": "0",
        "plotfeed.holds": "messages",
    }
    assert summary.schemas[channels[telemetry.topic].schema_id].name == "plotfeed.v1.Telemetry"
    beside = f"properties/{topic}"
    assert channels[beside].message_encoding == "json"
    ((_, _, message),) = reader.iter_messages([beside])
    plain = json.dumps(dict(after.properties), separators=(",", ":"))
    assert message.data == plain.encode()  # the object that anybody would write
    assert (message.log_time, message.publish_time) == (after.log_time_ns, after.publish_time_ns)


NODE = {"nodeId": "9a1e1b0e-2f0c-4a55-8c46-6d8b1c5b0a11"}


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("plotfeed.v1.PlotBatch", {"sensor": "radar", "scan": "7"}),
        ("sapient_msg.bsi_flex_335_v2_0.SapientMessage", NODE),
    ],
)
def test_a_schema_alone_is_enough_to_decode(kind: str, fields: dict[str, str]) -> None:
    made = pb.PlotBatch()
    if kind.startswith("sapient"):
        module = pytest.importorskip("sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2")
        made = module.SapientMessage()
    payload = json_format.ParseDict(fields, made).SerializeToString()
    sent = recorded("t", f"application/x-protobuf; messageType={kind}", payload)
    ((schema, channel, message),) = official(mcap_of([sent]))
    assert schema is not None
    assert (schema.name, schema.encoding, channel.message_encoding) == (kind, *["protobuf"] * 2)
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)  # type: ignore[no-untyped-call]
    found = GetMessageClass(pool.FindMessageTypeByName(kind)).FromString(message.data)
    assert json_format.MessageToDict(found) == fields


@pytest.mark.parametrize(
    ("topic", "content_type", "name"),
    [
        ("a/fix", "application/json; schema=foxglove.LocationFix", "foxglove.LocationFix"),
        ("a/live", "application/json; schema=foxglove.GeoJSON", "foxglove.GeoJSON"),
        ("a/b", "application/geo+json; schema=plotfeed.TrackFeatures", "plotfeed.TrackFeatures"),
        ("p/radar/status", "application/json", "plotfeed.v1.SensorStatus"),
        ("p/radar/settings", "application/json", "plotfeed.Object"),
    ],
)
def test_json_has_a_schema_of_the_name_that_foxglove_looks_for(
    topic: str, content_type: str, name: str
) -> None:
    sent = recorded(topic, content_type)
    schema, channel, message = official(mcap_of([sent, sent]))[0]
    assert schema is not None
    assert (schema.name, schema.encoding) == (name, "jsonschema")
    assert (channel.message_encoding, message.data) == ("json", b"{}")
    found = json.loads(schema.data)
    assert found["type"] == "object"
    assert found.get("required") or not name.startswith("foxglove.")


@pytest.mark.parametrize(
    ("field", "more"),
    [
        ("time: ", {"log_time_ns": -1}),
        ("time: ", {"publish_time_ns": 1 << 64}),
        (r"'\ud800': ", {"topic": "\ud800"}),
        ("", {"properties": (("a", "\ud800"),)}),
    ],
)
def test_what_no_such_file_can_hold_is_refused_and_nothing_of_it_is_there(
    field: str, more: dict[str, object]
) -> None:
    file, good = io.BytesIO(), messages(2)
    writer = McapWriter(file)
    reason = writer.write(recorded()._replace(**more))  # type: ignore[arg-type]
    assert reason is not None
    assert reason.startswith(field)
    assert [writer.write(each) for each in good] == [None, None]
    writer._last_id = 65_535
    assert writer.write(recorded("another")) == "topic: more than 65535 channels"
    assert writer.write(good[0]) is None
    writer.close()
    found, reader = read_log(file.getvalue())
    assert (found, reader.damage) == ([good[0], good[0], good[1]], [])
    assert len(official(file.getvalue())) == 3


class SmallDisk(io.BytesIO):
    """Takes so many octets and no more, and a part of what goes beyond."""

    def __init__(self, room: int) -> None:
        super().__init__()
        self.room = room

    def write(self, data: object) -> int:
        octets = bytes(data)[: self.room - self.tell()]  # type: ignore[call-overload]
        if not octets:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(octets)


@pytest.mark.parametrize("room", [7_000, 10_000, 10_050, 15_000])
def test_a_full_disk_leaves_what_was_whole(room: int) -> None:
    sent = messages(6000, octets=100)
    disk = SmallDisk(room)
    writer = McapWriter(disk)
    failures = 0
    for n, each in enumerate(sent, 1):
        try:
            writer.write(each)
            if n % 50 == 0:
                writer.flush()
        except OSError as error:
            assert error.errno == errno.ENOSPC
            failures += 1
    assert failures == 1  # once it is told, and what comes after is not in the file
    writer.close()
    data = disk.getvalue()
    assert len(data) <= room
    found, reader = read_log(data)
    assert found == sent[: len(found)]
    assert 0 < len(found) < len(sent)
    assert len(found) % 50 == 0
    # There may be room for the index where there was none for the chunk.
    if reader.is_indexed:
        assert reader.damage == []
        assert len(official(data)) == len(found)
    else:
        assert [damage.offset for damage in reader.damage] == [len(data)]
    with pytest.raises(OSError, match="No space"):
        McapWriter(SmallDisk(3))


def test_an_index_too_large_for_memory_comes_out_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent = messages(3000)
    expected = mcap_of(sent)
    monkeypatch.setattr(mcap_file, "IN_MEMORY_OCTETS", 300)
    path = tmp_path / "log.mcap"
    with path.open("wb", buffering=0) as file:
        writer = McapWriter(file, attachments=[SCENE], library="plotfeed test")
        for each in sent:
            writer.write(each)
        writer.close()
    assert path.read_bytes() == expected
    assert list(tmp_path.iterdir()) == [path]
    monkeypatch.setattr(mcap_file, "IN_MEMORY_OCTETS", 10_000)
    records = [b"x" * 20_000, *(i.to_bytes(600, "big") for i in range(1000))]
    with closing(mcap_file.Overflowing(io.BytesIO())) as kept:
        kept.append(records[0])
        tracemalloc.start()
        for record in records[1:]:
            kept.append(record)
        grown, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert grown < 10_000, "it takes no more memory, however long the file"
        assert kept.count == 1001
        assert b"".join(kept) == b"".join(records)


def test_without_room_for_the_index_the_file_ends_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    sent, file = messages(100), io.BytesIO()
    writer = McapWriter(file)
    for each in sent[:50]:
        writer.write(each)
    writer.flush()

    def full(_self: object, _record: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(mcap_file.Overflowing, "append", full)
    for each in sent[50:]:
        writer.write(each)
    with pytest.raises(OSError, match="No space"):
        writer.flush()
    writer.close()
    found, reader = read_log(file.getvalue())
    assert (found, reader.damage) == (sent[:50], [])
    assert reader.is_indexed


@given(
    st.lists(st.integers(0, 400), max_size=60),
    st.integers(1, 7),
    st.integers(-10, 410),
    st.integers(-10, 410),
)
def test_times_come_in_order_and_from_start_to_before_the_end(
    offsets: list[int], flush_every: int, start: int, end: int
) -> None:
    written = [Recorded("t", bytes([n]), at, 0) for n, at in enumerate(offsets)]
    reader = McapReader(io.BytesIO(mcap_of(written, flush_every=flush_every)))
    found = list(reader.messages(start, end))
    wanted = [m for m in written if start <= m.log_time_ns < end]
    assert [m.log_time_ns for m in found] == sorted(m.log_time_ns for m in wanted)
    assert sorted(m.payload for m in found) == sorted(m.payload for m in wanted)
    assert list(reader.messages(start)) == [m for m in reader.messages() if m.log_time_ns >= start]


def test_topics_and_stages_can_be_asked_for_and_are_counted() -> None:
    sent = messages(400)
    reader = McapReader(io.BytesIO(mcap_of(sent, flush_every=30)))
    topic = sent[0].topic
    assert list(reader.messages(topics=[topic])) == [m for m in sent if m.topic == topic]
    assert list(reader.messages(stages=[Stage.AFTER])) == sent[1::2]
    both = list(reader.messages(topics=[topic], stages=[Stage.BEFORE]))
    assert both == [m for m in sent[::2] if m.topic == topic]
    assert list(reader.messages(topics=["plotfeed"])) == []
    assert reader.counts == dict.fromkeys((ChannelKey.of(m) for m in sent), 50)
    assert reader.times_ns == (START_NS, START_NS + 399 * MS)
    (entry,) = reader.attachments()
    assert (entry.name, entry.media_type, entry.octets) == (SCENE.name, SCENE.media_type, 8)


def test_a_file_without_messages_is_one(tmp_path: Path) -> None:
    path = tmp_path / "one.mcap"
    path.write_bytes(mcap_of([]))
    with McapReader(path) as reader:
        assert list(reader.messages()) == reader.damage == []
        assert (reader.times_ns, reader.counts) == (None, {})
        assert reader.attachment("scene.toml") == SCENE
        assert reader.attachment("other") is None
    assert reader._own is not None
    assert reader._own.closed


def test_a_part_is_found_without_reading_the_rest() -> None:
    sent, octets = messages(40_000, octets=20), list[int]()

    class CountedFile(io.BytesIO):
        def read(self, size: int | None = -1) -> bytes:
            data = super().read(size)
            octets.append(len(data))
            return data

    file = CountedFile(mcap_of(sent))
    reader = McapReader(file)
    opening, size = sum(octets), len(file.getvalue())
    assert 0 < opening < size / 50
    assert next(reader.messages(START_NS + 20_000 * MS)) == sent[20_000]
    assert opening < sum(octets) < size / 10


@pytest.mark.parametrize("data", [b"\xd4\xc3\xb2\xa1" + bytes(60), b"x", b"hello, world\n" * 9])
def test_what_is_no_mcap_is_an_error(data: bytes) -> None:
    with pytest.raises(DecodeError, match="expected an MCAP file"):
        McapReader(io.BytesIO(data))


# What other tools write.

Fill = Callable[[Writer], None]


def foreign(fill: Fill, **options: object) -> bytes:
    file = io.BytesIO()
    writer = Writer(file, **options)  # type: ignore[arg-type]
    writer.start()
    fill(writer)
    writer.finish()
    return file.getvalue()


def images(times: Iterable[int]) -> Fill:
    def fill(writer: Writer) -> None:
        schema = writer.register_schema("demo.Image", "protobuf", b"")
        cameras = writer.register_channel("/camera", "protobuf", schema)
        poses = writer.register_channel("/pose", "cdr", 0, {"topic": "theirs", "stage": "x"})
        for n, at in enumerate(times):
            writer.add_message((cameras, poses)[n % 2], at, bytes([n]) * 20, at - 1, n)
        writer.add_metadata("about", {"robot": "one"})
        writer.add_attachment(1, 2, "map.png", "image/png", b"png")

    return fill


TIMES = [(n * 37) % 101 + 1 for n in range(101)]
OPTIONS = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "none": {"compression": CompressionType.NONE},
    "small chunks": {"chunk_size": 200},
    "no chunks": {"use_chunking": False},
    "no index": {"index_types": IndexType.NONE},
    "nothing to find it by": {"use_chunking": False, "index_types": IndexType.NONE},
    "no statistics": {"use_statistics": False},
    "no channels in the summary": {"repeat_channels": False},
    "no schemas in the summary": {"repeat_schemas": False},
    "no CRC": {"enable_crcs": False},
    "CRC of the data": {"enable_data_crcs": True},
    "no offsets": {"use_summary_offsets": False},
}


@pytest.mark.parametrize("name", [*OPTIONS, "zstd without its size"])
def test_what_the_official_library_writes_is_read(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name not in OPTIONS:
        compressor = zstandard.ZstdCompressor(write_content_size=False)
        monkeypatch.setattr("zstandard.compress", compressor.compress)
    data = foreign(images(TIMES), **OPTIONS.get(name, {}))
    if name not in OPTIONS:
        assert zstandard.frame_content_size(data[data.index(b"\x28\xb5\x2f\xfd") :]) == -1
    found, reader = read_log(data)
    assert reader.damage == []
    assert [m.log_time_ns for m in found] == list(range(1, 102))
    assert reader.times_ns == (1, 101)
    assert [m.log_time_ns for m in reader.messages(50, 60)] == list(range(50, 60))
    for message in found:
        n = TIMES.index(message.log_time_ns)
        topic, kind = (
            ("/pose", "application/x-cdr")
            if n % 2
            else ("/camera", "application/x-protobuf; messageType=demo.Image")
        )
        assert message == Recorded(
            topic, bytes([n]) * 20, message.log_time_ns, message.log_time_ns - 1, kind
        )
    assert reader.counts.total() == 101
    attachment = reader.attachment("map.png")
    assert attachment is not None
    assert (attachment.data, attachment.log_time_ns) == (b"png", 2)


@pytest.mark.parametrize(
    "data",
    [
        *(b"", b"{", b"\xff", b"7", b'"a"', b"{} ", b'{"a": 1}', b'[["a", "b", "c"]]'),
        *(b'[["a", 1]]', b'["ab"]', b"[" * 100_000, b"9" * 10_000),
    ],
)
def test_properties_that_are_none_are_an_error(data: bytes) -> None:
    with pytest.raises(DecodeError, match="user properties: expected"):
        properties_of_json(data)


# Files that are cut, damaged or made to do harm: what is whole is read, the rest is told of.

CHUNK = 4  # Messages in each
MAGIC = b"\x89MCAP0\r\n"
CHUNKED = [
    Recorded(
        topic="t",
        payload=b"%06d" % n,
        log_time_ns=START_NS + n,
        publish_time_ns=START_NS,
        properties=(("id", str(n)),) if n % CHUNK == 0 else (),
    )
    for n in range(3 * CHUNK)
]


def examined(data: bytes) -> tuple[list[Recorded], McapReader]:
    reader = McapReader(io.BytesIO(data))
    found = list(reader.messages())
    assert all(0 <= damage.offset <= len(data) for damage in reader.damage)
    assert all(damage.what and "\n" not in damage.what for damage in reader.damage)
    assert reader.counts.total() >= 0
    reader.attachment("scene.toml")
    return found, reader


def chunks_of(found: list[Recorded]) -> set[int]:
    """Which chunks are there; all of each, in order."""
    assert found == [m for m in CHUNKED if m in found]
    numbers = {CHUNKED.index(m) // CHUNK for m in found}
    assert len(found) == CHUNK * len(numbers)
    return numbers


@pytest.mark.parametrize("close", [True, False])
def test_a_file_cut_anywhere_has_every_chunk_before_the_cut(close: bool) -> None:
    data = mcap_of(CHUNKED, flush_every=CHUNK, close=close)
    ends = [len(mcap_of(CHUNKED[: CHUNK * n], flush_every=CHUNK, close=False)) for n in (1, 2, 3)]
    for octets in range(len(data)):
        found, reader = examined(data[:octets])
        # The indexes of a chunk's messages, which come after it, are not needed.
        whole = [n for n, end in enumerate(ends) if end <= octets]
        assert chunks_of(found) in (set(whole), {*whole, len(whole)})
        assert not reader.is_indexed
        assert reader.damage


@pytest.mark.parametrize("close", [True, False])
def test_an_octet_changed_left_out_or_put_in_costs_one_chunk_at_most(close: bool) -> None:
    data = mcap_of(CHUNKED, flush_every=CHUNK, close=close)
    costly = 0
    for at in range(len(data)):
        changed = bytearray(data)
        changed[at] ^= (0x01, 0xFF)[at % 2]
        try:
            found, reader = examined(bytes(changed))
        except DecodeError:
            assert at < len(MAGIC) + 1  # what kind of file it is
            continue
        costly += is_little_lost(found, reader, close=close)
        more = (data[:at] + data[at + 1 :], data[:at] + b"\x06" + data[at:])[at // 2 % 2]
        if at > len(MAGIC):
            is_little_lost(*examined(more), close=False)
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
    found, reader = examined(bytes(data))
    assert found == recorded[8:]
    assert [damage.offset for damage in reader.damage][1:] == [len(data)]


@given(st.binary(max_size=200), st.integers(0, 2000))
def test_anything_at_all_is_read_or_refused(noise: bytes, at: int) -> None:
    data = mcap_of(CHUNKED, flush_every=CHUNK)
    for damaged in (noise, MAGIC + noise, data[:at] + noise + data[at:], data[:at] + noise):
        try:
            examined(damaged)
        except DecodeError as error:
            assert "expected an MCAP file" in str(error)


def record_of(opcode: int, body: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


def chunk(
    content: bytes, size: int, name: bytes = b"zstd", content_size: int | None = None
) -> bytes:
    fields = struct.pack("<QQQI", 0, 1, size, 0) + struct.pack("<I", len(name)) + name
    octets = len(content) if content_size is None else content_size
    return record_of(6, fields + struct.pack("<Q", octets) + content)


HEADER = record_of(1, bytes(8))
HUGE = (1 << 63) - 1
ZSTD_HUGE = bytes.fromhex("28b52ffd e0") + HUGE.to_bytes(8, "little") + bytes(20)
HOSTILE = {
    "record": record_of(6, bytes(50), HUGE),
    "chunk": chunk(bytes(50), HUGE, b""),
    "zstd": chunk(ZSTD_HUGE, HUGE),
    "zstd, less": chunk(ZSTD_HUGE, 1 << 28),
    "lz4": chunk(bytes.fromhex("04224d18 6c40") + bytes(40), HUGE, b"lz4"),
    "lz4, less": chunk(bytes.fromhex("04224d18 6c40") + bytes(40), 8000, b"lz4"),
    "content": chunk(bytes(50), 50, b"", HUGE),
    "unknown compression": chunk(bytes(50), 50, b"bzip2"),
    "text": record_of(4, struct.pack("<HHI", 1, 0, 0xFFFFFFFF) + bytes(20)),
    "map": record_of(4, struct.pack("<HHIII", 1, 0, 0, 0, 0xFFFFFFFF) + bytes(20)),
    "attachment": record_of(9, struct.pack("<QQIIQ", 0, 0, 0, 0, HUGE) + bytes(20)),
    "zeros": bytes(5000),
    "records of no length": record_of(0x42, b"") * 1000,
    "message": record_of(5, bytes(10)),
    "unknown channel": record_of(5, bytes(22)),
    "unknown channels without end": record_of(5, bytes(22)) * 20_000,
    "unknown channel in a chunk": chunk(record_of(5, bytes(22)), 31, b""),
    "record in a chunk": chunk(record_of(5, bytes(22), HUGE), 31, b""),
    "short message in a chunk": chunk(record_of(5, bytes(9)) + record_of(5, bytes(9)), 36, b""),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_length_that_lies_allocates_nothing_and_hides_nothing(name: str) -> None:
    good = mcap_of(CHUNKED, flush_every=CHUNK, close=False)[len(MAGIC) :]
    data = MAGIC + HEADER + HOSTILE[name] + good
    tracemalloc.start()
    try:
        found, reader = examined(data)
        _, most_octets = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert found == CHUNKED
    assert 0 < len(reader.damage) <= 1001
    assert most_octets < 4 << 20


def footer(summary: bytes, start: int) -> bytes:
    return summary + record_of(2, struct.pack("<QQI", start, 0, 0)) + MAGIC


def statistics(chunks: int) -> bytes:
    return record_of(11, struct.pack("<QHIIIIQQI", 9, 0, 0, 0, 0, chunks, 0, 0, 0))


@pytest.mark.parametrize(
    ("times", "at", "says"), [(1000, len(mcap_of([], close=False)), "overlap"), (1, 1 << 62, "")]
)
def test_an_index_that_points_at_one_chunk_again_and_again_or_nowhere_is_not_believed(
    times: int, at: int, says: str
) -> None:
    data = mcap_of(CHUNKED, flush_every=CHUNK, close=False)
    place = record_of(8, struct.pack("<QQQQIQIQQ", 0, 1 << 63, at, 200, 0, 0, 0, 0, 0))
    index = place * times + statistics(times)
    found, reader = examined(data + record_of(15, bytes(4)) + footer(index, len(data) + 13))
    assert found == CHUNKED
    assert any(says in damage.what for damage in reader.damage)


def test_an_index_may_be_larger_than_any_record(monkeypatch: pytest.MonkeyPatch) -> None:
    data = mcap_of(CHUNKED * 40, flush_every=CHUNK)
    at = data.index(record_of(15, bytes(4))[:9])  # the end of the data, before the index
    monkeypatch.setattr(mcap_file, "MAX_RECORD_OCTETS", (len(data) - at) // 4)
    reader = McapReader(io.BytesIO(data))
    assert reader.is_indexed
    assert not reader.damage
    assert reader.counts.total() == 40 * len(CHUNKED)


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
    _, reader = examined(MAGIC + HEADER + b"".join(pieces))
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
    found, reader = examined(changed)
    assert len(found) == 8
    assert [damage.offset for damage in reader.damage] == [at, len(data)]
