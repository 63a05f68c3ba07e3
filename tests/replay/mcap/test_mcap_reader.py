"""MCAP of ours in parts, and what other tools have written."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer
from support.recordings import MS, SCENE, START_NS, mcap_of, messages, read_log

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.mcap.channels import ChannelKey, properties_of_json, properties_to_json
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import Recorded, Stage


class CountedFile(io.BytesIO):
    """Knows how much of it has been read."""

    octets = 0

    def read_log(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        self.octets += len(data)
        return data


@given(
    st.lists(st.integers(0, 400), max_size=60),
    st.integers(1, 7),
    st.integers(-10, 410),
    st.integers(-10, 410),
)
def test_times_come_in_order_and_from_start_to_before_the_end(
    offsets: list[int], flush_every: int, start: int, end: int
) -> None:
    recorded = [
        Recorded(topic="t", payload=bytes([n]), log_time_ns=at, publish_time_ns=0)
        for n, at in enumerate(offsets)
    ]
    reader = McapReader(io.BytesIO(mcap_of(recorded, flush_every=flush_every)))
    found = list(reader.messages(start, end))
    wanted = [m for m in recorded if start <= m.log_time_ns < end]
    assert [m.log_time_ns for m in found] == sorted(m.log_time_ns for m in wanted)
    assert sorted(m.payload for m in found) == sorted(m.payload for m in wanted)
    assert list(reader.messages(start)) == [m for m in reader.messages() if m.log_time_ns >= start]


def test_topics_and_stages_can_be_asked_for() -> None:
    recorded = messages(400)
    reader = McapReader(io.BytesIO(mcap_of(recorded, flush_every=30)))
    topic = recorded[0].topic
    assert list(reader.messages(topics=[topic])) == [m for m in recorded if m.topic == topic]
    assert list(reader.messages(stages=[Stage.AFTER])) == recorded[1::2]
    both = list(reader.messages(topics=[topic], stages=[Stage.BEFORE]))
    assert both == [m for m in recorded[::2] if m.topic == topic]
    assert list(reader.messages(topics=["plotfeed"])) == []


def test_the_summary_counts_each_series() -> None:
    recorded = messages(80)
    reader = McapReader(io.BytesIO(mcap_of(recorded)))
    summary = reader.summary()
    assert summary.counts == dict.fromkeys((ChannelKey.of(m) for m in recorded), 10)
    assert summary.messages == 80
    assert (summary.start_ns, summary.end_ns) == (START_NS, START_NS + 79 * MS)
    (entry,) = reader.attachments()
    assert (entry.name, entry.media_type, entry.octets) == (SCENE.name, SCENE.media_type, 8)


def test_a_file_without_messages_is_one() -> None:
    found, reader = read_log(mcap_of([]))
    assert found == reader.damage == []
    summary = reader.summary()
    assert (summary.start_ns, summary.end_ns, summary.messages) == (None, None, 0)
    assert reader.attachment("scene.toml") == SCENE
    assert reader.attachment("other") is None


def test_a_part_is_found_without_reading_the_rest() -> None:
    recorded = messages(40_000, octets=20)
    file = CountedFile(mcap_of(recorded))
    reader = McapReader(file)
    opening, size = file.octets, len(file.getvalue())
    assert opening < size / 50
    middle = START_NS + 20_000 * MS
    assert next(reader.messages(middle)) == recorded[20_000]
    assert file.octets < size / 10


def test_a_file_of_ours_is_opened_by_its_path_and_closed(tmp_path: Path) -> None:
    path = tmp_path / "one.mcap"
    path.write_bytes(mcap_of(messages(3)))
    with McapReader(path) as reader:
        assert list(reader.messages()) == messages(3)
    assert reader._own is not None
    assert reader._own.closed


@pytest.mark.parametrize("data", [b"\xd4\xc3\xb2\xa1" + bytes(60), b"x", b"hello, world\n" * 9])
def test_what_is_no_mcap_is_an_error(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(data)
    with pytest.raises(DecodeError, match="expected an MCAP file"):
        McapReader(path)


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

    return fill


TIMES = [(n * 37) % 101 + 1 for n in range(101)]
OPTIONS = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "none": {"compression": CompressionType.NONE},
    "small chunks": {"chunk_size": 200},
    "no chunks": {"use_chunking": False},
    "no index": {"index_types": IndexType.NONE},
    "no statistics": {"use_statistics": False},
    "no channels in the summary": {"repeat_channels": False},
    "no schemas in the summary": {"repeat_schemas": False},
    "no CRC": {"enable_crcs": False},
    "CRC of the data": {"enable_data_crcs": True},
    "no offsets": {"use_summary_offsets": False},
}


@pytest.mark.parametrize("name", OPTIONS)
def test_what_the_official_library_writes_is_read(name: str) -> None:
    found, reader = read_log(foreign(images(TIMES), **OPTIONS[name]))
    assert reader.damage == []
    assert [m.log_time_ns for m in found] == list(range(1, 102))
    for message in found:
        n = TIMES.index(message.log_time_ns)
        assert message.payload == bytes([n]) * 20
        assert message.publish_time_ns == message.log_time_ns - 1
        assert message.stage is Stage.RECEIVED
        if n % 2:
            assert (message.topic, message.content_type) == ("/pose", "application/x-cdr")
        else:
            kind = "application/x-protobuf; messageType=demo.Image"
            assert (message.topic, message.content_type) == ("/camera", kind)
    assert reader.summary().messages == 101


def test_zstd_without_its_size_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    compressor = zstandard.ZstdCompressor(write_content_size=False)
    monkeypatch.setattr("zstandard.compress", compressor.compress)
    data = foreign(images(TIMES))
    assert zstandard.frame_content_size(data[data.index(b"\x28\xb5\x2f\xfd") :]) == -1
    found, reader = read_log(data)
    assert len(found) == 101
    assert reader.damage == []


def test_attachments_and_metadata_of_others_are_no_trouble() -> None:
    def fill(writer: Writer) -> None:
        writer.add_metadata("about", {"robot": "one"})
        writer.add_attachment(1, 2, "map.png", "image/png", b"png")
        images(TIMES)(writer)

    for options in ({}, {"use_chunking": False, "index_types": IndexType.NONE}):
        found, reader = read_log(foreign(fill, **options))
        assert len(found) == 101
        assert reader.damage == []
        attachment = reader.attachment("map.png")
        assert attachment is not None
        assert (attachment.data, attachment.log_time_ns) == (b"png", 2)


PAIRS = st.lists(st.tuples(st.text(), st.text())).map(tuple)


@given(PAIRS)
def test_properties_come_back_in_their_order(pairs: tuple[tuple[str, str], ...]) -> None:
    assert properties_of_json(properties_to_json(pairs)) == pairs


@given(st.dictionaries(st.text(), st.text()))
def test_without_a_name_twice_it_is_the_object_that_anybody_would_write(
    names: dict[str, str],
) -> None:
    data = properties_to_json(tuple(names.items()))
    assert json.loads(data) == names
    assert data == json.dumps(names, ensure_ascii=False, separators=(",", ":")).encode()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{",
        b"\xff",
        b"7",
        b'"a"',
        b"{} ",
        b'{"a": 1}',
        b'[["a", "b", "c"]]',
        b'[["a", 1]]',
        b'["ab"]',
        b"[" * 100_000,
        b"9" * 10_000,
    ],
)
def test_anything_else_is_an_error(data: bytes) -> None:
    with pytest.raises(DecodeError, match="user properties: expected"):
        properties_of_json(data)
