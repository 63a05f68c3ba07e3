"""Messages of a broker as they come, with all that came with them."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Callable
from datetime import UTC, datetime

from plotfeed.feeds.messages.message import ReceivedMessage
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttLink
from plotfeed.proto.utc import NS
from plotfeed.replay.recorded import Recorded

CONNECT_S = 5.0
TIME = re.compile(r"(\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?(Z|[+-]\d\d:\d\d)")
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class BrokerSource:
    """The messages of a broker on a topic filter."""

    lost: int | None = None

    def __init__(self, address: BrokerAddress, topic_filter: str) -> None:
        self.shown = f"{address}/{topic_filter}"
        self._address = address
        self._filter = topic_filter
        self._running: asyncio.Task[None] | None = None

    async def open(self, hear: Callable[[Recorded], None]) -> None:
        """Call `hear` with each message from now on; raises `PlotfeedError` without a broker."""
        link = MqttLink(
            self._address,
            "plotfeed-record",
            subscribe=[self._filter],
            on_heard=lambda heard: hear(recorded_of(heard, time.time_ns())),
        )
        self._running = asyncio.create_task(link.run(), name="link[record]")
        await link.wait_until_up(CONNECT_S)

    async def close(self) -> None:
        """Hear no more."""
        if self._running is not None:
            self._running.cancel()
            await asyncio.gather(self._running, return_exceptions=True)


def recorded_of(heard: ReceivedMessage, now_utc_ns: int) -> Recorded:
    """As it is recorded: it was due when its CloudEvents attribute `time` says, if it has one."""
    due_utc_ns = utc_ns(dict(heard.properties).get("time", ""))
    topic: str | bytes = heard.topic  # which gmqtt gives as octets where they are not UTF-8
    return Recorded(
        topic=topic if isinstance(topic, str) else topic.decode(errors="replace"),
        payload=heard.payload,
        log_time_ns=now_utc_ns,
        publish_time_ns=now_utc_ns if due_utc_ns is None else due_utc_ns,
        content_type=heard.content_type or "",
        properties=heard.properties,
        retain=heard.retain,
        qos=heard.qos,
    )


def utc_ns(text: str) -> int | None:
    """Of RFC 3339, with up to nine decimals; None for anything else, or a time before 1970."""
    found = TIME.fullmatch(text)
    if found is None:
        return None
    try:
        moment = datetime.fromisoformat(found[1] + found[3].replace("Z", "+00:00"))
    except ValueError:
        return None
    since = moment - EPOCH
    ns = (since.days * 86_400 + since.seconds) * NS + int((found[2] or "").ljust(9, "0"))
    return ns if ns >= 0 else None
