"""A capture that is read and written again, as it was or with what was changed."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import dpkt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.recordings import START_NS, block_048, message, read, written
from support.tshark import tshark_fields

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
    frame,
)
from plotfeed.replay.recorded import Recorded

PLOT = block_048(43_200)
HERE, THERE = bytes([10, 0, 0, 1]), bytes([239, 1, 2, 3])
HERE_6, THERE_6 = bytes(15) + b"\1", b"\xff\x15" + bytes(13) + b"\7"
VLAN = b"\x88\xa8\0\7\x81\0\x20\x09"
MAC = 12


def packet(link_type: int = ETHERNET, *, six: bool = False) -> bytes:
    """A plot to a group."""
    here, there = (HERE_6, THERE_6) if six else (HERE, THERE)
    return frame(link_type, (here, 4000), (there, 8600), PLOT)


def capture(
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


def again(data: bytes) -> bytes:
    return written(PcapWriter, messages_of(data))


OF_BOTH = [link_type for link_type in LINK_TYPES if link_type not in (ONLY_IPV4, ONLY_IPV6)]


@pytest.mark.parametrize(("link_type", "six"), [(ONLY_IPV4, False), (ONLY_IPV6, True)])
def test_a_capture_of_one_ip_takes_no_other(link_type: int, six: bool) -> None:
    data = capture(packet(link_type, six=six), link_type=link_type)
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
            data = capture(
                packet(link_type, six=six), packet(link_type), link_type=link_type,
                order=order, ns=ns, snap=100, more=5,
            )  # fmt: skip
            assert again(data) == data


@given(
    st.binary(max_size=30), st.binary(min_size=2, max_size=2), st.binary(min_size=12, max_size=12)
)
def test_tags_padding_addresses_and_wrong_checksums_come_back(
    tail: bytes, checksum: bytes, hardware: bytes
) -> None:
    plain = packet()
    wrong = plain[:40] + checksum + plain[42:]
    no_lengths = plain[:16] + b"\0\0" + plain[18:24] + b"\0\0" + plain[26:]
    data = capture(hardware + VLAN + plain[MAC:] + tail, hardware + wrong[MAC:] + tail, no_lengths)
    assert again(data) == data


def test_the_frame_check_sequence_that_a_header_tells_of_comes_back() -> None:
    data = capture(packet() + b"\1\2\3\4", link_type=ETHERNET | 0x2400_0000)
    assert again(data) == data


@pytest.mark.parametrize("payload", [block_048(50_000), PLOT + PLOT, b"", bytes(65_507)])
@pytest.mark.parametrize("six", [False, True])
def test_another_payload_has_its_own_lengths_and_checksums(payload: bytes, six: bool) -> None:
    plain = packet(six=six)
    data = capture(plain[:MAC] + VLAN + plain[MAC:] + bytes(9), more=5, snap=0)
    (was,) = messages_of(data)
    changed = written(PcapWriter, [was._replace(payload=payload)])
    (now,) = messages_of(changed)
    assert (now.payload, now.topic) == (payload, was.topic)
    ((_, octets),) = dpkt.pcap.Reader(io.BytesIO(changed))
    here, there = (HERE_6, THERE_6) if six else (HERE, THERE)
    made = frame(ETHERNET, (here, 4000), (there, 8600), payload)
    assert octets == plain[:MAC] + VLAN + made[MAC:]
    assert LENGTH not in dict(now.properties)


def test_options_and_time_to_live_stay_with_another_payload() -> None:
    plain = packet()
    head = bytearray(plain[14:34] + b"\x94\4\0\0" + plain[34:42])
    head[0], head[8] = 0x46, 3
    (was,) = messages_of(capture(bytes(head[:2] + b"\0\x2e" + head[4:]) + PLOT, link_type=RAW))
    changed = written(PcapWriter, [was._replace(payload=PLOT * 2)])
    (now,) = messages_of(changed)
    assert now.payload == PLOT * 2
    ((_, octets),) = dpkt.pcap.Reader(io.BytesIO(changed))
    ip = dpkt.ip.IP(octets)
    assert (ip.ttl, ip.opts, ip.len) == (3, b"\x94\4\0\0", len(octets))


def test_another_destination_or_source_is_a_packet_of_its_own() -> None:
    (was,) = messages_of(capture(packet(RAW), link_type=RAW))
    there = was._replace(topic="udp/239.9.9.9/8601")
    here = was._replace(properties=((SOURCE, "10.9.9.9/1"), *was.properties[1:]))
    elsewhere = was._replace(topic="plotfeed/radar/asterix/048")
    got = messages_of(written(PcapWriter, [was, there, here, elsewhere]))
    assert [each.topic for each in got] == [
        was.topic, "udp/239.9.9.9/8601", was.topic, "udp/127.1.0.0/8600"
    ]  # fmt: skip
    assert dict(got[2].properties)[SOURCE] == "10.9.9.9/1"
    assert [each.payload for each in got] == [PLOT] * 4


@pytest.mark.parametrize("link_type", OF_BOTH)
def test_messages_from_elsewhere_go_along_in_every_link_layer(
    link_type: int, tmp_path: Path
) -> None:
    (was,) = messages_of(capture(packet(link_type), link_type=link_type))
    others = [message(PLOT, START_NS + 1), message(PLOT, START_NS, topic="udp/ff15::7/8600")]
    data = written(PcapWriter, [was, *others])
    assert [each.payload for each in messages_of(data)] == [PLOT] * 3
    path = tmp_path / "mixed.pcap"
    path.write_bytes(data)
    lines = tshark_fields(path, "udp.dstport", "udp.checksum.status", "_ws.malformed")
    assert lines == [["8600", "1", ""]] * 3


def test_packets_of_another_link_layer_than_that_of_the_first_are_made_anew() -> None:
    (raw,) = messages_of(capture(packet(RAW), link_type=RAW))
    (ethernet,) = messages_of(capture(packet()))
    assert written(PcapWriter, [raw, ethernet._replace(log_time_ns=START_NS + 1_500_000)]) == (
        capture(packet(RAW), packet(RAW), link_type=RAW)
    )


def test_what_the_header_of_the_file_does_not_allow_is_told() -> None:
    (was,) = messages_of(capture(packet(), snap=80))
    writer = PcapWriter(io.BytesIO())
    assert writer.write(was._replace(log_time_ns=START_NS + 1)) is None
    assert writer.notes()[1:] == ["1 times lost what is less than a microsecond"]
    reason = writer.write(message(bytes(100), topic="udp/10.0.0.1/1"))
    assert reason == "longer than the capture's 80 octets of a packet"


def test_a_file_without_messages_is_a_capture() -> None:
    assert messages_of(written(PcapWriter, [])) == []


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
    (was,) = messages_of(capture(packet(link_type), link_type=link_type))
    kept = dict(was.properties)
    kept[HEAD] = kept[HEAD][: length // 4 * 4]
    properties = tuple((kept | dict(changed)).items())
    (now,) = messages_of(
        written(PcapWriter, [was._replace(payload=payload, properties=properties)])
    )
    assert (now.payload, now.topic) == (payload, was.topic)
