"""Messages of a recording as if they had been sent later: the times inside them moved.

What cannot be moved is left alone, counted, and said once.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable

from plotfeed.proto.asterix.codec.retime_asterix import Retimer
from plotfeed.proto.content_types import ASTERIX, JSON, SAPIENT_MESSAGE
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.message_kinds import OUR_MESSAGES, kind_of
from plotfeed.proto.retime import retime_json, retime_protobuf, retime_text
from plotfeed.replay.recorded import UDP_TOPIC, Recorded

log = logging.getLogger(__name__)

TIME = "time"  # The user property that CloudEvents tells the time of a message by
MOST_SAID = 20

Mover = Callable[[bytes, int], bytes]  # A payload and a shift in nanoseconds; raises `DecodeError`


class Restamper:
    """Moves the times in messages."""

    def __init__(self, left: Counter[str]) -> None:
        """`left` counts the messages, or parts of them, that are left alone, by what they are."""
        self._left = left
        self._asterix = Retimer()
        self._movers: dict[str, Mover | None] = {}  # By the kind of message

    def payload(self, recorded: Recorded, shift_ns: int) -> bytes:
        """The message's payload, its times later by that."""
        kind = kind_of(recorded.topic, recorded.content_type, recorded.payload)
        if not kind and recorded.topic.startswith(UDP_TOPIC):
            kind = ASTERIX
        if kind not in self._movers:
            self._movers[kind] = self._mover(kind)
        mover = self._movers[kind]
        if mover is None:
            what = recorded.content_type or "octets that nothing is said of"
            self._leave(f"{what} on {recorded.topic}")
            return recorded.payload
        try:
            return mover(recorded.payload, shift_ns)
        except DecodeError as error:
            self._leave(f"messages on {recorded.topic}: {error}")
            return recorded.payload

    def properties(self, recorded: Recorded, shift_ns: int) -> tuple[tuple[str, str], ...]:
        """The message's user properties, their times later by that."""
        return tuple(
            (name, self._text(value, shift_ns) if name == TIME else value)
            for name, value in recorded.properties
        )

    def _text(self, text: str, shift_ns: int) -> str:
        try:
            return retime_text(text, shift_ns)
        except ValueError:
            self._leave("a property time that is none")
            return text

    def _leave(self, what: str) -> None:
        if what not in self._left and len(self._left) < MOST_SAID:
            log.warning("left alone: %s", what)
        if what in self._left or len(self._left) < MOST_SAID:
            self._left[what] += 1
        else:
            self._left["others"] += 1

    def _mover(self, kind: str) -> Mover | None:
        """What moves such messages; None where nothing does."""
        if kind == ASTERIX:
            return self._move_asterix
        if kind == JSON:
            return retime_json
        if kind == SAPIENT_MESSAGE:
            try:
                from plotfeed.proto.sapient.decode_sapient import retime_sapient
            except ImportError:  # the extra is not installed
                return None
            return retime_sapient
        ours = OUR_MESSAGES.get(kind)
        if ours is None:
            return None
        return lambda data, shift_ns: retime_protobuf(data, ours, shift_ns)

    def _move_asterix(self, data: bytes, shift_ns: int) -> bytes:
        done = self._asterix.retime(data, shift_ns)
        for what in done.left:
            self._leave(what)
        return done.octets
