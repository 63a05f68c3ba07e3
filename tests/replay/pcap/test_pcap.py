from __future__ import annotations

import io
import itertools
import struct
from pathlib import Path

import dpkt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.asterix_readers import tshark_fields
from support.given_recordings import EVERY_CAPTURE, RadarCapture
from support.recordings import START_NS, block_048, message, plots, read, written

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
    PcapReader,
    PcapWriter,
)
from plotfeed.replay.recorded import Damage, Recorded

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


def damage_of(data: bytes) -> list[Damage]:
    messages, reader = read(PcapReader, data)
    assert messages == []
    return reader.damage


def test_a_datagram_is_a_message_with_its_times_its_destination_and_its_sender() -> None:
    messages = messages_of(pcap(frame(), frame()))
    assert [each.log_time_ns - START_NS for each in messages] == [0, 1_500_000]
    assert [each.publish_time_ns - START_NS for each in messages] == [0, 1_500_000]
    assert messages[0].topic == "udp/239.1.2.3/8600"
    assert messages[0].content_type == "application/x-asterix; cat=48"
    assert messages[0].properties[0] == (SOURCE, "10.0.0.1/4000")
    assert messages[0].payload == PLOT


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


def test_a_payload_ends_where_udp_says_and_not_with_the_padding() -> None:
    assert payloads(pcap(frame(b"\1") + bytes(20), frame(b"") + bytes(30))) == [b"\1", b""]


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


def test_ip_options_and_extension_headers_are_passed_over() -> None:
    plain = frame()
    options = b"\x94\4\0\0"
    four = plain[:IP] + b"\x46" + plain[IP + 1 : IP + 2]
    four += (24 + 8 + len(PLOT)).to_bytes(2, "big") + plain[IP + 4 : IP + 20] + options
    plain_6 = frame(six=True)
    six = plain_6[: IP + 4] + (24 + 8 + len(PLOT)).to_bytes(2, "big") + b"\0" + plain_6[IP + 7 :]
    hop_by_hop, destination = b"\x3c\0\1\4\0\0\0\0", b"\x11\1" + bytes(14)
    six = six[: IP + 40] + hop_by_hop + destination + six[IP + 40 :]
    assert payloads(pcap(four + plain[IP + 20 :], six)) == [PLOT, PLOT]


def test_fragments_are_damage_and_other_packets_are_counted() -> None:
    def fragment(flags: int) -> bytes:
        return frame()[: IP + 6] + flags.to_bytes(2, "big") + frame()[IP + 8 :]

    six = frame(six=True)
    tcp = frame()[: IP + 9] + b"\6" + frame()[IP + 10 :]
    six_fragment = six[: IP + 6] + b"\x2c" + six[IP + 7 : IP + 40] + b"\x11\0\0\1\0\0\0\0"
    arp = bytes(12) + b"\x08\x06" + bytes(28)
    spanning_tree = bytes(12) + b"\0\x26" + bytes(40)
    packets = [fragment(0x2000), arp, fragment(0x0010), spanning_tree, six_fragment, tcp, frame()]
    messages, reader = read(PcapReader, pcap(*packets))
    assert len(messages) == 1
    assert reader.skipped == 3
    assert ["fragment" in each.what for each in reader.damage] == [True] * 3
    assert reader.damage[0].offset == 24


def test_a_packet_that_was_cut_when_it_was_captured_is_damage_and_the_next_is_read() -> None:
    messages, reader = read(PcapReader, pcap(frame()[:-1], frame()[:20], frame()))
    assert len(messages) == 1
    assert [each.offset for each in reader.damage] == [24, 24 + 16 + len(frame()) - 1]
    assert reader.damage[0].what == "a UDP payload of 14 octets, 13 are there"


def test_hostile_lengths_are_one_damage_and_the_end() -> None:
    header = pcap()
    huge = header + struct.pack("<IIII", 1, 0, 0xFFFFFFFF, 0xFFFFFFFF) + bytes(100)
    assert damage_of(huge) == [
        Damage(offset=24, what="a packet of 4294967295 octets; at most 262144")
    ]
    cut = header + struct.pack("<IIII", 1, 0, 262_144, 262_144) + bytes(100)
    assert damage_of(cut) == [Damage(offset=24, what="a packet of 262144 octets, 100 are there")]


def test_an_unknown_link_type_is_told_once() -> None:
    (damage,) = damage_of(pcap(frame(), frame(), link_type=147))
    assert damage.offset == 20
    assert "link type 147; expected one of 0, 1, 12, 14, 101, 113, 228, 229, 276" in damage.what


@pytest.mark.parametrize(
    "data", [b"", b"\xd4\xc3", b"no pcap at all, but long enough", pcap()[:23]]
)
def test_what_does_not_begin_as_a_pcap_is_one_damage(data: bytes) -> None:
    (damage,) = damage_of(data)
    assert damage.offset == 0


@given(st.sampled_from([NULL, ETHERNET, RAW, COOKED, COOKED_2]), st.binary(max_size=80))
def test_any_packet_is_a_message_damage_or_skipped(link_type: int, packet: bytes) -> None:
    messages, reader = read(PcapReader, pcap(packet, link_type=link_type))
    assert len(messages) + len(reader.damage) + reader.skipped == 1


def recorded(payload: bytes, n: int = 0, topic: str = "udp/239.1.2.3/8600") -> Recorded:
    return message(payload, START_NS + n, topic=topic, properties=((SOURCE, "10.0.0.1/4000"),))


def test_topics_of_mqtt_become_addresses_of_their_own_and_are_told() -> None:
    file = io.BytesIO()
    writer = PcapWriter(file)
    for topic in ("plotfeed/a/asterix/048", "plotfeed/b/asterix/048", "plotfeed/a/asterix/048"):
        assert writer.write(message(PLOT, topic=topic)) is None
    got, _ = read(PcapReader, file.getvalue())
    assert [each.topic for each in got] == [
        "udp/127.1.0.0/8600",
        "udp/127.1.0.1/8600",
        "udp/127.1.0.0/8600",
    ]
    assert writer.notes()[1:] == [
        "plotfeed/a/asterix/048 became 127.1.0.0:8600",
        "plotfeed/b/asterix/048 became 127.1.0.1:8600",
    ]


def test_what_a_capture_cannot_hold_is_told() -> None:
    writer = PcapWriter(io.BytesIO())
    assert (
        writer.write(message(b"{}", content_type="application/json")) == "neither UDP nor ASTERIX"
    )
    assert writer.write(recorded(bytes(65_508))) == "longer than a datagram's 65507 octets"
    assert writer.write(message(PLOT, 1 << 63)) == "of a time after 2106"
    assert writer.write(message(PLOT, topic="udp/somewhere/99999")) is None


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
    for order in "<>":
        for ns in (False, True):
            packets = [frame(link_type=link_type, six=each) for each in (six, False)]
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
    data = pcap(hardware + VLAN + plain[MAC:] + tail, hardware + wrong[MAC:] + tail, no_lengths)
    assert again(data) == data


def test_the_frame_check_sequence_that_a_header_tells_of_comes_back() -> None:
    data = pcap(frame() + b"\1\2\3\4", link_type=ETHERNET | 0x2400_0000)
    assert again(data) == data


@pytest.mark.parametrize("payload", [block_048(50_000), PLOT + PLOT, b"", bytes(65_507)])
@pytest.mark.parametrize("six", [False, True])
def test_another_payload_has_its_own_lengths_and_checksums(payload: bytes, six: bool) -> None:
    plain = frame(six=six)
    data = pcap(plain[:MAC] + VLAN + plain[MAC:] + bytes(9), more=5, snap=0)
    (was,) = messages_of(data)
    changed = written(PcapWriter, [was._replace(payload=payload)])
    (now,) = messages_of(changed)
    assert (now.payload, now.topic) == (payload, was.topic)
    ((_, octets),) = dpkt.pcap.Reader(io.BytesIO(changed))
    made = frame(payload, six=six)
    assert octets == plain[:MAC] + VLAN + made[MAC:]
    assert LENGTH not in dict(now.properties)


def test_options_and_time_to_live_stay_with_another_payload() -> None:
    plain = frame()
    head = bytearray(plain[14:34] + b"\x94\4\0\0" + plain[34:42])
    head[0], head[8] = 0x46, 3
    (was,) = messages_of(pcap(bytes(head[:2] + b"\0\x2e" + head[4:]) + PLOT, link_type=RAW))
    changed = written(PcapWriter, [was._replace(payload=PLOT * 2)])
    (now,) = messages_of(changed)
    assert now.payload == PLOT * 2
    ((_, octets),) = dpkt.pcap.Reader(io.BytesIO(changed))
    ip = dpkt.ip.IP(octets)
    assert (ip.ttl, ip.opts, ip.len) == (3, b"\x94\4\0\0", len(octets))


def test_another_destination_or_source_is_a_packet_of_its_own() -> None:
    (was,) = messages_of(pcap(frame(link_type=RAW), link_type=RAW))
    there = was._replace(topic="udp/239.9.9.9/8601")
    here = was._replace(properties=((SOURCE, "10.9.9.9/1"), *was.properties[1:]))
    elsewhere = was._replace(topic="plotfeed/radar/asterix/048")
    got = messages_of(written(PcapWriter, [was, there, here, elsewhere]))
    assert [each.topic for each in got] == [
        was.topic, "udp/239.9.9.9/8601", was.topic, "udp/127.1.0.0/8600"
    ]  # fmt: skip
    assert dict(got[2].properties)[SOURCE] == "10.9.9.9/1"
    assert [each.payload for each in got] == [PLOT] * 4


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


def test_packets_of_another_link_layer_than_that_of_the_first_are_made_anew() -> None:
    (raw,) = messages_of(pcap(frame(link_type=RAW), link_type=RAW))
    (ethernet,) = messages_of(pcap(frame()))
    assert written(PcapWriter, [raw, ethernet._replace(log_time_ns=START_NS + 1_500_000)]) == (
        pcap(frame(link_type=RAW), frame(link_type=RAW), link_type=RAW)
    )


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
