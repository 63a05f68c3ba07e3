"""Small files that would take all of a machine: what they grow to is bounded by what they are."""

from __future__ import annotations

import io
import json
import struct
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import pytest
import zstandard
from mcap.writer import CompressionType, Writer
from support.command import PLOTFEED

# A small process between: a child's memory begins with that of who has started it.
LAUNCHER = """
import json, resource, subprocess, sys
cpu_s, *words = sys.argv[1:]
done = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
resource.prlimit(done.pid, resource.RLIMIT_CPU, (int(cpu_s), int(cpu_s)))
out, err = done.communicate()
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
took = [usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024]
print(json.dumps([done.returncode, out[:1 << 20], err[:1 << 20], *took]))
"""


class Bounded(NamedTuple):
    """What became of a process that may not take too much."""

    returncode: int
    stdout: str
    stderr: str
    cpu_s: float
    memory_mib: float


def bounded(*arguments: object, cpu_s: int, memory_mib: float) -> Bounded:
    """Run it to its end; fails if it takes more than that, which no load of the machine changes.

    The system ends it after so many seconds of processor time.
    """
    words = [sys.executable, "-c", LAUNCHER, str(cpu_s), *PLOTFEED, *map(str, arguments)]
    done = Bounded(*json.loads(subprocess.check_output(words)))
    assert done.returncode >= 0, f"ended by signal {-done.returncode}: {done.stderr[-1000:]}"
    assert "Traceback" not in done.stderr, done.stderr
    assert done.memory_mib <= memory_mib, f"{done.memory_mib:.0f} MiB"
    return done


# Of one command, on a slow machine: starting takes 1 s and 60 MiB of that.
CPU_S, MEMORY_MIB = 30, 300


def by_others(count: int, data: bytes, every_ns: float, chunk_size: int) -> bytes:
    """Messages that are all alike, by somebody else's writer."""
    file = io.BytesIO()
    writer = Writer(file, chunk_size=chunk_size, compression=CompressionType.ZSTD)
    writer.start()
    channel = writer.register_channel("topic", "json", writer.register_schema("", "", b""))
    for i in range(count):
        writer.add_message(channel, log_time=int(i * every_ns), publish_time=0, data=data)
    writer.finish()
    return file.getvalue()


HEAD = struct.Struct("<BQ")
MESSAGE = struct.Struct("<BQHIQQ")
CHUNK = struct.Struct("<QQQI")


def chunk(messages: int, channel: bytes = b"") -> bytes:
    """A chunk that shrinks to next to nothing: one message of no octets again and again."""
    one = MESSAGE.pack(0x05, MESSAGE.size - HEAD.size, 1, 0, 1, 1)
    records = channel + one * messages
    packed = zstandard.ZstdCompressor(level=19).compress(records)
    body = CHUNK.pack(1, 1, len(records), crc32(records))
    body += struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    return HEAD.pack(0x06, len(body)) + body


def bomb(chunks: int, messages: int) -> bytes:
    """Without an index, so that it is looked through as well."""
    text = struct.pack("<I", 1)
    schema = struct.pack("<H", 1) + text + b"s" + text + b"e" + struct.pack("<I", 0)
    channel = struct.pack("<HH", 1, 1) + text + b"t" + text + b"j" + struct.pack("<I", 0)
    told = b"".join(
        HEAD.pack(kind, len(body)) + body for kind, body in ((0x03, schema), (0x04, channel))
    )
    return b"\x89MCAP0\r\n" + chunk(1, told) + chunk(messages) * chunks


PCAP = struct.Struct("<IHHiIII")
PCAP_NG = struct.pack("<IIIHHqI", 0x0A0D0D0A, 28, 0x1A2B3C4D, 1, 0, -1, 28)
# What files of many octets begin with, of which a disk has nothing else; and what is in them.
SPARSE = {
    "zeros.ast": (b"", "no header"),
    "zeros.ff": (b"", "no frames"),
    "zeros.mcap": (b"\x89MCAP0\r\n", "the end: cut"),
    "zeros.pcap": (PCAP.pack(0xA1B2C3D4, 2, 4, 0, 0, 65535, 1), "zeros in place of a packet"),
    "zeros.pcapng": (PCAP_NG, "a block of 0 octets"),
    "zeros.jsonl": (b'{"a": "', "a line of more than"),
}
SPARSE_OCTETS = 1 << 28


def fragments(number: int) -> bytes:
    """First pieces of datagrams whose others never come, each of another host."""
    packets = [PCAP.pack(0xA1B2C3D4, 2, 4, 0, 0, 65535, 101)]
    for i in range(number):
        ip = struct.pack(">BBHHHBBHII", 0x45, 0, 28, i & 0xFFFF, 0x2000, 64, 17, 0, i, 1) + bytes(8)
        packets.append(struct.pack("<IIII", i // 1000, 0, len(ip), len(ip)) + ip)
    return b"".join(packets)


@pytest.mark.parametrize("name", [*SPARSE, "fragments.pcap"])
def test_files_that_hold_nothing_are_damage_in_bounded_memory(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    head, says = SPARSE.get(name, (fragments(300_000), "more"))
    with path.open("wb") as file:
        file.write(head)
        if name in SPARSE:
            file.truncate(SPARSE_OCTETS)
    done = bounded("show", "--list", path, cpu_s=CPU_S, memory_mib=MEMORY_MIB)
    assert done.returncode == 2
    assert says in done.stderr


BOMBS = {
    "one chunk of many": lambda: bomb(1, 8_000_000),
    "many chunks": lambda: bomb(60, 30_000),
    "with an index": lambda: by_others(30_000, b"", 1e-3, 1 << 40),
}


@pytest.mark.parametrize(
    ("command", "name"),
    [
        *((("show", "--list"), name) for name in BOMBS),
        *((command, "many chunks") for command in (("show",), ("report",), ("run",))),
        (("convert", "{}.jsonl"), "many chunks"),
    ],
    ids=str,
)
def test_what_a_file_grows_to_is_bounded(
    command: tuple[str, ...], name: str, tmp_path: Path
) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(BOMBS[name]())
    verb, *rest = (word.format(path) for word in command)
    done = bounded(verb, path, *rest, cpu_s=CPU_S, memory_mib=MEMORY_MIB)
    assert done.returncode in {0, 2}
    damage = [line for line in done.stderr.splitlines() if "octet" in line]
    assert done.returncode == 0 or damage or verb in {"report", "run"}


def test_a_log_that_shrinks_well_is_read_whole(tmp_path: Path) -> None:
    """What sensors say over and over shrinks a hundredfold."""
    path = tmp_path / "a.mcap"
    path.write_bytes(by_others(20_000, b'{"state":"ok"}' * 20, 1e8, 1 << 20))
    done = bounded("show", path, cpu_s=CPU_S, memory_mib=MEMORY_MIB)
    assert done.returncode == 0
    assert "20000 messages" in done.stdout
