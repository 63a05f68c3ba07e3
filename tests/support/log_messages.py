"""Messages as sessions make them, and logs of them."""

from __future__ import annotations

import io
from collections.abc import Iterable

from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.mcap.mcap_writer import McapWriter
from plotfeed.replay.recorded import Attachment, Recorded, Stage

START_NS = 1_767_268_800_000_000_000  # 2026-01-01T12:00:00Z
MS = 1_000_000
SCENE = Attachment(
    name="scene.toml", media_type="application/toml", data=b"[scene]\n", log_time_ns=START_NS
)
STAGES = (Stage.BEFORE, Stage.AFTER)


def messages(count: int, *, octets: int = 40, step_ns: int = MS) -> list[Recorded]:
    """Of four sensors, each before and after its link, with properties; no two alike."""
    return [
        Recorded(
            topic=f"plotfeed/sensor-{n // 2 % 4}/asterix/048",
            payload=n.to_bytes(4, "big") + bytes(octets - 4),
            log_time_ns=START_NS + n * step_ns,
            publish_time_ns=START_NS + n * step_ns - 5 * MS,
            content_type="application/x-asterix; cat=48",
            properties=(("specversion", "1.0"), ("id", f"asterix-048-{n}"), ("scan", str(n // 8))),
            qos=n % 2,
            stage=STAGES[n % 2],
        )
        for n in range(count)
    ]


def log_of(recorded: Iterable[Recorded], *, flush_every: int = 0, close: bool = True) -> bytes:
    """A whole file, or what there is of one that nobody has ended."""
    file = io.BytesIO()
    writer = McapWriter(file, attachments=[SCENE])
    for n, each in enumerate(recorded, 1):
        writer.write(each)
        if flush_every and n % flush_every == 0:
            writer.flush()
    if close:
        writer.close()
    else:
        writer.flush()
    return file.getvalue()


def read(data: bytes) -> tuple[list[Recorded], McapReader]:
    """All messages, and what read them."""
    reader = McapReader(io.BytesIO(data))
    return list(reader.messages()), reader
