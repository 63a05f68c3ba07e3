"""Counts what arrives, and nothing else, so that the machine is left to what is measured.

mosquitto_sub takes 20 us of the processor for each message, as it writes a line for each.
"""

from __future__ import annotations

import time

from plotfeed.testing import MqttReceiver


class Arrivals(MqttReceiver):
    """It hears those topics once it is made, and keeps nothing of what comes."""

    def __init__(self, port: int, topic_filter: str = "plotfeed/+/asterix/#") -> None:
        self._count = 0
        super().__init__(port, 5, topic_filter)

    def _take(self, kind: int, body: bytes) -> None:
        if kind & 0x06:
            super()._take(kind, body)  # it has to be acknowledged
        self._count += kind & 0xF0 == 0x30

    def count(self, settle_s: float = 1.0) -> int:
        """How many messages came; a second later it hears no more."""
        time.sleep(settle_s)
        self.close()
        return self._count
