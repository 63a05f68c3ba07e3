"""Counts what arrives, and nothing else, so that the machine is left to what is measured.

mosquitto_sub takes 20 us of the processor for each message, as it writes a line for each.
"""

from __future__ import annotations

import time
from contextlib import suppress

from plotfeed.testing import MqttReceiver

AT_ONCE = 1 << 20  # Octets that are read together
PUBLISH = 3


class Arrivals(MqttReceiver):
    """It hears those topics once it is made, and keeps nothing of what comes."""

    def __init__(self, port: int, topic_filter: str = "plotfeed/+/asterix/#") -> None:
        self._count = 0
        super().__init__(port, 5, topic_filter)

    def _read(self) -> None:
        data = b""
        with suppress(OSError):
            while more := self._socket.recv(AT_ONCE):
                data = self._counted(data + more)

    def _counted(self, data: bytes) -> bytes:
        """Count the messages that have come whole; what is left is the beginning of another."""
        at = found = 0
        with suppress(IndexError):  # the length of a packet has not come whole
            while True:
                head, length, shift = at + 1, 0, 0
                while True:
                    octet = data[head]
                    length |= (octet & 0x7F) << shift
                    head += 1
                    shift += 7
                    if octet < 0x80:
                        break
                if head + length > len(data):
                    break
                assert not data[at] & 0x06, "what is counted is sent with QoS 0"
                found += data[at] >> 4 == PUBLISH
                at = head + length
        self._count += found
        return data[at:]

    def count(self, settle_s: float = 1.0) -> int:
        """How many messages came; a second later it hears no more."""
        time.sleep(settle_s)
        self.close()
        return self._count
