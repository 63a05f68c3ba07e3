"""Our MCAP beside the official library's: writing, reading, and finding a time.

    python tools/benchmarks/bench_log.py [messages to find a time in]

Both write zstd chunks of 256 KiB with an index to memory, in turns, and the same contents: messages
without user properties, and with the eight that each message of a session bears, which both put
beside it as JSON on a channel of their own. Payloads are half noise. The file in which a time is
found lies in the folder for temporary files and is deleted again.
"""

from __future__ import annotations

import io
import json
import random
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from aims import aim, ratios, spread
from mcap.reader import make_reader
from mcap.writer import Writer

from plotfeed.replay.mcap import CHUNK_OCTETS, McapReader, McapWriter
from plotfeed.replay.recorded import Recorded, Stage

OFFICIAL, RICH = "official mcap", "with 8 user properties"
REPEATS = 5
PAYLOAD_OCTETS = 10_000_000  # Of all messages of a turn, about
MESSAGES_TO_SEEK = 5_000_000
SEEK_AIM_MS = 50
START_NS, STEP_NS = 1_767_268_800_000_000_000, 50_000
TOPICS = [f"plotfeed/sensor-{n}/asterix/048" for n in range(8)]
PROPERTIES = (
    ("specversion", "1.0"),
    ("source", "plotfeed/sensor-0"),
    ("type", "plotfeed.asterix.048"),
    ("time", "2026-01-01T12:00:00.123456789Z"),
    ("sensor", "sensor-0"),
)


def recorded(n: int, payload: bytes, *, with_properties: bool = False) -> Recorded:
    """The nth message."""
    more = (*PROPERTIES, ("id", f"asterix-048-{n}"), ("scan", str(n // 64)), ("sector", str(n % 8)))
    return Recorded(
        topic=TOPICS[n % len(TOPICS)],
        payload=payload,
        log_time_ns=START_NS + n * STEP_NS,
        publish_time_ns=START_NS + n * STEP_NS - 1000,
        content_type="application/x-asterix; cat=48",
        properties=more if with_properties else (),
        stage=Stage.AFTER,
    )


def payloads(octets: int) -> list[bytes]:
    """Half of each is noise; a chunk holds none twice."""
    rng = random.Random(1)  # noqa: S311
    half = octets // 2
    return [rng.randbytes(half) + bytes(octets - half) for _ in range(600_000 // octets)]


def write_ours(messages: list[Recorded]) -> bytes:
    """As a session does, but compressing at once."""
    file = io.BytesIO()
    writer = McapWriter(file)
    for message in messages:
        writer.write(message)
    writer.close()
    return file.getvalue()


def write_official(messages: list[Recorded]) -> bytes:
    """As an application would, with the official library: its properties beside each message."""
    file = io.BytesIO()
    writer = Writer(file, chunk_size=CHUNK_OCTETS)
    writer.start()
    channels: dict[str, tuple[int, int]] = {}
    for n, message in enumerate(messages):
        if message.topic not in channels:
            metadata = {"content_type": message.content_type}
            channels[message.topic] = (
                writer.register_channel(message.topic, "asterix", 0, metadata),
                writer.register_channel(f"properties/{message.topic}", "json", 0, metadata),
            )
        channel, beside = channels[message.topic]
        log_ns, publish_ns = message.log_time_ns, message.publish_time_ns
        if message.properties:
            properties = json.dumps(dict(message.properties)).encode()
            writer.add_message(beside, log_ns, properties, publish_ns, n)
        writer.add_message(channel, log_ns, message.payload, publish_ns, n)
    writer.finish()
    return file.getvalue()


def read_ours(data: bytes) -> int:
    """How many messages."""
    return sum(1 for _ in McapReader(io.BytesIO(data)).messages())


def read_official(data: bytes) -> int:
    """How many messages; their properties are put beside them."""
    count, properties = 0, {}
    for _, channel, message in make_reader(io.BytesIO(data), validate_crcs=True).iter_messages():
        if channel.topic.startswith("properties/"):
            properties[channel.topic, message.sequence] = json.loads(message.data)
        else:
            properties.pop((f"properties/{channel.topic}", message.sequence), None)
            count += 1
    return count


def seconds(call: Callable[[], object]) -> float:
    """That one call takes."""
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def throughput(octets: int) -> None:
    """Prints the lines of one size of payload."""
    pool, count = payloads(octets), PAYLOAD_OCTETS // (octets + 100)
    plain = [recorded(n, pool[n % len(pool)]) for n in range(count)]
    rich = [recorded(n, pool[n % len(pool)], with_properties=True) for n in range(count)]
    methods: dict[str, tuple[Callable[[], bytes], Callable[[bytes], int]]] = {
        OFFICIAL: (lambda: write_official(plain), read_official),
        "plotfeed": (lambda: write_ours(plain), read_ours),
        f"{OFFICIAL}, {RICH}": (lambda: write_official(rich), read_official),
        f"plotfeed, {RICH}": (lambda: write_ours(rich), read_ours),
    }
    writing: dict[str, list[float]] = {name: [] for name in methods}
    reading: dict[str, list[float]] = {name: [] for name in methods}
    sizes = {}
    for _ in range(REPEATS):
        for name, (write, read) in methods.items():
            written: list[bytes] = []
            writing[name].append(seconds(lambda: written.append(write())))  # noqa: B023
            assert read(written[0]) == count
            reading[name].append(seconds(lambda: read(written[0])))  # noqa: B023
            sizes[name] = len(written[0]) / count / octets
    for name in methods:
        theirs = name.replace("plotfeed", OFFICIAL)
        cells = [
            f"{spread((count / each / 1e3 for each in times[name]), '.0f')} | "
            f"{spread(ratios(times[theirs], times[name]), '.1f')}"
            for times in (writing, reading)
        ]
        print(f"| {name} | {octets} | {' | '.join(cells)} | {sizes[name]:.2f} |", flush=True)


def hand_over() -> None:
    """How long a chunk holds up whoever records, and the thread that compresses it."""
    message = recorded(0, payloads(100)[0])
    works: list[Callable[[], None]] = []
    ending, storing = [], []
    writer = McapWriter(io.BytesIO(), run=works.append)
    for _ in range(200):
        while writer._octets < CHUNK_OCTETS - 200:
            writer.write(message)
        ending.append(seconds(writer.flush))
        storing.append(seconds(works.pop()))
    print(
        f"\nA chunk of {CHUNK_OCTETS >> 10} KiB keeps whoever records for "
        f"{statistics.median(ending) * 1e6:.0f} µs; compressing and writing it takes a thread "
        f"{statistics.median(storing) * 1e3:.2f} ms."
    )


def seek(count: int) -> None:
    """Opening a large file and its first message in the middle."""
    pool = payloads(100)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.mcap"
        with path.open("wb") as file:
            writer = McapWriter(file)
            for n in range(count):
                writer.write(recorded(n, pool[n % len(pool)]))
            writer.close()
        middle_ns = START_NS + count // 2 * STEP_NS
        ours, official = [], []
        for _ in range(2 * REPEATS + 1):
            ours.append(seconds(lambda: _ours_at(path, middle_ns)) * 1e3)
            official.append(seconds(lambda: _official_at(path, middle_ns)) * 1e3)
        size = path.stat().st_size
    ours_ms = statistics.median(ours)
    print(
        f"\nOpening a file of {count:,} messages ({size / 1e6:.0f} MB) and its first message in "
        f"the middle: {spread(ours, '.1f')} ms, the official library {spread(official, '.0f')} ms, "
        f"{spread(ratios(official, ours), '.1f')} times as much.\n"
    )
    what, found = "its first message in the middle", f"{ours_ms:.1f} ms"
    print(aim(what, f"{SEEK_AIM_MS} ms", found, is_met=ours_ms < SEEK_AIM_MS))


def _ours_at(path: Path, t_ns: int) -> None:
    with McapReader(path) as reader:
        assert next(reader.messages(t_ns)).log_time_ns == t_ns


def _official_at(path: Path, t_ns: int) -> None:
    with path.open("rb") as file:
        _, _, message = next(make_reader(file).iter_messages(starting_at=t_ns))
        assert message.log_time == t_ns


def main(count: int) -> None:
    """Print everything."""
    print(f"Thousand messages a second: median (least to most) of {REPEATS} repeats; × is times")
    print(
        "as fast as the official library with the same contents. Size is that of the file by that"
    )
    print("of the payloads.\n")
    print("| | octets | write | × | read | × | size |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    for octets in (100, 1400):
        throughput(octets)
    hand_over()
    seek(count)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else MESSAGES_TO_SEEK)
