"""Where the processor time of a session goes, by room: what runs when some of it has passed."""

from __future__ import annotations

import signal
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

EVERY_S = 0.002  # Linux may make it 4 ms
# What a piece of a file's path says; the innermost call that is of any of these counts.
ROOMS = {
    "feeds/engine": "sensing",
    "feeds/formats": "formats",
    "feeds/link": "link",
    "feeds/transport": "transport",
    "feeds/telemetry": "telemetry",
    "feeds/engine/intake.py": "telemetry",
}
# The rest is the loop with its clock and schedule. Physics is sensing, octets are formats.
NAMES = ("sensing", "formats", "link", "transport", "telemetry", "ledger", "the rest")


def room_of(frame: FrameType | None) -> str:
    """Whose work a call is; the ledger's wherever a function or file of that name is at work."""
    found = ""
    while frame is not None:
        code = frame.f_code
        if "ledger" in code.co_name or "ledger" in Path(code.co_filename).stem:
            return "ledger"
        if not found:
            found = next((room for part, room in ROOMS.items() if part in code.co_filename), "")
        frame = frame.f_back
    return found or "the rest"


@contextmanager
def sampled_rooms() -> Iterator[Counter[str]]:
    """Counts meanwhile what this process's main thread works at, by its processor time."""
    counts: Counter[str] = Counter()

    def look(_signal: int, frame: FrameType | None) -> None:
        counts[room_of(frame)] += 1

    before = signal.signal(signal.SIGPROF, look)
    signal.setitimer(signal.ITIMER_PROF, EVERY_S, EVERY_S)
    try:
        yield counts
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
