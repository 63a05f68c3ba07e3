from __future__ import annotations

import io
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.asterix_readers import items_of, read_blocks
from support.given_recordings import EVERY_CAPTURE, RadarCapture
from support.recordings import (
    START_NS,
    block,
    block_048,
    is_read_whatever_it_is,
    message,
    plots,
    read,
    written,
)
from support.tshark import tshark_fields

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.asterix.codec.layout import is_time_of_day
from plotfeed.proto.asterix.other_categories import OTHER_CATEGORIES
from plotfeed.proto.utc import DAY_NS, NS
from plotfeed.replay.asterix_files import RawReader, RawWriter, time_of_day_ns
from plotfeed.replay.pcap import PcapReader, PcapWriter

DAY = START_NS // DAY_NS * DAY_NS


def on_that_day(file: io.BytesIO) -> RawReader:
    return RawReader(file, date_utc_ns=DAY)


def times_s(*times_of_day_s: float | None) -> list[float]:
    """Since midnight of the first day, of blocks with those times of day or without one."""
    data = b"".join(block(48, "80", "190d") if t is None else block_048(t) for t in times_of_day_s)
    messages, reader = read(on_that_day, data)
    assert reader.damage == []
    return [(each.log_time_ns - DAY) / NS for each in messages]


def test_blocks_are_messages_at_the_times_of_their_records() -> None:
    sent = plots(5)
    data = b"".join(each.payload for each in sent)
    got, reader = read(on_that_day, data)
    assert [each.payload for each in got] == [each.payload for each in sent]
    assert [each.topic for each in got] == ["asterix/048"] * 5
    assert got[0].content_type == "application/x-asterix; cat=48"
    assert all(
        abs(a.log_time_ns - b.log_time_ns) <= NS // 256 for a, b in zip(got, sent, strict=True)
    )
    assert written(RawWriter, got) == data
    assert reader.at == len(data)


def test_times_go_on_over_midnight_and_over_a_day_without_messages() -> None:
    assert times_s(86_399, 0, 1, 86_399.5, 2) == [86_399, 86_400, 86_401, 86_401, 86_402]
    assert times_s(3600, 50_000, 50_001, 3000) == [3600, 50_000, 50_001, 86_400 + 3000]


def test_no_message_is_earlier_than_the_one_before() -> None:
    assert times_s(100, 101, 100.5, 102) == [100, 101, 101, 102]


def test_a_block_without_a_time_takes_that_of_the_one_before() -> None:
    assert times_s(None, 100, None, 101) == [0, 100, 100, 101]
    data = block_048(100) + block(1, "f0", "1901") + block(250, "00")
    messages, _ = read(on_that_day, data)
    assert [each.log_time_ns - DAY for each in messages] == [100 * NS] * 3


def test_one_wrong_time_among_right_ones_shifts_nothing() -> None:
    assert times_s(100, 70_000, 101, 102) == [100, 100, 101, 102]
    assert times_s(100, 0, 101) == [100, 100, 101]
    assert times_s(100, 7300, 7301) == [100, 7300, 7301]


def test_without_a_date_no_time_is_before_1970() -> None:
    data = block_048(1) + block_048(86_399) + block_048(2)
    messages, _ = read(RawReader, data)
    assert [each.log_time_ns for each in messages] == [NS, NS, 2 * NS]


def test_categories_without_a_layout_are_those_that_stand_apart() -> None:
    assert not OTHER_CATEGORIES.keys() & CATEGORIES.keys()


@pytest.mark.parametrize("number", sorted(CATEGORIES))
@given(time_lsb=st.integers(0, 86_400 * 128 - 1))
def test_the_time_of_a_block_is_what_the_decoder_reads(number: int, time_lsb: int) -> None:
    place, item = next(
        (n, item)
        for n, item in enumerate(CATEGORIES[number].uap)
        if item is not None and is_time_of_day(item)
    )
    data = block(number, _flags(0, place), "0102", f"{time_lsb:06x}")
    (record,) = decode(data)
    assert record.items[item.name] == time_lsb / 128
    assert time_of_day_ns(data) == time_lsb * NS // 128


def _flags(*places: int) -> str:
    octets = bytearray(max(places) // 7 + 1)
    for place in places:
        octets[place // 7] |= 0x80 >> place % 7
    for n in range(len(octets) - 1):
        octets[n] |= 1
    return octets.hex()


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


def test_a_file_that_is_cut_or_turned_anywhere_is_read_as_far_as_it_is_whole() -> None:
    data = b"".join(each.payload for each in plots(4)) + block(250, "00" * 20)
    is_read_whatever_it_is(on_that_day, data)


@given(st.binary(max_size=300))
def test_any_octets_are_blocks_and_at_most_one_damage(data: bytes) -> None:
    messages, reader = read(RawReader, data)
    whole = b"".join(each.payload for each in messages)
    assert data.startswith(whole)
    assert [each.offset for each in reader.damage] == ([len(whole)] if whole != data else [])


@EVERY_CAPTURE
def test_an_independent_decoder_reads_every_record_of_a_capture_made_raw(
    capture: RadarCapture,
) -> None:
    messages, _ = read(PcapReader, capture.path.read_bytes())
    (records,) = read_blocks([written(RawWriter, messages)])
    ours = [record for each in messages for record in decode(each.payload)]
    assert [record["category"] for record in records] == [record.category for record in ours]
    for theirs, record in zip(records, ours, strict=True):
        assert set(items_of(theirs)) == set(record.items)


def test_what_is_no_asterix_is_left_out_and_trailers_are_cut_off() -> None:
    file = io.BytesIO()
    writer = RawWriter(file)
    assert writer.write(message(b"{}", content_type="application/json")) == "no ASTERIX"
    assert writer.write(message(block_048(1) + b"\xca\xfe" * 4)) is None
    assert file.getvalue() == block_048(1)
    assert any("1 messages lost what came after" in note for note in writer.notes())
