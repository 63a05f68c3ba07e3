"""Files of ASTERIX blocks: raw and FINAL."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.asterix_input import flags_of
from support.asterix_readers import tshark_fields
from support.given_recordings import EVERY_FRAME, EVERY_FRAME_048
from support.recordings import MS, START_NS, block, block_048, message, plots, read, turned, written

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.asterix.codec.layout import is_time_of_day
from plotfeed.proto.utc import DAY_NS, NS
from plotfeed.replay.asterix_files import (
    FinalReader,
    FinalWriter,
    RawReader,
    RawWriter,
    time_of_day_ns,
)
from plotfeed.replay.pcap import PcapWriter
from plotfeed.replay.recorded import Recorded

DAY = START_NS // DAY_NS * DAY_NS
PLOT = block_048(43_200)
TRAILER = b"\xa5" * 4


def raw_on_that_day(file: io.BytesIO) -> RawReader:
    return RawReader(file, date_utc_ns=DAY)


def on_that_day(file: io.BytesIO) -> FinalReader:
    return FinalReader(file, date_utc_ns=DAY)


def test_blocks_are_messages_at_the_times_of_their_records() -> None:
    sent = plots(5)
    data = b"".join(each.payload for each in sent)
    got, reader = read(raw_on_that_day, data)
    assert [each.payload for each in got] == [each.payload for each in sent]
    assert [each.topic for each in got] == ["asterix/048"] * 5
    assert got[0].content_type == "application/x-asterix; cat=48"
    assert all(
        abs(a.log_time_ns - b.log_time_ns) <= NS // 256 for a, b in zip(got, sent, strict=True)
    )
    assert written(RawWriter, got) == data
    assert reader.at == len(data)


DAY_S = 86_400


@pytest.mark.parametrize(
    ("told", "taken"),
    [
        ((86_399, 0, 1, 86_399.5, 2), [86_399, DAY_S, DAY_S + 1, DAY_S + 1, DAY_S + 2]),
        ((3600, 50_000, 50_001, 3000), [3600, 50_000, 50_001, DAY_S + 3000]),
        ((100, 101, 100.5, 102), [100, 101, 101, 102]),  # none is earlier than the one before
        ((None, 100, None, 101), [0, 100, 100, 101]),
        # One wrong time among right ones shifts nothing.
        ((100, 70_000, 101, 102), [100, 100, 101, 102]),
        ((100, 0, 101), [100, 100, 101]),
        ((100, 7300, 7301), [100, 7300, 7301]),
    ],
)
def test_times_of_day_go_on_over_midnight_and_never_back(
    told: tuple[float | None, ...], taken: list[float]
) -> None:
    data = b"".join(block(48, "80", "190d") if t is None else block_048(t) for t in told)
    messages, reader = read(raw_on_that_day, data + block(1, "f0", "1901") + block(250, "00"))
    assert reader.damage == []
    assert [(each.log_time_ns - DAY) / NS for each in messages] == [*taken, taken[-1], taken[-1]]


def test_without_a_date_no_time_is_before_1970() -> None:
    data = block_048(1) + block_048(86_399) + block_048(2)
    messages, _ = read(RawReader, data)
    assert [each.log_time_ns for each in messages] == [NS, NS, 2 * NS]


@pytest.mark.parametrize("number", sorted(CATEGORIES))
@given(time_lsb=st.integers(0, 86_400 * 128 - 1))
def test_the_time_of_a_block_is_what_the_decoder_reads(number: int, time_lsb: int) -> None:
    place, item = next(
        (n, item)
        for n, item in enumerate(CATEGORIES[number].uap)
        if item is not None and is_time_of_day(item)
    )
    data = block(number, flags_of({0, place}).hex(), "0102", f"{time_lsb:06x}")
    (record,) = decode(data)
    assert record.items[item.name] == time_lsb / 128
    assert time_of_day_ns(data) == time_lsb * NS // 128


# At 39833 s, with what precedes the time.
BLOCKS = {
    "002_030": block(2, "f0", "190d", "02", "40", "4dcc80"),
    "010_140": block(10, "f0", "190d", "01", "2100", "4dcc80"),
    "019_140": block(19, "e0", "190d", "01", "4dcc80"),
    "020_140": block(20, "e0", "190d", "4100", "4dcc80"),
    "021_071": block(21, "f8", "190d", "2100", "0001", "02", "4dcc80"),
    "021_073": block(21, "c108", "190d", "00", "4dcc80"),
    "004_020": block(4, "f0", "190d", "01", "02aabbccdd", "4dcc80"),
    "021_072": block(21, "c180", "190d", "00", "4dcc80"),
    "023_070": block(23, "f0", "190d", "01", "02", "4dcc80"),
    "065_030": block(65, "f0", "190d", "01", "02", "4dcc80"),
}


def test_times_of_categories_that_are_not_decoded_are_what_tshark_reads(tmp_path: Path) -> None:
    path = tmp_path / "foreign.pcap"
    sent = [message(data, content_type="application/x-asterix") for data in BLOCKS.values()]
    path.write_bytes(written(PcapWriter, sent))
    fields = [f"asterix.{name}_VALUE" for name in BLOCKS]
    for n, (line, data) in enumerate(
        zip(tshark_fields(path, *fields), BLOCKS.values(), strict=True)
    ):
        assert [name for name, text in zip(BLOCKS, line, strict=False) if text] == [[*BLOCKS][n]]
        assert float(line[n]) == 39_833
        assert time_of_day_ns(data) == 39_833 * NS


@pytest.mark.parametrize(
    ("data", "time_s"),
    [
        (block(48, "40", "a8c000"), 0),
        (block(48, "40", "a8c001"), None),
        (block(48, "40", "a8c0"), None),
        (block(62, "50", "000080"), None),
        (block(48), None),
        (b"", None),
    ],
)
def test_midnight_as_some_write_it_and_no_time(data: bytes, time_s: int | None) -> None:
    assert time_of_day_ns(data) == (None if time_s is None else time_s * NS)


@given(st.binary(max_size=300))
def test_any_octets_are_blocks_and_at_most_one_damage(data: bytes) -> None:
    messages, reader = read(RawReader, data)
    whole = b"".join(each.payload for each in messages)
    assert data.startswith(whole)
    assert [each.offset for each in reader.damage] == ([len(whole)] if whole != data else [])


def test_what_is_no_asterix_is_left_out_and_trailers_are_cut_off() -> None:
    file = io.BytesIO()
    writer = RawWriter(file)
    assert writer.write(message(b"{}", content_type="application/json")) == "no ASTERIX"
    assert writer.write(message(block_048(1) + b"\xca\xfe" * 4)) is None
    assert file.getvalue() == block_048(1)
    assert any("1 messages lost what came after" in note for note in writer.notes())


# FINAL.


def frame(payload: bytes, ticks: int, *, error: int = 0, line: int = 0, day: int = 0) -> bytes:
    """At so many 10 ms of the day."""
    head = struct.pack(">HBBB", 12 + len(payload), error, line, day) + ticks.to_bytes(3, "big")
    return head + payload + TRAILER


def got(data: bytes) -> list[Recorded]:
    messages, reader = read(on_that_day, data)
    assert reader.damage == []
    return messages


@EVERY_FRAME
def test_a_recording_of_others_comes_out_again_to_the_octet(frame_file: Path) -> None:
    data = frame_file.read_bytes()
    messages = got(data)
    assert decode(messages[0].payload)
    assert written(FinalWriter, messages) == data
    assert written(FinalWriter, messages * 3) == data * 3


def test_frames_are_whole_however_small_the_pieces_in_which_they_are_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("plotfeed.replay.recorded.CHUNK_OCTETS", 5)
    data = b"".join(frame(PLOT, ticks) for ticks in range(5))
    assert [each.payload for each in got(data)] == [PLOT] * 5


def test_a_frame_is_a_message_on_the_topic_of_its_line() -> None:
    (one,) = got(frame(PLOT, 4_320_001, line=3, error=1, day=31))
    assert one.topic == "line/3/asterix"
    assert one.content_type == "application/x-asterix; cat=48"
    assert one.payload == PLOT
    assert one.log_time_ns == one.publish_time_ns == START_NS + 10 * MS
    assert dict(one.properties) == {"final-error": "1", "final-line": "3", "final-day": "31"}


@EVERY_FRAME_048
def test_a_frame_was_received_soon_after_its_plot(frame_file: Path) -> None:
    (one,) = got(frame_file.read_bytes())
    time_s = decode(one.payload)[0].items["I048/140"]
    assert isinstance(time_s, float)
    assert 0 <= (one.log_time_ns - DAY) / NS - time_s < 2


@given(
    st.lists(
        st.tuples(
            st.binary(max_size=20).map(lambda body: block(48, body.hex())),
            st.integers(0, 8_639_999),
            st.integers(0, 255),
            st.integers(0, 255),
            st.integers(0, 255),
        ),
        max_size=5,
    )
)
def test_what_is_read_is_written_to_the_octet(
    frames: list[tuple[bytes, int, int, int, int]],
) -> None:
    data = b"".join(
        frame(payload, ticks, error=error, line=line, day=day)
        for payload, ticks, error, line, day in frames
    )
    assert written(FinalWriter, got(data)) == data


def test_times_go_on_over_midnight() -> None:
    data = b"".join(frame(PLOT, ticks) for ticks in (8_639_999, 0, 8_639_998, 1))
    since = [each.log_time_ns - DAY for each in got(data)]
    assert since == [DAY_NS - 10 * MS, DAY_NS, DAY_NS - 20 * MS, DAY_NS + 10 * MS]


def test_times_are_written_to_the_nearest_10_ms() -> None:
    times_ns = (0, 4 * MS, 5 * MS, DAY_NS - 5 * MS, DAY_NS - 5 * MS - 1)
    data = written(FinalWriter, [message(PLOT, DAY + t_ns) for t_ns in times_ns])
    size = 12 + len(PLOT)
    ticks = [int.from_bytes(data[at + 5 : at + 8], "big") for at in range(0, len(data), size)]
    assert ticks == [0, 0, 1, 0, 8_639_999]


def test_each_topic_has_a_line_as_long_as_there_are_lines() -> None:
    sent = [message(PLOT, topic=f"t/{n}") for n in (0, 1, 0, *range(2, 300))]
    lines = [each.topic for each in got(written(FinalWriter, sent))]
    assert lines[:4] == ["line/0/asterix", "line/1/asterix", "line/0/asterix", "line/2/asterix"]
    assert lines[-1] == "line/255/asterix"


def test_what_a_frame_cannot_hold_is_told() -> None:
    file = io.BytesIO()
    writer = FinalWriter(file)
    assert writer.write(message(b"{}", content_type="application/json")) == "no ASTERIX"
    longest = b"\x30\xff\xff" + bytes(65_532)
    assert writer.write(message(longest)) == "longer than a frame's 65535 octets"
    assert writer.write(message(PLOT + b"\xca\xfe")) is None
    assert file.getvalue()[8:-4] == PLOT
    assert writer.notes() == [
        "its clock counts 10 ms, and it has no date",
        "1 messages lost what came after their data blocks",
    ]


@pytest.mark.parametrize("length", [0, 1, 8, 11])
def test_a_frame_that_says_it_is_shorter_than_12_is_passed_over(length: int) -> None:
    broken = length.to_bytes(2, "big") + frame(PLOT, 1)[2:]
    messages, reader = read(on_that_day, frame(PLOT, 0) + broken + frame(PLOT, 2))
    assert [each.log_time_ns - DAY for each in messages] == [0, 20 * MS]
    size = len(frame(PLOT, 0))
    assert [each.offset for each in reader.damage] == [size]
    assert reader.damage[0].what.startswith(f"{size} octets that are no frames")


@pytest.mark.parametrize(
    "lost", [b"\xa5", b"\xa5" * 5, bytes(1000), b"\xa5\xa5\0\xa5\xa5\xa5", PLOT]
)
def test_reading_goes_on_behind_the_trailer_after_what_is_no_frame(lost: bytes) -> None:
    whole = [frame(PLOT, n) for n in range(3)]
    messages, reader = read(on_that_day, whole[0] + lost + whole[1] + whole[2])
    assert [each.payload for each in messages][-1] == PLOT
    assert len(messages) >= 2
    assert reader.damage[0].offset == len(whole[0])


def test_a_time_beyond_the_day_is_that_of_the_frame_before() -> None:
    messages, reader = read(on_that_day, frame(PLOT, 5) + frame(PLOT, 8_640_000) + frame(PLOT, 6))
    assert [each.log_time_ns - DAY for each in messages] == [50 * MS, 50 * MS, 60 * MS]
    assert [each.offset for each in reader.damage] == [len(frame(PLOT, 5))]


def test_an_octet_that_is_turned_costs_two_frames_at_most() -> None:
    data = written(FinalWriter, plots(6))
    for damaged in turned(data):
        messages, _ = read(on_that_day, damaged)
        assert len(messages) >= 4


@given(st.binary(max_size=200) | st.lists(st.sampled_from([b"\xa5", b"\0", b"\x0c"])).map(b"".join))
def test_any_octets_are_frames_and_damage_that_cover_the_file(data: bytes) -> None:
    messages, reader = read(on_that_day, data)
    frames = sum(12 + len(each.payload) for each in messages)
    lost = sum(int(each.what.split()[0]) for each in reader.damage if "no frames" in each.what)
    assert frames + lost == len(data)


def test_damage_without_end_is_told_within_bounds() -> None:
    data = (b"\0" * 20 + TRAILER + frame(b"", 0)) * 3000
    messages, reader = read(on_that_day, data)
    assert len(messages) == 3000
    assert len(reader.damage) == 1001
    assert reader.damage[-1].what == "from here on, more that is not listed"


@pytest.mark.parametrize("data", [b"\xa5" * 400_000, b"\xff\xff" * 200_000, bytes(400_000)])
def test_hostile_octets_take_time_in_proportion(data: bytes) -> None:
    _, reader = read(on_that_day, data)
    assert reader.at == len(data)
