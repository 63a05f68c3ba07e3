from __future__ import annotations

import io
import itertools
import struct
import subprocess
from pathlib import Path

import dpkt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.asterix_readers import tshark_fields
from support.given_recordings import EVERY_CAPTURE, RadarCapture
from support.recordings import (
    START_NS,
    block_048,
    is_read_whatever_it_is,
    message,
    plots,
    read,
    written,
)
from support.tools import needed

from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.replay import pcap as captures
from plotfeed.replay.pcap import (
    COOKED,
    COOKED_2,
    ETHERNET,
    FILE,
    HEAD,
    LENGTH,
    LINK_TYPES,
    NULL,
    ONLY_IPV4,
    ONLY_IPV6,
    PAYLOAD_CRC,
    RAW,
    SOURCE,
    TAIL,
    PcapngReader,
    PcapReader,
    PcapWriter,
)
from plotfeed.replay.recorded import Recorded

PLOT = block_048(43_200)
HERE, THERE = bytes([10, 0, 0, 1]), bytes([239, 1, 2, 3])
HERE_6, THERE_6 = bytes(15) + b"\1", b"\xff\x15" + bytes(13) + b"\7"
IP = 14  # Octets of an Ethernet header


def frame(payload: bytes = PLOT, *, six: bool = False, link_type: int = ETHERNET) -> bytes:
    """From 10.0.0.1 port 4000 to the group 239.1.2.3 port 8600, or the same by IPv6."""
    here, there = (HERE_6, THERE_6) if six else (HERE, THERE)
    return captures.frame(link_type, (here, 4000), (there, 8600), payload)


def pcap(
    *packets: bytes,
    link_type: int = ETHERNET,
    order: str = "<",
    ns: bool = False,
    snap: int = 65_535,
    more: int = 0,
) -> bytes:
    """A capture of a packet every 1.5 ms, of which so many more octets were cut off."""
    magic = 0xA1B23C4D if ns else 0xA1B2C3D4
    data = struct.pack(f"{order}IHHiIII", magic, 2, 4, 3600, 7, snap, link_type)
    for n, each in enumerate(packets):
        seconds, fraction = divmod(START_NS + n * 1_500_000, 1_000_000_000)
        fraction = fraction if ns else fraction // 1000
        data += struct.pack(f"{order}IIII", seconds, fraction, len(each), len(each) + more) + each
    return data


def messages_of(data: bytes) -> list[Recorded]:
    messages, reader = read(PcapReader, data)
    assert (reader.damage, reader.skipped) == ([], 0)
    return messages


def payloads(data: bytes) -> list[bytes]:
    return [each.payload for each in messages_of(data)]


def again(data: bytes) -> bytes:
    return written(PcapWriter, messages_of(data))


def test_a_datagram_is_a_message_with_its_times_its_destination_and_its_sender() -> None:
    messages = messages_of(pcap(frame(), frame()))
    for n, each in enumerate(messages):
        assert each.log_time_ns == each.publish_time_ns == START_NS + n * 1_500_000
        assert each.topic == "udp/239.1.2.3/8600"
        assert each.content_type == "application/x-asterix; cat=48"
        assert each.properties[0] == (SOURCE, "10.0.0.1/4000")
    # A payload ends where UDP says and not with the padding.
    padded = pcap(frame(), frame(b"\1") + bytes(20), frame(b"") + bytes(30))
    assert payloads(padded) == [PLOT, b"\1", b""]


def packets_of(ip: bytes, protocol: int) -> dict[str, tuple[int, bytes]]:
    """An IP packet in every link layer."""
    kind = protocol.to_bytes(2, "big")
    families = {0x0800: (2,), 0x86DD: (10 + 14, 28, 30)}[protocol]
    null = {
        f"null {family} {order}": (NULL, struct.pack(f"{order}I", family) + ip)
        for family, order in itertools.product(families, "<>")
    }
    return null | {
        "Ethernet": (ETHERNET, bytes(12) + kind + ip),
        "VLAN": (ETHERNET, bytes(12) + b"\x81\0\0\7" + kind + ip),
        "two VLANs": (ETHERNET, bytes(12) + b"\x88\xa8\0\7\x81\0\0\x09" + kind + ip),
        "raw": (RAW, ip),
        "raw of BSD": (12, ip),
        "raw of OpenBSD": (14, ip),
        "that IP alone": (228 if protocol == 0x0800 else 229, ip),
        "cooked": (COOKED, bytes(14) + kind + ip),
        "cooked 2": (COOKED_2, kind + bytes(18) + ip),
    }


@pytest.mark.parametrize("six", [False, True])
def test_every_link_type_and_both_versions_of_ip(six: bool) -> None:
    ip = frame(six=six)[IP:]
    for name, (link_type, packet) in packets_of(ip, 0x86DD if six else 0x0800).items():
        messages, reader = read(PcapReader, pcap(packet, link_type=link_type))
        assert (name, reader.damage) == (name, [])
        assert [each.payload for each in messages] == [PLOT]
        assert messages[0].topic == ("udp/ff15::7/8600" if six else "udp/239.1.2.3/8600")


def test_content_types_tell_asterix_from_other_payloads() -> None:
    cases = {
        PLOT + PLOT: "application/x-asterix; cat=48",
        PLOT + b"\xca\xfe\0\0\0\1": "application/x-asterix; cat=48",  # a vendor's trailer
        PLOT + b"\x22\0\x09\xe0\x19\x0d\x01\0\0": "application/x-asterix",
        b"\x30\0\2": "application/octet-stream",
        b"\0\0\4\1": "application/octet-stream",
        b"hello": "application/octet-stream",
        PLOT + bytes(17): "application/octet-stream",
        b"": "application/octet-stream",
    }
    messages, _ = read(PcapReader, pcap(*map(frame, cases)))
    assert {each.payload: each.content_type for each in messages} == cases


def changed(packet: bytes, at: int, octets: bytes) -> bytes:
    """With these octets in place of as many."""
    return packet[:at] + octets + packet[at + len(octets) :]


def test_ip_options_and_extension_headers_are_passed_over() -> None:
    length, options = (24 + 8 + len(PLOT)).to_bytes(2, "big"), b"\x94\4\0\0"
    four = changed(changed(frame(), IP, b"\x46"), IP + 2, length)
    six = changed(frame(six=True), IP + 4, length + b"\0")
    extensions = b"\x3c\0\1\4\0\0\0\0" + b"\x11\1" + bytes(14)  # hop by hop, destination
    four = four[: IP + 20] + options + four[IP + 20 :]
    six = six[: IP + 40] + extensions + six[IP + 40 :]
    assert payloads(pcap(four, six)) == [PLOT, PLOT]


def test_fragments_are_damage_and_other_packets_are_counted() -> None:
    first, last = (changed(frame(), IP + 6, flags) for flags in (b"\x20\0", b"\0\x10"))
    six = changed(frame(six=True), IP + 6, b"\x2c")[: IP + 40] + b"\x11\0\0\1\0\0\0\0"
    tcp, arp = changed(frame(), IP + 9, b"\6"), bytes(12) + b"\x08\x06" + bytes(28)
    spanning_tree = bytes(12) + b"\0\x26" + bytes(40)
    packets = [first, arp, last, spanning_tree, six, tcp, frame()]
    messages, reader = read(PcapReader, pcap(*packets))
    assert (len(messages), reader.skipped) == (1, 3)
    assert ["fragment" in each.what for each in reader.damage] == [True] * 3
    assert reader.damage[0].offset == 24


def test_a_packet_that_was_cut_when_it_was_captured_is_damage_and_the_next_is_read() -> None:
    messages, reader = read(PcapReader, pcap(frame()[:-1], frame()[:20], frame()))
    assert len(messages) == 1
    assert [each.offset for each in reader.damage] == [24, 24 + 16 + len(frame()) - 1]
    assert reader.damage[0].what == "a UDP payload of 14 octets, 13 are there"


def record(octets: int) -> bytes:
    return pcap() + struct.pack("<IIII", 1, 0, octets, octets) + bytes(100)


LINK_TYPES_SAID = "link type 147; expected one of 0, 1, 12, 14, 101, 113, 228, 229, 276"


@pytest.mark.parametrize(
    ("data", "offset", "says"),
    [
        (record(0xFFFFFFFF), 24, "a packet of 4294967295 octets; at most 262144"),
        (record(262_144), 24, "a packet of 262144 octets, 100 are there"),
        (pcap(frame(), frame(), link_type=147), 20, f"packets of {LINK_TYPES_SAID}"),
        (b"", 0, "expected the first octets of a pcap"),
        (b"\xd4\xc3", 0, "expected the first octets of a pcap"),
        (b"no pcap at all, but long enough", 0, "expected the first octets of a pcap"),
        (pcap()[:23], 0, "a header of 23 octets"),
    ],
)
def test_what_cannot_be_read_at_all_is_one_damage(data: bytes, offset: int, says: str) -> None:
    messages, reader = read(PcapReader, data)
    assert messages == []
    (damage,) = reader.damage
    assert damage.offset == offset
    assert says in damage.what


@given(st.sampled_from([NULL, ETHERNET, RAW, COOKED, COOKED_2]), st.binary(max_size=80))
def test_any_packet_is_a_message_damage_or_skipped(link_type: int, packet: bytes) -> None:
    messages, reader = read(PcapReader, pcap(packet, link_type=link_type))
    assert len(messages) + len(reader.damage) + reader.skipped == 1


def recorded(payload: bytes, n: int = 0, topic: str = "udp/239.1.2.3/8600") -> Recorded:
    return message(payload, START_NS + n, topic=topic, properties=((SOURCE, "10.0.0.1/4000"),))


def test_topics_of_mqtt_become_addresses_of_their_own_and_what_cannot_be_held_is_told() -> None:
    file = io.BytesIO()
    writer = PcapWriter(file)
    topics = ("plotfeed/a/asterix/048", "plotfeed/b/asterix/048", "plotfeed/a/asterix/048")
    assert [writer.write(message(PLOT, topic=topic)) for topic in topics] == [None] * 3
    got, _ = read(PcapReader, file.getvalue())
    assert [each.topic for each in got] == [f"udp/127.1.0.{n}/8600" for n in (0, 1, 0)]
    assert writer.notes()[1:] == [
        f"plotfeed/{name}/asterix/048 became 127.1.0.{n}:8600" for n, name in enumerate("ab")
    ]
    for each, why in (
        (message(b"{}", content_type="application/json"), "neither UDP nor ASTERIX"),
        (recorded(bytes(65_508)), "longer than a datagram's 65507 octets"),
        (message(PLOT, 1 << 63), "of a time after 2106"),
        (message(PLOT, topic="udp/somewhere/99999"), None),
    ):
        assert writer.write(each) == why


@given(st.binary(max_size=101), st.booleans())
def test_dpkt_reads_every_frame_and_finds_its_checksums_right(payload: bytes, six: bool) -> None:
    topic = "udp/ff15::7/8600" if six else "udp/239.1.2.3/8600"
    ((t, octets),) = list(
        dpkt.pcap.Reader(io.BytesIO(written(PcapWriter, [recorded(payload, 7, topic)])))
    )
    assert int(t * 10**9) == START_NS + 7
    ip = dpkt.ethernet.Ethernet(octets).data
    assert isinstance(ip, dpkt.ip6.IP6 if six else dpkt.ip.IP)
    assert bytes(ip.data.data) == payload
    assert (ip.data.sport, ip.data.dport) == (8600 if six else 4000, 8600)
    sums = ip.data.sum, getattr(ip, "sum", None)
    ip.data.sum = 0
    if not six:
        ip.sum = 0
    again = type(ip)(bytes(ip))  # dpkt fills in checksums that are 0
    assert (again.data.sum, getattr(again, "sum", None)) == sums


def test_tshark_finds_checksums_addresses_and_records_right(tmp_path: Path) -> None:
    sent = plots(20) + plots(3, topic="udp/ff15::7/8600")
    path = tmp_path / "ours.pcap"
    path.write_bytes(written(PcapWriter, sent))
    lines = tshark_fields(
        path, "frame.time_epoch", "udp.checksum.status", "ip.checksum.status", "udp.dstport",
        "asterix.category", "asterix.048_140_VALUE", "_ws.malformed",
    )  # fmt: skip
    assert len(lines) == len(sent)
    for line, each in zip(lines, sent, strict=True):
        seconds, _, fraction = line[0].partition(".")
        assert int(seconds) * 10**9 + int(fraction.ljust(9, "0")) == each.log_time_ns
        assert line[1] == "1"
        assert line[2] == ("1" if each.topic.startswith("plotfeed") else "")
        assert line[3:5] == ["8600", "48"]
        (record,) = decode(each.payload)
        assert float(line[5]) == record.items["I048/140"]
        assert line[6] == ""


@EVERY_CAPTURE
def test_a_capture_of_others_keeps_payloads_times_and_places(capture: RadarCapture) -> None:
    data = capture.path.read_bytes()
    got, reader = read(PcapReader, data)
    assert (len(got), reader.damage, reader.skipped) == (capture.messages, [], 0)
    theirs = list(dpkt.pcap.Reader(io.BytesIO(data)))
    for each, (t, octets) in zip(got, theirs, strict=True):
        ip = dpkt.ethernet.Ethernet(octets).data
        assert each.payload == bytes(ip.data.data)
        assert each.log_time_ns == round(t * 1_000_000) * 1000
        assert each.topic == f"udp/{'.'.join(map(str, ip.dst))}/{ip.data.dport}"
    records = [record for each in got for record in decode(each.payload)]
    assert sum(record.category == 48 for record in records) == capture.plots
    assert sum(record.category == 34 for record in records) == capture.services
    assert written(PcapWriter, got) == data


# A capture that is read and written again, as it was or with what was changed.

VLAN = b"\x88\xa8\0\7\x81\0\x20\x09"
MAC = 12
OF_BOTH = [link_type for link_type in LINK_TYPES if link_type not in (ONLY_IPV4, ONLY_IPV6)]


@pytest.mark.parametrize(("link_type", "six"), [(ONLY_IPV4, False), (ONLY_IPV6, True)])
def test_a_capture_of_one_ip_takes_no_other(link_type: int, six: bool) -> None:
    data = pcap(frame(link_type=link_type, six=six), link_type=link_type)
    assert again(data) == data
    (was,) = messages_of(data)
    writer = PcapWriter(io.BytesIO())
    other = message(PLOT, topic="udp/10.0.0.7/8600" if six else "udp/ff15::7/8600")
    assert [writer.write(was), writer.write(other)] == [
        None,
        f"of an IP that link type {link_type} of the capture does not hold",
    ]


@pytest.mark.parametrize("six", [False, True])
@pytest.mark.parametrize("link_type", OF_BOTH)
def test_every_header_and_every_link_layer_comes_back(link_type: int, six: bool) -> None:
    packets = [frame(link_type=link_type, six=each) for each in (six, False)]
    for order, ns in itertools.product("<>", (False, True)):
        data = pcap(*packets, link_type=link_type, order=order, ns=ns, snap=100, more=5)
        assert again(data) == data


@given(
    st.binary(max_size=30), st.binary(min_size=2, max_size=2), st.binary(min_size=12, max_size=12)
)
def test_tags_padding_addresses_and_wrong_checksums_come_back(
    tail: bytes, checksum: bytes, hardware: bytes
) -> None:
    plain = frame()
    wrong = plain[:40] + checksum + plain[42:]
    no_lengths = plain[:16] + b"\0\0" + plain[18:24] + b"\0\0" + plain[26:]
    packets = (hardware + VLAN + plain[MAC:] + tail, hardware + wrong[MAC:] + tail, no_lengths)
    # Of the second the header tells that frame check sequences are there.
    for link_type in (ETHERNET, ETHERNET | 0x2400_0000):
        data = pcap(*packets, link_type=link_type)
        assert again(data) == data


@pytest.mark.parametrize("payload", [block_048(50_000), PLOT + PLOT, b"", bytes(65_507)])
@pytest.mark.parametrize("six", [False, True])
def test_another_payload_has_its_own_lengths_and_checksums(payload: bytes, six: bool) -> None:
    plain = frame(six=six)
    data = pcap(plain[:MAC] + VLAN + plain[MAC:] + bytes(9), more=5, snap=0)
    (was,) = messages_of(data)
    rewritten = written(PcapWriter, [was._replace(payload=payload)])
    (now,) = messages_of(rewritten)
    assert (now.payload, now.topic) == (payload, was.topic)
    ((_, octets),) = dpkt.pcap.Reader(io.BytesIO(rewritten))
    made = frame(payload, six=six)
    assert octets == plain[:MAC] + VLAN + made[MAC:]
    assert LENGTH not in dict(now.properties)


def test_options_and_time_to_live_stay_with_another_payload() -> None:
    plain = frame()
    head = bytearray(plain[14:34] + b"\x94\4\0\0" + plain[34:42])
    head[0], head[8] = 0x46, 3
    (was,) = messages_of(pcap(bytes(head[:2] + b"\0\x2e" + head[4:]) + PLOT, link_type=RAW))
    rewritten = written(PcapWriter, [was._replace(payload=PLOT * 2)])
    assert payloads(rewritten) == [PLOT * 2]
    ((_, octets),) = dpkt.pcap.Reader(io.BytesIO(rewritten))
    ip = dpkt.ip.IP(octets)
    assert (ip.ttl, ip.opts, ip.len) == (3, b"\x94\4\0\0", len(octets))


def test_another_destination_source_or_link_layer_is_a_packet_of_its_own() -> None:
    (was,) = messages_of(pcap(frame(link_type=RAW), link_type=RAW))
    there = was._replace(topic="udp/239.9.9.9/8601")
    here = was._replace(properties=((SOURCE, "10.9.9.9/1"), *was.properties[1:]))
    elsewhere = was._replace(topic="plotfeed/radar/asterix/048")
    (ethernet,) = messages_of(pcap(frame()))
    got = messages_of(written(PcapWriter, [was, there, here, elsewhere, ethernet]))
    assert [each.topic for each in got] == [
        was.topic, "udp/239.9.9.9/8601", was.topic, "udp/127.1.0.0/8600", was.topic
    ]  # fmt: skip
    assert dict(got[2].properties)[SOURCE] == "10.9.9.9/1"
    assert [each.payload for each in got] == [PLOT] * 5
    assert got[4] == was  # in the link layer of the first


@pytest.mark.parametrize("link_type", [NULL, ETHERNET, RAW, COOKED, COOKED_2])
def test_messages_from_elsewhere_go_along_in_every_link_layer(
    link_type: int, tmp_path: Path
) -> None:
    (was,) = messages_of(pcap(frame(link_type=link_type), link_type=link_type))
    others = [message(PLOT, START_NS + 1), message(PLOT, START_NS, topic="udp/ff15::7/8600")]
    data = written(PcapWriter, [was, *others])
    assert [each.payload for each in messages_of(data)] == [PLOT] * 3
    path = tmp_path / "mixed.pcap"
    path.write_bytes(data)
    lines = tshark_fields(path, "udp.dstport", "udp.checksum.status", "_ws.malformed")
    assert lines == [["8600", "1", ""]] * 3


def test_what_the_header_of_the_file_does_not_allow_is_told() -> None:
    (was,) = messages_of(pcap(frame(), snap=80))
    writer = PcapWriter(io.BytesIO())
    assert writer.write(was._replace(log_time_ns=START_NS + 1)) is None
    assert writer.notes()[1:] == ["1 times lost what is less than a microsecond"]
    reason = writer.write(message(bytes(100), topic="udp/10.0.0.1/1"))
    assert reason == "longer than the capture's 80 octets of a packet"


NAMES = [FILE, HEAD, TAIL, LENGTH, PAYLOAD_CRC, SOURCE]


@given(
    st.sampled_from([NULL, ETHERNET, RAW, COOKED, COOKED_2]),
    st.lists(st.tuples(st.sampled_from(NAMES), st.text(max_size=8)), max_size=3),
    st.integers(0, 80),
    st.binary(max_size=40),
)
def test_whatever_the_properties_say_the_payload_goes_where_the_topic_says(
    link_type: int, changed: list[tuple[str, str]], length: int, payload: bytes
) -> None:
    (was,) = messages_of(pcap(frame(link_type=link_type), link_type=link_type))
    kept = dict(was.properties)
    kept[HEAD] = kept[HEAD][: length // 4 * 4]
    properties = tuple((kept | dict(changed)).items())
    (now,) = messages_of(
        written(PcapWriter, [was._replace(payload=payload, properties=properties)])
    )
    assert (now.payload, now.topic) == (payload, was.topic)


# pcapng, as Wireshark writes it.

FRAME = frame()
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


def packets_in(data: bytes) -> list[Recorded]:
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
    messages = packets_in(capture.data)
    assert [each.payload for each in messages] == [PLOT] * 3
    assert [each.log_time_ns for each in messages] == [START_NS] * 3
    assert {each.topic for each in messages} == {"udp/239.1.2.3/8600"}
    capture = Capture(order).interface(snap=len(FRAME))  # of a simple one, what was captured
    capture.block(SIMPLE, capture.pack("I", len(FRAME) + 500) + FRAME)
    assert [each.payload for each in packets_in(capture.data)] == [PLOT]


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
    (one,) = packets_in(Capture().interface(*options).enhanced(ticks).data)
    assert one.log_time_ns == t_ns


def test_each_section_has_its_own_byte_order_and_interfaces() -> None:
    first = Capture("<").interface().interface((9, b"\x09")).enhanced(7, number=1)
    second = Capture(">").interface((9, b"\x06")).enhanced(8)
    assert [each.log_time_ns for each in packets_in(first.data + second.data)] == [7, 8000]


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
    one = Capture().interface().data[28:]
    _, reader = read(PcapngReader, Capture().data + one * 5000)  # interfaces without end
    assert 0 < len(reader.damage) <= 1001


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


def test_a_file_that_is_cut_or_turned_anywhere_is_read_as_far_as_it_is_whole() -> None:
    capture = Capture(">").interface((9, b"\x09"), (14, bytes(8))).enhanced(1)
    capture.block(STATISTICS, bytes(20)).block(SIMPLE, capture.pack("I", len(FRAME)) + FRAME)
    is_read_whatever_it_is(PcapngReader, capture.data, other_parts=4)


@given(st.sampled_from([1, 2, 3, 5, 6, 99]), st.binary(max_size=80))
def test_any_block_leaves_the_next_one_whole(kind: int, body: bytes) -> None:
    capture = Capture().interface().block(kind, body).enhanced(1)
    messages, _ = read(PcapngReader, capture.data)
    assert messages[-1].payload == PLOT


@EVERY_CAPTURE
def test_a_capture_that_wireshark_converts_is_what_it_was(
    capture: RadarCapture, tmp_path: Path
) -> None:
    path = tmp_path / "other.pcapng"
    subprocess.run([needed("editcap"), "-F", "pcapng", capture.path, path], check=True, timeout=60)
    theirs = packets_in(path.read_bytes())
    for one, other in zip(theirs, messages_of(capture.path.read_bytes()), strict=True):
        properties = dict(one.properties) | {FILE: dict(other.properties)[FILE]}
        assert one._replace(properties=tuple(properties.items())) == other


def test_packets_with_tags_and_padding_become_those_of_a_pcap() -> None:
    tagged = FRAME[:12] + b"\x81\0\0\7" + FRAME[12:] + bytes(5)
    one = Capture().interface((9, b"\x09")).enhanced(7, tagged)
    data = written(PcapWriter, packets_in(one.data))
    assert data[24 + 16 :] == tagged
    assert [each.log_time_ns for each in read(PcapReader, data)[0]] == [7]
