"""MCAP of ours, read by the official library and by ours."""

from __future__ import annotations

import errno
import io
import json
import tracemalloc
from contextlib import closing
from pathlib import Path

import pytest
from google.protobuf import json_format
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from support.recordings import MS, SCENE, START_NS, mcap_of, messages, read_log

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.mcap import mcap_writer
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.mcap.mcap_writer import CHUNK_OCTETS, McapWriter
from plotfeed.replay.recorded import Recorded, Stage

TIMES = st.integers(0, (1 << 64) - 1)
TEXTS = st.text(max_size=12)
RECORDED = st.builds(
    Recorded,
    topic=st.sampled_from(["a", "a/b", "before/a", "properties/a"]) | TEXTS,
    payload=st.binary(max_size=60),
    log_time_ns=TIMES,
    publish_time_ns=TIMES,
    content_type=st.sampled_from(
        [
            "",
            "application/json",
            "application/x-protobuf",
            "application/x-protobuf; messageType=plotfeed.v1.PlotBatch",
            "application/x-protobuf; messageType=no.such.Thing",
            "application/x-asterix; cat=48",
        ]
    )
    | TEXTS,
    properties=st.lists(st.tuples(TEXTS, TEXTS), max_size=4).map(tuple),
    retain=st.booleans(),
    qos=st.integers(0, 2),
    stage=st.sampled_from(Stage),
)
Official = tuple[Schema | None, Channel, Message]


def official(data: bytes) -> list[Official]:
    """What the official library reads, with every CRC checked; properties left out."""
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    return [
        found
        for found in reader.iter_messages(log_time_order=True)
        if found[1].metadata["plotfeed.holds"] == "messages"
    ]


@given(st.lists(RECORDED, max_size=30), st.integers(0, 5))
def test_whatever_is_written_is_read_back(recorded: list[Recorded], flush_every: int) -> None:
    data = mcap_of(recorded, flush_every=flush_every)
    found, reader = read_log(data)
    # Only within a chunk, and between chunks that are apart, those of one time keep their order.
    assert sorted(map(repr, found)) == sorted(map(repr, recorded))
    assert [m.log_time_ns for m in found] == sorted(m.log_time_ns for m in recorded)
    if not flush_every:
        assert found == sorted(recorded, key=lambda m: m.log_time_ns)
    assert reader.damage == []
    assert reader.summary().messages == len(recorded)
    assert reader.summary().indexed
    theirs = official(data)
    assert sorted((m.log_time, m.publish_time, m.data) for _, _, m in theirs) == sorted(
        (m.log_time_ns, m.publish_time_ns, m.payload) for m in recorded
    )


@given(st.lists(RECORDED, max_size=12), st.integers(0, 5))
def test_what_nobody_ended_is_read_back_too(recorded: list[Recorded], flush_every: int) -> None:
    data = mcap_of(recorded, flush_every=flush_every, close=False)
    found, reader = read_log(data)
    assert sorted(map(repr, found)) == sorted(map(repr, recorded))
    assert [damage.offset for damage in reader.damage] == [len(data)]
    assert not reader.summary().indexed
    ended = McapReader(io.BytesIO(mcap_of(recorded, flush_every=flush_every)))
    whole, cut = ended.summary(), reader.summary()
    assert (cut.counts, cut.start_ns, cut.end_ns) == (whole.counts, whole.start_ns, whole.end_ns)
    assert reader.attachments() == ended.attachments()


def test_the_official_reader_finds_what_the_index_says() -> None:
    recorded = messages(6000, octets=100)
    data = mcap_of(recorded)
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 2 * len(recorded)  # properties have their own
    assert summary.statistics.message_start_time == recorded[0].log_time_ns
    assert summary.statistics.message_end_time == recorded[-1].log_time_ns
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 3
    for index in summary.chunk_indexes:
        assert index.compression == "zstd"
        assert index.uncompressed_size < CHUNK_OCTETS + 1000
    (attachment,) = reader.iter_attachments()
    assert (attachment.name, attachment.data) == (SCENE.name, SCENE.data)
    # A time in the middle, of one topic.
    topic, start, end = recorded[0].topic, START_NS + 3000 * MS, START_NS + 3100 * MS
    theirs = reader.iter_messages([f"before/{topic}"], starting_at=start, ending_before=end)
    ours = McapReader(io.BytesIO(data)).messages(start, end, [topic], [Stage.BEFORE])
    assert [m.data for _, _, m in theirs] == [m.payload for m in ours] != []


def test_every_record_is_where_the_indexes_say() -> None:
    data = mcap_of(messages(3000, octets=100))
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    chunks = StreamReader(io.BytesIO(data), emit_chunks=True, validate_crcs=True).records
    opcodes = [type(record).__name__ for record in chunks]
    assert opcodes[:2] == ["Header", "Attachment"]
    assert opcodes.count("Chunk") == len(summary.chunk_indexes)
    for index in summary.chunk_indexes:
        assert data[index.chunk_start_offset] == 6
        assert sum(index.message_index_offsets.values()) > 0
        for channel_id, offset in index.message_index_offsets.items():
            assert data[offset] == 7
            assert int.from_bytes(data[offset + 9 : offset + 11], "little") == channel_id


def test_channels_say_what_their_messages_are() -> None:
    before, after = messages(2)
    telemetry = Recorded(
        topic="plotfeed/telemetry/d1",
        payload=b"",
        log_time_ns=START_NS,
        publish_time_ns=START_NS,
        content_type="application/x-protobuf",
        stage=Stage.TELEMETRY,
    )
    reader = make_reader(io.BytesIO(mcap_of([before, after, telemetry])))
    summary = reader.get_summary()
    assert summary is not None
    channels = {channel.topic: channel for channel in summary.channels.values()}
    topic = before.topic
    assert set(channels) == {
        f"before/{topic}",
        topic,
        f"properties/before/{topic}",
        f"properties/{topic}",
        telemetry.topic,
    }
    first = channels[f"before/{topic}"]
    assert first.message_encoding == "asterix"
    assert first.schema_id == 0
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
    assert json.loads(message.data) == dict(after.properties)
    assert (message.log_time, message.publish_time) == (after.log_time_ns, after.publish_time_ns)


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("plotfeed.v1.PlotBatch", {"sensor": "radar", "scan": "7"}),
        (
            "sapient_msg.bsi_flex_335_v2_0.SapientMessage",
            {"nodeId": "9a1e1b0e-2f0c-4a55-8c46-6d8b1c5b0a11"},
        ),
    ],
)
def test_a_schema_alone_is_enough_to_decode(kind: str, fields: dict[str, str]) -> None:
    if kind.startswith("sapient"):
        module = pytest.importorskip("sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2")
        payload = json_format.ParseDict(fields, module.SapientMessage()).SerializeToString()
    else:
        payload = json_format.ParseDict(fields, pb.PlotBatch()).SerializeToString()
    content_type = f"application/x-protobuf; messageType={kind}"
    recorded = Recorded(
        topic="t", payload=payload, log_time_ns=1, publish_time_ns=1, content_type=content_type
    )
    ((schema, channel, message),) = official(mcap_of([recorded]))
    assert channel.message_encoding == "protobuf"
    assert schema is not None
    assert (schema.name, schema.encoding) == (kind, "protobuf")
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)  # type: ignore[no-untyped-call]
    found = GetMessageClass(pool.FindMessageTypeByName(kind)).FromString(message.data)
    assert json_format.MessageToDict(found) == fields


def test_a_flush_puts_everything_into_the_file() -> None:
    file, recorded = io.BytesIO(), messages(10)
    writer = McapWriter(file)
    for n, each in enumerate(recorded):
        writer.write(each)
        writer.flush()
        assert len(read_log(file.getvalue())[0]) == n + 1
    size = len(file.getvalue())
    writer.flush()
    assert len(file.getvalue()) == size  # nothing new is no chunk


def test_work_that_is_put_off_is_the_same_work() -> None:
    recorded, works, file = messages(5000), [], io.BytesIO()
    writer = McapWriter(file, attachments=[SCENE], run=works.append)
    for each in recorded:
        writer.write(each)
    writer.close()
    assert len(works) > 3
    for work in works:
        work()
    assert file.getvalue() == mcap_of(recorded)


@pytest.mark.parametrize(
    ("field", "more"),
    [
        ("time", {"log_time_ns": -1}),
        ("time", {"publish_time_ns": 1 << 64}),
        (r"'\ud800'", {"topic": "\ud800"}),
        ("", {"properties": (("a", "\ud800"),)}),
    ],
)
def test_what_no_such_file_can_hold_is_refused_and_nothing_of_it_is_there(
    field: str, more: dict[str, object]
) -> None:
    file, good = io.BytesIO(), messages(2)
    writer = McapWriter(file)
    given = {"topic": "t", "payload": b"x", "log_time_ns": 0, "publish_time_ns": 0} | more
    reason = writer.write(Recorded(**given))  # type: ignore[arg-type]
    assert reason is not None
    assert reason.startswith(f"{field}: " if field else "")
    for each in good:
        writer.write(each)
    writer.close()
    found, reader = read_log(file.getvalue())
    assert found == good
    assert reader.damage == []
    assert len(official(file.getvalue())) == 2


def test_more_channels_than_there_can_be_are_refused() -> None:
    writer = McapWriter(io.BytesIO())
    first, other = messages(2)
    writer.write(first)
    writer._last_id = 65_535
    assert writer.write(other) == "topic: more than 65535 channels"
    assert writer.write(first) is None


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


@pytest.mark.parametrize("room", [7_000, 10_000, 10_050, 15_000, 20_000])
def test_a_full_disk_leaves_what_was_whole(room: int) -> None:
    recorded = messages(6000, octets=100)
    disk = SmallDisk(room)
    writer = McapWriter(disk)
    failures = 0
    for n, each in enumerate(recorded, 1):
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
    assert found == recorded[: len(found)]
    assert 0 < len(found) < len(recorded)
    assert len(found) % 50 == 0
    # There may be room for the index where there was none for the chunk.
    if reader.summary().indexed:
        assert reader.damage == []
        assert len(official(data)) == len(found)
    else:
        assert [damage.offset for damage in reader.damage] == [len(data)]


def test_an_index_too_large_for_memory_comes_out_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded = messages(3000)
    expected = mcap_of(recorded)
    monkeypatch.setattr(mcap_writer, "IN_MEMORY_OCTETS", 300)
    path = tmp_path / "log.mcap"
    with path.open("wb", buffering=0) as file:
        writer = McapWriter(file, attachments=[SCENE])
        for each in recorded:
            writer.write(each)
        writer.close()
    assert path.read_bytes() == expected
    assert list(tmp_path.iterdir()) == [path]


def test_the_index_takes_no_more_memory_however_long_the_file(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(mcap_writer, "IN_MEMORY_OCTETS", 10_000)
    with closing(mcap_writer.Overflowing(io.BytesIO())) as kept:
        kept.append(b"x" * 20_000)
        tracemalloc.start()
        try:
            for i in range(1000):
                kept.append(i.to_bytes(600, "big"))
            grown, _ = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert grown < 10_000
        octets = b"".join(kept)
        assert octets[20_000:] == b"".join(i.to_bytes(600, "big") for i in range(1000))
        assert (len(octets), kept.count) == (620_000, 1001)


def test_without_room_for_the_index_the_file_ends_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    recorded, file = messages(100), io.BytesIO()
    writer = McapWriter(file)
    for each in recorded[:50]:
        writer.write(each)
    writer.flush()

    def full(_self: object, _record: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(mcap_writer.Overflowing, "append", full)
    for each in recorded[50:]:
        writer.write(each)
    with pytest.raises(OSError, match="No space"):
        writer.flush()
    writer.close()
    found, reader = read_log(file.getvalue())
    assert found == recorded[:50]
    assert reader.damage == []
    assert reader.summary().indexed


def test_a_disk_that_is_full_at_once_is_an_error_at_once() -> None:
    with pytest.raises(OSError, match="No space"):
        McapWriter(SmallDisk(3))


@pytest.mark.parametrize(
    ("topic", "content_type", "name"),
    [
        (
            "p/radar/foxglove-location",
            "application/json; schema=foxglove.LocationFix",
            "foxglove.LocationFix",
        ),
        (
            "p/radar/foxglove-geojson",
            "application/json; schema=foxglove.GeoJSON",
            "foxglove.GeoJSON",
        ),
        (
            "p/radar/geojson",
            "application/geo+json; schema=plotfeed.TrackFeatures",
            "plotfeed.TrackFeatures",
        ),
        ("p/radar/status", "application/json", "plotfeed.v1.SensorStatus"),
        ("p/radar/settings", "application/json", "plotfeed.Object"),
    ],
)
def test_json_has_a_schema_of_the_name_that_foxglove_looks_for(
    topic: str, content_type: str, name: str
) -> None:
    recorded = Recorded(
        topic=topic, payload=b"{}", log_time_ns=1, publish_time_ns=1, content_type=content_type
    )
    schema, channel, message = official(mcap_of([recorded, recorded]))[0]
    assert schema is not None
    assert (schema.name, schema.encoding) == (name, "jsonschema")
    assert channel.message_encoding == "json"
    assert message.data == b"{}"
    found = json.loads(schema.data)
    assert found["type"] == "object"
    if name.startswith("foxglove."):
        assert found["required"]
