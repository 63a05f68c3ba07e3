"""What the writers write, as libasterix reads it."""

from __future__ import annotations

import io
from functools import partial

import dpkt
from support.asterix_readers import blocks_of
from support.given_recordings import EVERY_CAPTURE, RadarCapture
from support.recordings import MS, START_NS, block, message, plots, read, written

from plotfeed.replay.files import FileFormat, writer_to
from plotfeed.replay.pcap import PcapReader
from plotfeed.replay.recorded import Recorded


def in_raw(data: bytes) -> bytes:
    return data


def in_final(data: bytes) -> bytes:
    """Without the heads and trailers of frames."""
    blocks, at = b"", 0
    while at < len(data):
        end = at + int.from_bytes(data[at : at + 2], "big")
        assert data[end - 4 : end] == b"\xa5" * 4
        blocks += data[at + 8 : end - 4]
        at = end
    return blocks


def in_pcap(data: bytes) -> bytes:
    """As another reader takes them out."""
    packets = dpkt.pcap.Reader(io.BytesIO(data))
    return b"".join(dpkt.ethernet.Ethernet(octets).data.data.data for _, octets in packets)


WAYS = {FileFormat.RAW: in_raw, FileFormat.FINAL: in_final, FileFormat.PCAP: in_pcap}


def octets_of(messages: list[Recorded]) -> bytes:
    """The data blocks that are in a file of each format."""
    inside = [
        without(written(partial(writer_to, form=form), messages)) for form, without in WAYS.items()
    ]
    assert inside == [inside[0]] * len(inside)
    return inside[0]


def test_the_blocks_in_files_are_those_that_were_written() -> None:
    north = block(34, "f0", "190d", "01", "546000", "00")
    sent = [*plots(20, step_ns=250 * MS), message(north, START_NS + 6000 * MS)]
    found = blocks_of(octets_of(sent))
    assert [each.octets for each in found] == [each.payload for each in sent]
    times = [int(record["140"], 16) for each in found[:-1] for record in each.records]
    assert times == [(43_200 + n * 0.25) * 128 for n in range(20)]
    assert found[-1].records == [{"010": "190d", "000": "01", "030": "546000", "020": "00"}]


@EVERY_CAPTURE
def test_the_records_of_a_capture_are_in_every_format(capture: RadarCapture) -> None:
    messages, _ = read(PcapReader, capture.path.read_bytes())
    octets = octets_of(messages)
    assert octets == b"".join(each.payload for each in messages)
    found = blocks_of(octets)
    assert sum(len(each.records) for each in found if each.category == 48) == capture.plots
    assert sum(len(each.records) for each in found if each.category == 34) == capture.services
    assert b"".join(each.octets for each in found) == octets
