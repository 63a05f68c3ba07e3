from __future__ import annotations

import struct
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.given_recordings import EVERY_CAPTURE, RadarCapture
from support.recordings import START_NS, block_048, is_read_whatever_it_is, read, written
from support.tools import needed

from plotfeed.replay.pcap import ETHERNET, FILE, PcapngReader, PcapReader, PcapWriter, frame
from plotfeed.replay.recorded import Recorded

PLOT = block_048(43_200)
FRAME = frame(ETHERNET, (bytes([10, 0, 0, 1]), 4000), (bytes([239, 1, 2, 3]), 8600), PLOT)
SECTION, INTERFACE, OBSOLETE, SIMPLE, STATISTICS, ENHANCED = 0x0A0D0D0A, 1, 2, 3, 5, 6


class Capture:
    """Blocks of a pcapng in one byte order."""

    def __init__(self, order: str = "<") -> None:
        self.order = order
        self.data = b""
        self.block(SECTION, self.pack("IHHq", 0x1A2B3C4D, 1, 0, -1))

    def pack(self, form: str, *values: int) -> bytes:
        return struct.pack(f"{self.order}{form}", *values)

    def block(self, kind: int, body: bytes) -> Capture:
        body += bytes(-len(body) % 4)
        length = self.pack("I", 12 + len(body))
        self.data += self.pack("I", kind) + length + body + length
        return self

    def interface(self, *options: tuple[int, bytes], link_type: int = 1, snap: int = 0) -> Capture:
        body = self.pack("HHI", link_type, 0, snap)
        for code, value in options:
            body += self.pack("HH", code, len(value)) + value + bytes(-len(value) % 4)
        return self.block(INTERFACE, body + (bytes(4) if options else b""))

    def enhanced(self, ticks: int, packet: bytes = FRAME, number: int = 0) -> Capture:
        fields = (number, ticks >> 32, ticks & 0xFFFFFFFF, len(packet), len(packet))
        return self.block(ENHANCED, self.pack("IIIII", *fields) + packet)


def got(data: bytes) -> list[Recorded]:
    messages, reader = read(PcapngReader, data)
    assert reader.damage == []
    return messages


@pytest.mark.parametrize("order", "<>")
def test_packets_of_every_kind_in_either_byte_order(order: str) -> None:
    us = START_NS // 1000
    capture = Capture(order).interface().enhanced(us).block(STATISTICS, bytes(40))
    fields = capture.pack("HHIIII", 0, 7, us >> 32, us & 0xFFFFFFFF, len(FRAME), len(FRAME))
    capture.block(OBSOLETE, fields + FRAME)
    capture.block(SIMPLE, capture.pack("I", len(FRAME)) + FRAME)
    messages = got(capture.data)
    assert [each.payload for each in messages] == [PLOT] * 3
    assert [each.log_time_ns for each in messages] == [START_NS] * 3
    assert {each.topic for each in messages} == {"udp/239.1.2.3/8600"}


@pytest.mark.parametrize(
    ("options", "ticks", "t_ns"),
    [
        ([], 1_500_001, 1_500_001_000),
        ([(9, b"\x09")], 1_500_000_001, 1_500_000_001),
        ([(9, b"\x03")], 1500, 1_500_000_000),
        ([(9, b"\x0c")], 1_500_000_000_999, 1_500_000_000),
        ([(9, b"\x81")], 3, 1_500_000_000),
        ([(2, b"eth0"), (9, b"\x80")], 3, 3_000_000_000),
        ([(14, b"\5" + bytes(7))], 1, 5_000_001_000),
        ([(9, b"\xff")], 1 << 63, 0),
    ],
)
def test_times_are_in_the_unit_and_from_the_offset_of_their_interface(
    options: list[tuple[int, bytes]], ticks: int, t_ns: int
) -> None:
    (one,) = got(Capture().interface(*options).enhanced(ticks).data)
    assert one.log_time_ns == t_ns


def test_each_section_has_its_own_byte_order_and_interfaces() -> None:
    first = Capture("<").interface().interface((9, b"\x09")).enhanced(7, number=1)
    second = Capture(">").interface((9, b"\x06")).enhanced(8)
    assert [each.log_time_ns for each in got(first.data + second.data)] == [7, 8000]


def test_a_simple_packet_ends_with_what_was_captured() -> None:
    capture = Capture().interface(snap=len(FRAME))
    capture.block(SIMPLE, capture.pack("I", len(FRAME) + 500) + FRAME)
    (one,) = got(capture.data)
    assert one.payload == PLOT


def test_what_is_wrong_in_a_block_costs_that_block() -> None:
    capture = Capture().interface()
    before = len(capture.data)
    capture.enhanced(1, number=1)
    capture.block(ENHANCED, capture.pack("IIIII", 0, 0, 0, 1000, 1000) + FRAME)
    capture.block(ENHANCED, bytes(8)).block(INTERFACE, b"").block(SIMPLE, b"")
    capture.enhanced((1 << 64) - 1).enhanced(1)
    messages, reader = read(PcapngReader, capture.data)
    assert len(messages) == 1
    assert len(reader.damage) == 6
    assert reader.damage[0].offset == before
    assert reader.damage[0].what == "a packet of interface 1, which is not described"


@pytest.mark.parametrize(
    ("data", "offset"),
    [
        (b"", None),
        (b"\n\r\r\n", 0),
        (b"no pcapng, but long enough", 0),
        (b"\n\r\r\n\x1c\0\0\0\0\0\0\0" + bytes(16), 0),
        (Capture().data + bytes(8), 28),
        (Capture().data + struct.pack("<II", 6, 0xFFFFFFFF) + bytes(50), 28),
        (Capture().data + struct.pack("<II", 99, 0xFFFFFFFF) + bytes(50), 28),
        (Capture().data + struct.pack("<III", 99, 12, 16), 28),
    ],
)
def test_hostile_lengths_are_one_damage_and_the_end(data: bytes, offset: int | None) -> None:
    messages, reader = read(PcapngReader, data)
    assert messages == []
    assert [each.offset for each in reader.damage] == ([] if offset is None else [offset])


def test_interfaces_without_end_are_bounded() -> None:
    capture = Capture()
    one = Capture().interface().data[28:]
    _, reader = read(PcapngReader, capture.data + one * 5000)
    assert 0 < len(reader.damage) <= 1001


def test_a_file_that_is_cut_or_turned_anywhere_is_read_as_far_as_it_is_whole() -> None:
    capture = Capture(">").interface((9, b"\x09"), (14, bytes(8))).enhanced(1)
    capture.block(STATISTICS, bytes(20)).block(SIMPLE, capture.pack("I", len(FRAME)) + FRAME)
    is_read_whatever_it_is(PcapngReader, capture.data, other_parts=4)


@given(st.sampled_from([1, 2, 3, 5, 6, 99]), st.binary(max_size=80))
def test_any_block_leaves_the_next_one_whole(kind: int, body: bytes) -> None:
    capture = Capture().interface().block(kind, body).enhanced(1)
    messages, _ = read(PcapngReader, capture.data)
    assert messages[-1].payload == PLOT


def converted(folder: Path, data: bytes) -> bytes:
    """By Wireshark's own program."""
    one, other = folder / "one.pcap", folder / "other.pcapng"
    one.write_bytes(data)
    subprocess.run([needed("editcap"), "-F", "pcapng", one, other], check=True, timeout=60)
    return other.read_bytes()


@EVERY_CAPTURE
def test_a_capture_that_wireshark_converts_is_what_it_was(
    capture: RadarCapture, tmp_path: Path
) -> None:
    data = capture.path.read_bytes()
    for one, other in zip(got(converted(tmp_path, data)), read(PcapReader, data)[0], strict=True):
        properties = dict(one.properties) | {FILE: dict(other.properties)[FILE]}
        assert one._replace(properties=tuple(properties.items())) == other


def test_packets_with_tags_and_padding_become_those_of_a_pcap() -> None:
    tagged = FRAME[:12] + b"\x81\0\0\7" + FRAME[12:] + bytes(5)
    one = Capture().interface((9, b"\x09")).enhanced(7, tagged)
    data = written(PcapWriter, got(one.data))
    assert data[24 + 16 :] == tagged
    assert [each.log_time_ns for each in read(PcapReader, data)[0]] == [7]
