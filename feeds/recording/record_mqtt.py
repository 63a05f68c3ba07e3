"""Messages of a broker as they come, with all that came with them."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Callable
from typing import Any

from plotfeed.feeds.messages.message import ReceivedMessage
from plotfeed.feeds.transport.mqtt.address import (
    DEFAULT_PORTS,
    AddressError,
    BrokerAddress,
    without_secrets,
)
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto.utc import utc_ns
from plotfeed.replay.recorded import Recorded

CONNECT_S = 5.0
DEFAULT_FILTER = "plotfeed/#"
RFC_3339 = re.compile(r"\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d(\.\d{1,9})?(Z|[+-]\d\d:\d\d)")


class BrokerSource:
    """The messages of a broker on a topic filter."""

    lost: int | None = None
    """Messages that are known to have been lost on their way; a broker tells none."""

    def __init__(
        self, address: BrokerAddress, topic_filter: str, name: str = "plotfeed-record"
    ) -> None:
        """`name` is how the client calls itself."""
        self.topic_filter = topic_filter
        self.shown = f"{address}/{topic_filter}"
        """Where messages come from, without secrets."""
        self._address = address
        self._name = name
        self._running: asyncio.Task[None] | None = None

    @classmethod
    def parse(cls, url: str, access: dict[str, Any], name: str, *, expected: str) -> BrokerSource:
        """The source at mqtt://HOST:PORT/FILTER; raises `PlotfeedError`.

        `access` holds the keyword arguments of `BrokerAddress.parse`, `expected` is for the error.
        """
        scheme, _, rest = url.partition("://")
        if scheme not in DEFAULT_PORTS:
            raise AddressError(f"{without_secrets(url)!r}: expected {expected}")
        place, _, topic_filter = rest.partition("/")
        address = BrokerAddress.parse(f"{scheme}://{place}", **access)
        return cls(address, topic_filter or DEFAULT_FILTER, name)

    async def open(self, receive: Callable[[Recorded], None]) -> None:
        """Call `receive` with each message from now on; raises `PlotfeedError` without a broker."""
        link = MqttTransport(
            self._address,
            self._name,
            subscribe=[self.topic_filter],
            on_received=lambda message: receive(recorded_of(message, time.time_ns())),
        )
        self._running = asyncio.create_task(link.run(), name=f"link[{self._name}]")
        await link.wait_until_up(CONNECT_S)

    async def close(self) -> None:
        """Receive no more."""
        if self._running is not None:
            self._running.cancel()
            await asyncio.gather(self._running, return_exceptions=True)


def recorded_of(message: ReceivedMessage, now_utc_ns: int) -> Recorded:
    """A received message as it is recorded.

    It was due when its CloudEvents attribute `time` says, if it has one.
    """
    due_utc_ns = rfc_3339_ns(dict(message.properties).get("time", ""))
    topic: str | bytes = message.topic  # which gmqtt gives as octets where they are not UTF-8
    return Recorded(
        topic=topic if isinstance(topic, str) else topic.decode(errors="replace"),
        payload=message.payload,
        log_time_ns=now_utc_ns,
        publish_time_ns=now_utc_ns if due_utc_ns is None else due_utc_ns,
        content_type=message.content_type or "",
        properties=message.properties,
        retain=message.retain,
        qos=message.qos,
    )


def rfc_3339_ns(text: str) -> int | None:
    """UTC, up to nine decimals of the second; None for no such time, or one before 1970."""
    found = utc_ns(text) if RFC_3339.fullmatch(text) else None
    return found if found is not None and found >= 0 else None
