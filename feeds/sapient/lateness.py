"""Messages of SAPIENT that a link delays: a middleware takes none whose stamp is 0.9 s old."""

from __future__ import annotations

import contextlib
from dataclasses import replace

from plotfeed.feeds.message import Message
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.sapient.restamp import restamped

MAX_LATE_NS = 800_000_000
"""A stamp may be a group of sectors older, up to 94 ms, and the last way takes some time too."""


def as_it_may_leave(message: Message, t_utc_ns: int, rule: str) -> Message | None:
    """The message as it leaves at that time, or None if it is dropped."""
    if t_utc_ns - message.due_utc_ns <= MAX_LATE_NS or rule == "send":
        return message
    if rule == "drop":
        return None
    with contextlib.suppress(DecodeError):  # of a message that the link has corrupted
        return replace(message, payload=restamped(message.payload, t_utc_ns))
    return message
