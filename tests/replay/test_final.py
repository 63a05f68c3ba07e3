from __future__ import annotations

import io
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.given_recordings import EVERY_FRAME, EVERY_FRAME_048
from support.recordings import (
    MS,
    START_NS,
    block,
    block_048,
    is_read_whatever_it_is,
    message,
    plots,
    read,
    turned,
    written,
)

from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.utc import DAY_NS, NS
from plotfeed.replay.asterix_files import FinalReader, FinalWriter
from plotfeed.replay.recorded import Recorded

DAY = START_NS // DAY_NS * DAY_NS
PLOT = block_048(43_200)
TRAILER = b"\xa5" * 4


def on_that_day(file: io.BytesIO) -> FinalReader:
    return FinalReader(file, date_utc_ns=DAY)


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


def test_a_payload_may_hold_trailers() -> None:
    payload = block(48, "a5" * 40)
    assert [each.payload for each in got(frame(payload, 0) + frame(PLOT, 1))] == [payload, PLOT]


def test_a_time_beyond_the_day_is_that_of_the_frame_before() -> None:
    messages, reader = read(on_that_day, frame(PLOT, 5) + frame(PLOT, 8_640_000) + frame(PLOT, 6))
    assert [each.log_time_ns - DAY for each in messages] == [50 * MS, 50 * MS, 60 * MS]
    assert [each.offset for each in reader.damage] == [len(frame(PLOT, 5))]


def test_a_file_that_is_cut_or_turned_anywhere_is_read_as_far_as_it_is_whole() -> None:
    is_read_whatever_it_is(on_that_day, written(FinalWriter, plots(4)))


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
