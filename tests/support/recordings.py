"""Small recordings and logs of sessions, and recordings whose octets are lost or turned."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from hypothesis import strategies as st

from plotfeed.replay.files import FileFormat, format_of_suffix, writer_to
from plotfeed.replay.mcap import McapReader, McapWriter
from plotfeed.replay.recorded import (
    LATEST_NS,
    Attachment,
    Recorded,
    RecordingReader,
    RecordingWriter,
    Stage,
)

START_NS = 1_767_268_800_000_000_000  # 2026-01-01T12:00:00Z
MS = 1_000_000
TIMES, TEXTS = st.integers(0, LATEST_NS), st.text(max_size=10)
# All that a message can be.
MESSAGES = st.builds(
    Recorded,
    topic=TEXTS,
    payload=st.binary(max_size=30),
    log_time_ns=TIMES,
    publish_time_ns=TIMES,
    content_type=TEXTS,
    properties=st.lists(st.tuples(TEXTS, TEXTS), max_size=3).map(tuple),
    retain=st.booleans(),
    qos=st.integers(0, 2),
    stage=st.sampled_from(Stage),
)


def block(category: int, *parts: str) -> bytes:
    """A data block of a record in hexadecimal."""
    body = bytes.fromhex("".join(parts))
    return bytes([category]) + (3 + len(body)).to_bytes(2, "big") + body


def block_048(time_s: float, sic: int = 13) -> bytes:
    """A plot of SAC 25, 128 NM away in the east."""
    return block(48, "f0", "19", f"{sic:02x}", f"{round(time_s * 128):06x}", "20", "80004000")


def message(payload: bytes, t_utc_ns: int = START_NS, **more: object) -> Recorded:
    given = {
        "topic": "plotfeed/radar/asterix/048",
        "log_time_ns": t_utc_ns,
        "publish_time_ns": t_utc_ns,
        "content_type": "application/x-asterix; cat=48",
    }
    return Recorded(payload=payload, **given | more)  # type: ignore[arg-type]


def plots(count: int, *, step_ns: int = 10 * MS, **more: object) -> list[Recorded]:
    """A message of one plot every step."""
    return [
        message(block_048(43_200 + n * step_ns / 1e9), START_NS + n * step_ns, **more)
        for n in range(count)
    ]


def written(make: Callable[[io.BytesIO], RecordingWriter], messages: Sequence[Recorded]) -> bytes:
    """A file of all these messages."""
    file = io.BytesIO()
    writer = make(file)
    assert [writer.write(each) for each in messages] == [None] * len(messages)
    writer.close()
    return file.getvalue()


def stored(path: Path, messages: Sequence[Recorded], form: FileFormat | None = None) -> Path:
    """A file of these messages, in the format of its suffix where no other is asked for."""
    kind = form or format_of_suffix(path)
    path.write_bytes(written(lambda file: writer_to(file, kind), messages))
    return path


def read(
    make: Callable[[io.BytesIO], RecordingReader], data: bytes
) -> tuple[list[Recorded], RecordingReader]:
    """The messages of a file, and what read them."""
    reader = make(io.BytesIO(data))
    return list(reader.messages()), reader


def cut(data: bytes) -> Iterator[bytes]:
    """Every shorter beginning."""
    return (data[:octets] for octets in range(len(data)))


def turned(data: bytes) -> Iterator[bytes]:
    """With each octet changed, in several ways."""
    for at, octet in enumerate(data):
        for mask in (0x01, 0x80, 0xFF):
            yield data[:at] + bytes([octet ^ mask]) + data[at + 1 :]


def left_out(data: bytes) -> Iterator[bytes]:
    """Without each of its octets."""
    return (data[:at] + data[at + 1 :] for at in range(len(data)))


def is_read_whatever_it_is(
    make: Callable[[io.BytesIO], RecordingReader], data: bytes, *, other_parts: int = 0
) -> None:
    """What is whole of it comes out, and what is not is told of within the file.

    A file that ends between messages, or between so many other parts, is not known to be cut.
    """
    whole, _ = read(make, data)
    untold = 0
    for damaged in cut(data):
        messages, reader = read(make, damaged)
        assert messages == whole[: len(messages)]
        assert reader.at <= len(damaged)
        assert all(0 <= each.offset <= len(damaged) for each in reader.damage)
        untold += not reader.damage
    assert untold <= len(whole) + other_parts
    for damaged in (*turned(data), *left_out(data)):
        messages, reader = read(make, damaged)
        assert len(messages) <= len(damaged)
        assert all(0 <= each.offset <= len(damaged) for each in reader.damage)
        assert all("\n" not in each.what for each in reader.damage)


SCENE = Attachment(
    name="scene.toml", media_type="application/toml", data=b"[scene]\n", log_time_ns=START_NS
)
STAGES = (Stage.BEFORE, Stage.AFTER)


def messages(count: int, *, octets: int = 40) -> list[Recorded]:
    """Of four sensors, each before and after its link, with properties; no two alike."""
    return [
        Recorded(
            topic=f"plotfeed/sensor-{n // 2 % 4}/asterix/048",
            payload=n.to_bytes(4, "big") + bytes(octets - 4),
            log_time_ns=START_NS + n * MS,
            publish_time_ns=START_NS + n * MS - 5 * MS,
            content_type="application/x-asterix; cat=48",
            properties=(("specversion", "1.0"), ("id", f"asterix-048-{n}"), ("scan", str(n // 8))),
            qos=n % 2,
            stage=STAGES[n % 2],
        )
        for n in range(count)
    ]


def mcap_of(
    recorded: Iterable[Recorded],
    *,
    attachments: Sequence[Attachment] = (SCENE,),
    flush_every: int = 0,
    close: bool = True,
    flushes: int = 1,
) -> bytes:
    """A whole file, or what there is of one that nobody has ended."""
    file = io.BytesIO()
    writer = McapWriter(file, attachments=attachments, library="plotfeed test")
    for n, each in enumerate(recorded, 1):
        writer.write(each)
        if flush_every and n % flush_every == 0:
            writer.flush()
    if close:
        writer.close()
    for _ in range(0 if close else flushes):
        writer.flush()
    return file.getvalue()


def read_log(data: bytes) -> tuple[list[Recorded], McapReader]:
    """All messages, and what read them."""
    reader = McapReader(io.BytesIO(data))
    return list(reader.messages()), reader
