"""Packet captures of the next generation, as Wireshark writes them: read only."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, NamedTuple

from plotfeed.proto.utc import NS
from plotfeed.replay.pcap.packets import MAX_PACKET_OCTETS, PacketReader, ns_header
from plotfeed.replay.recorded import Recorded

SECTION = b"\n\r\r\n"
ORDERS = {b"\x1a\x2b\x3c\x4d": ">", b"\x4d\x3c\x2b\x1a": "<"}
INTERFACE, OBSOLETE_PACKET, SIMPLE_PACKET, ENHANCED_PACKET = 1, 2, 3, 6
READ = (INTERFACE, OBSOLETE_PACKET, SIMPLE_PACKET, ENHANCED_PACKET)

HEAD_OCTETS, TAIL_OCTETS = 8, 4
ROOM_OCTETS = 1 << 16
"""Of a block for what is not packet: its fields and options."""
MAX_INTERFACES = 1 << 12

TSRESOL, TSOFFSET = 9, 14
MICROSECONDS = 6
BINARY = 0x80


@dataclass(frozen=True, slots=True, kw_only=True)
class Interface:
    """Where packets were captured, and how their times count."""

    link_type: int
    snap_octets: int
    """Captured of a packet at most; 0 is all."""
    ticks_a_second: int
    offset_s: int

    def utc_ns(self, ticks: int) -> int:
        """The time that a packet's ticks stand for."""
        return ticks * NS // self.ticks_a_second + self.offset_s * NS


class PcapngBlock(NamedTuple):
    """A block that is whole: its type, what lies between its lengths, where it begins."""

    type: int
    body: bytes
    at: int


class PcapngReader(PacketReader):
    """The UDP datagrams of a capture, through all its sections.

    A packet without a time has that of the one before it. Nothing tells where the block after a
    broken length begins.
    """

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file)
        self._interfaces: list[Interface] = []
        self._order = ""
        self._last_utc_ns = 0

    def messages(self) -> Iterator[Recorded]:
        """Each datagram, on the topic udp/ADDRESS/PORT of where it went."""
        for block in self._blocks():
            try:
                if block.type == INTERFACE:
                    self._take_interface(block)
                    continue
                message = self._message(block)
            except struct.error:
                self.damage.add(block.at, f"a block of type {block.type} that lacks fields")
                continue
            if message is not None:
                yield message

    def _blocks(self) -> Iterator[PcapngBlock]:
        octets = self._octets
        while True:
            at = octets.at
            head = octets.take(HEAD_OCTETS)
            if not head:
                return
            what = self._begin(head)
            if what:
                self.damage.add(at, what)
                return
            kind, length = struct.unpack(f"{self._order}II", head)
            left = length - HEAD_OCTETS - TAIL_OCTETS
            if kind in READ and left > MAX_PACKET_OCTETS + ROOM_OCTETS:
                self.damage.add(at, f"a block of {length} octets, which no packet has")
                return
            body = octets.take(left) if kind in READ else b""
            there = len(body) if kind in READ else octets.skip(left)
            tail = octets.take(TAIL_OCTETS)
            if there < left or len(tail) < TAIL_OCTETS:
                whole = HEAD_OCTETS + there + len(tail)
                self.damage.add(at, f"a block of {length} octets, {whole} are there")
                return
            if tail != head[4:]:
                self.damage.add(at, f"a block of {length} octets that ends with another length")
                return
            if kind in READ:
                yield PcapngBlock(kind, body, at)

    def _begin(self, head: bytes) -> str:
        """Take the byte order from the head of a section; what is wrong with it, or nothing."""
        if len(head) < HEAD_OCTETS:
            return "the file ends within the head of a block"
        if head[:4] == SECTION:
            mark = self._octets.peek(4)
            if mark not in ORDERS:
                return f"the byte order {mark.hex()!r}; expected 1a2b3c4d or 4d3c2b1a"
            self._order = ORDERS[mark]
            self._interfaces = []
        if not self._order:
            return f"{head[:4].hex()!r}; expected the first octets of a pcapng"
        (length,) = struct.unpack(f"{self._order}I", head[4:])
        if length < HEAD_OCTETS + TAIL_OCTETS:
            return f"a block of {length} octets; it has at least {HEAD_OCTETS + TAIL_OCTETS}"
        return ""

    def _take_interface(self, block: PcapngBlock) -> None:
        link_type, snap_octets = struct.unpack_from(f"{self._order}HxxI", block.body)
        if len(self._interfaces) == MAX_INTERFACES:
            self.damage.add(block.at, f"more interfaces than {MAX_INTERFACES}")
            return
        self.check_link_type(link_type, block.at)
        resolution, offset_s = MICROSECONDS, 0
        for code, value in self._options(block.body[8:]):
            if code == TSRESOL and len(value) == 1:
                resolution = value[0]
            elif code == TSOFFSET and len(value) == 8:
                (offset_s,) = struct.unpack(f"{self._order}q", value)
        base, power = (2, resolution - BINARY) if resolution & BINARY else (10, resolution)
        self._interfaces.append(
            Interface(
                link_type=link_type,
                snap_octets=snap_octets,
                ticks_a_second=base**power,
                offset_s=offset_s,
            )
        )

    def _options(self, octets: bytes) -> Iterator[tuple[int, bytes]]:
        at = 0
        while len(octets) - at >= 4:
            code, length = struct.unpack_from(f"{self._order}HH", octets, at)
            if not code:
                return
            yield code, octets[at + 4 : at + 4 + length]
            at += 4 + (length + 3 & ~3)

    def _message(self, block: PcapngBlock) -> Recorded | None:
        body = block.body
        if block.type == SIMPLE_PACKET:
            number, at, ticks = 0, 4, None
            (length,) = struct.unpack_from(f"{self._order}I", body)
            captured = length
        else:
            form = "IIIII" if block.type == ENHANCED_PACKET else "HxxIIII"
            number, high, low, captured, length = struct.unpack_from(f"{self._order}{form}", body)
            at, ticks = 20, high << 32 | low
        if number >= len(self._interfaces):
            self.damage.add(block.at, f"a packet of interface {number}, which is not described")
            return None
        interface = self._interfaces[number]
        if block.type == SIMPLE_PACKET and interface.snap_octets:
            captured = min(captured, interface.snap_octets)
        if captured > len(body) - at:
            there = len(body) - at
            self.damage.add(block.at, f"a packet of {captured} octets, {there} are there")
            return None
        if ticks is not None:
            self._last_utc_ns = interface.utc_ns(ticks)
        packet = body[at : at + captured]
        header = ns_header(interface.link_type)
        return self.message(header, packet, length, self._last_utc_ns, block.at)
