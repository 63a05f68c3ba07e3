"""What a run sends by UDP, captured, as Wireshark's ASTERIX dissector reads it."""

from __future__ import annotations

import struct
import subprocess
from pathlib import Path

import pytest
from support.scene_files import radar
from support.tools import needed
from support.udp_receiver import destination, place, receiver, scene_with, simulated

from plotfeed.proto.asterix.codec.decode import decode_lenient

ASTERIX_PORT = 8600
RAW_IP = 101


def captured(datagrams: list[bytes]) -> bytes:
    """A pcap of these as UDP over IPv4, one every millisecond."""
    capture = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 1 << 16, RAW_IP)
    for n, payload in enumerate(datagrams):
        udp = struct.pack(">HHHH", 40_000, ASTERIX_PORT, 8 + len(payload), 0) + payload
        here = bytes([127, 0, 0, 1])
        ip = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(udp), n, 0, 64, 17, 0) + here + here
        packet = ip + udp
        capture += struct.pack("<IIII", n // 1000, n % 1000 * 1000, len(packet), len(packet))
        capture += packet
    return capture


def dissected(folder: Path, datagrams: list[bytes], *fields: str) -> list[list[str]]:
    """The fields of each packet, those that occur more than once joined by commas."""
    program = needed("tshark")
    path = folder / "run.pcap"
    path.write_bytes(captured(datagrams))
    wanted = [word for field in fields for word in ("-e", field)]
    done = subprocess.run(
        [
            program,
            "-n",
            "-r",
            str(path),
            "-d",
            f"udp.port=={ASTERIX_PORT},asterix",
            "-T",
            "fields",
            *wanted,
        ],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    return [line.split("\t") for line in done.stdout.splitlines()]


@pytest.mark.asyncio
async def test_wireshark_reads_every_datagram_of_a_run(tmp_path: Path) -> None:
    with receiver() as ears:
        text = scene_with(destination(place(ears), max_octets=200), radar(more="sac = 25\nsic = 3"))
        totals, _, got = await simulated(tmp_path, text, 10.0, ears)
    read = dissected(
        tmp_path,
        got,
        "asterix.category",
        "asterix.length",
        "asterix.048_010_SAC",
        "asterix.048_040_RHO",
        "asterix.034_010_SIC",
        "_ws.malformed",
        "_ws.expert.message",
    )
    assert len(read) == len(got)
    plots = 0
    for (category, length, sac, rho, sic, *complaints), datagram in zip(read, got, strict=True):
        assert (int(category), int(length)) == (datagram[0], len(datagram))
        assert complaints == ["", ""]
        records, _ = decode_lenient(datagram)
        if datagram[0] == 48:
            assert {int(value, 0) for value in sac.split(",")} == {25}
            ours = [record.get("I048/040/RHO") for record in records]
            assert [float(value) for value in rho.split(",")] == pytest.approx(ours)
            plots += len(ours)
        else:
            assert int(sic, 0) == 3
    assert plots == totals.plots > 0
