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
from support.given_recordings import EVERY_FRAME
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
    undated, _ = read(RawReader, block_048(1) + block_048(86_399) + block_048(2))
    assert [each.log_time_ns for each in undated] == [NS, NS, 2 * NS]  # none is before 1970


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


def test_midnight_as_some_write_it_and_no_time() -> None:
    assert time_of_day_ns(block(48, "40", "a8c000")) == 0
    for parts in (("40", "a8c001"), ("40", "a8c0"), ()):
        assert time_of_day_ns(block(48, *parts)) is None
    assert time_of_day_ns(block(62, "50", "000080")) is time_of_day_ns(b"") is None


@given(st.binary(max_size=300))
def test_any_octets_are_blocks_and_at_most_one_damage(data: bytes) -> None:
    messages, reader = read(RawReader, data)
    whole = b"".join(each.payload for each in messages)
    assert data.startswith(whole)
    assert [each.offset for each in reader.damage] == ([len(whole)] if whole != data else [])


def test_what_a_file_cannot_hold_is_told_and_trailers_are_cut_off() -> None:
    longest, trailed = b"\x30\xff\xff" + bytes(65_532), PLOT + b"\xca\xfe" * 4
    for make, too_long, note in (
        (RawWriter, None, RawWriter.lost),
        (FinalWriter, "longer than a frame's 65535 octets", FinalWriter.lost),
    ):
        file = io.BytesIO()
        writer = make(file)
        assert writer.write(message(b"{}", content_type="application/json")) == "no ASTERIX"
        assert writer.write(message(trailed)) is None
        assert file.getvalue() in (PLOT, frame(PLOT, 4_320_000))
        assert writer.notes() == [note, "1 messages lost what came after their data blocks"]
        assert writer.write(message(longest)) == too_long


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


def test_times_go_on_over_midnight_and_are_written_to_the_nearest_10_ms() -> None:
    data = b"".join(frame(PLOT, ticks) for ticks in (8_639_999, 0, 8_639_998, 1))
    since = [each.log_time_ns - DAY for each in got(data)]
    assert since == [DAY_NS - 10 * MS, DAY_NS, DAY_NS - 20 * MS, DAY_NS + 10 * MS]
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


SIZE = 12 + len(PLOT)
BEGINNINGS = [length.to_bytes(2, "big") + frame(PLOT, 1)[2:] for length in (0, 1, 8, 11)]


@pytest.mark.parametrize(
    ("lost", "ticks", "says"),
    [
        # Frames that say that they are shorter than 12; and what is none at all.
        *((each, [0, 2, 3], f"{SIZE} octets that are no frames") for each in BEGINNINGS),
        (b"\xa5" * 5, [0, 2, 3], "5 octets that are no frames"),
        *(
            (each, [0, 3], f"{len(each) + SIZE} octets that are no frames")
            for each in (b"\xa5", bytes(1000), b"\xa5\xa5\0\xa5\xa5\xa5", PLOT)
        ),
        # A time beyond the day is that of the frame before.
        (frame(PLOT, 8_640_000), [0, 0, 2, 3], "a time of day of 86400 s"),
    ],
)
def test_reading_goes_on_behind_the_trailer_after_what_is_no_frame(
    lost: bytes, ticks: list[int], says: str
) -> None:
    data = frame(PLOT, 0) + lost + frame(PLOT, 2) + frame(PLOT, 3)
    messages, reader = read(on_that_day, data)
    assert [(each.log_time_ns - DAY) // (10 * MS) for each in messages] == ticks
    (damage,) = reader.damage
    assert damage.offset == SIZE
    assert says in damage.what


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


@pytest.mark.parametrize("data", [b"\xa5" * 400_000, b"\xff\xff" * 200_000, bytes(400_000)])
def test_hostile_octets_take_time_in_proportion(data: bytes) -> None:
    _, reader = read(on_that_day, data)
    assert reader.at == len(data)
    data = (b"\0" * 20 + TRAILER + frame(b"", 0)) * 3000  # damage without end
    messages, reader = read(on_that_day, data)
    assert (len(messages), len(reader.damage)) == (3000, 1001)
    assert reader.damage[-1].what == "from here on, more that is not listed"
