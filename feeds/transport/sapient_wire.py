"""Octets to and from a SAPIENT middleware: framing, and whether the other end reads."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import cast

from plotfeed.feeds.transport.sapient_intake import SapientIntake
from plotfeed.proto.errors import DecodeError

LENGTH_OCTETS = 4
# Of what is taken from a peer; the answers to a sensor are some hundred octets.
MAX_MESSAGE_OCTETS = 1 << 16
MAX_UNSENT_OCTETS = 8 << 20
# While the socket has taken nothing for so long, nothing more is taken; it would come too late.
MAX_STALL_S = 0.5
# That the system takes before it lets us wait: the less, the sooner it shows that nobody reads.
SOCKET_OCTETS = 128 << 10


def framed(payload: bytes) -> bytes:
    """A message as it goes over TCP."""
    return len(payload).to_bytes(LENGTH_OCTETS, "little") + payload


class Deframer:
    """Puts messages together from octets as they come."""

    def __init__(self) -> None:
        self._octets = bytearray()

    def feed(self, octets: bytes) -> None:
        """Take some more octets."""
        self._octets += octets

    @property
    def has_next(self) -> bool:
        """Whether a message is whole, or has a length that is none."""
        length = self._length()
        return length is not None and (
            length > MAX_MESSAGE_OCTETS or len(self._octets) >= LENGTH_OCTETS + length
        )

    def next(self) -> bytes:
        """The message that is whole; raises `DecodeError` at a length that is none."""
        length = self._length() or 0
        if length > MAX_MESSAGE_OCTETS:
            self._octets.clear()
            raise DecodeError(f"a length of {length}; at most {MAX_MESSAGE_OCTETS} is taken")
        end = LENGTH_OCTETS + length
        message = bytes(self._octets[LENGTH_OCTETS:end])
        del self._octets[:end]
        return message

    def _length(self) -> int | None:
        if len(self._octets) < LENGTH_OCTETS:
            return None
        return int.from_bytes(self._octets[:LENGTH_OCTETS], "little")


class SapientWire(asyncio.Protocol):
    """One connection. While what came waits for its turn, no more is read."""

    def __init__(
        self, intake: SapientIntake, on_message: Callable[[bytes], object], give_up_after_s: float
    ) -> None:
        """A peer that has read nothing for `give_up_after_s` is left."""
        self._loop = asyncio.get_running_loop()
        self.lost: asyncio.Future[None] = self._loop.create_future()
        self.reason = ""  # Why it is lost, if that is known
        self.was_stalled = False  # Whether it was given up because the other end did not read
        self._intake, self._on_message = intake, on_message
        self._give_up_after_s = give_up_after_s
        self._deframer = Deframer()
        self._transport: asyncio.Transport | None = None
        self._stalled_since_s: float | None = None
        self._giving_up: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The connection stands."""
        self._transport = cast("asyncio.Transport", transport)
        self._transport.set_write_buffer_limits(high=0)  # to be told as soon as anything waits
        own = transport.get_extra_info("socket")
        own.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_OCTETS)
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # sees also a host that is gone without a word
            own.setsockopt(
                socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(self._give_up_after_s * 1000)
            )

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection is gone, and with it what waited."""
        self._transport = None
        self._intake.forget(self)
        self.resume_writing()
        if isinstance(exc, TimeoutError) and not self.reason:
            self._note_stall()
        elif exc is not None and not self.reason:
            self.reason = (exc.strerror if isinstance(exc, OSError) else None) or str(exc)
        if not self.lost.done():
            self.lost.set_result(None)

    def pause_writing(self) -> None:
        """The socket takes no more for now."""
        self._stalled_since_s = self._loop.time()
        self._giving_up = self._loop.call_later(self._give_up_after_s, self._give_up)

    def resume_writing(self) -> None:
        """The socket takes more again, or is gone."""
        self._stalled_since_s = None
        if self._giving_up is not None:
            self._giving_up.cancel()

    def data_received(self, data: bytes) -> None:
        """Octets have come; no more are read until the messages in them were taken in."""
        self._deframer.feed(data)
        if self._deframer.has_next and self._transport is not None:
            self._transport.pause_reading()
            self._intake.serve(self)

    def hear_one(self) -> int:
        """Take in a message, and say how many octets it had."""
        try:
            message = self._deframer.next()
        except DecodeError as error:  # from here on there is no telling where a message begins
            self.reason = f"it sent {error}"
            self.abort()
            return 0
        self._on_message(message)
        if not self._deframer.has_next and self._transport is not None:
            self._transport.resume_reading()
        return LENGTH_OCTETS + len(message)

    @property
    def has_more(self) -> bool:
        """Whether another message has come, of a connection that is still there."""
        return self._deframer.has_next and self._transport is not None

    @property
    def unsent_octets(self) -> int:
        """What the socket has not taken yet."""
        return self._transport.get_write_buffer_size() if self._transport else 0

    def send(self, payload: bytes) -> bool:
        """Hand a message to the socket; False if it is gone or has stalled."""
        if self._transport is None or self._transport.is_closing():
            return False
        if self._stalled_since_s is not None:
            stall_s = self._loop.time() - self._stalled_since_s
            if stall_s > MAX_STALL_S or self.unsent_octets + len(payload) > MAX_UNSENT_OCTETS:
                return False
        self._transport.write(framed(payload))
        return True

    def close(self) -> None:
        """Close when all is sent."""
        if self._transport is not None:
            self._transport.close()

    def abort(self) -> None:
        """Close at once."""
        if self._transport is not None:
            self._transport.abort()

    def _give_up(self) -> None:
        self._note_stall()
        self.abort()

    def _note_stall(self) -> None:
        self.was_stalled = True
        self.reason = f"it has read nothing for {self._give_up_after_s:g} s"
