"""What a live source says, published over MQTT as telemetry, until it ends or is stopped."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import time
from collections import Counter

from plotfeed.feeds.cli.inject import (
    CONNECT_S,
    MOST_REFUSALS_TOLD,
    InjectedSource,
    completed,
    keys_of,
)
from plotfeed.feeds.cli.inject_settings import InjectSettings
from plotfeed.feeds.cli.session_answers import SessionAnswers
from plotfeed.feeds.console import FAILED, INTERRUPTED
from plotfeed.feeds.console.printed import say
from plotfeed.feeds.console.process import stopped_by_signals
from plotfeed.feeds.console.status_line import show_last_status, show_status
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.outgoing import Outgoing, publish
from plotfeed.feeds.telemetry.decode_reports import encode_json, encode_protobuf
from plotfeed.feeds.telemetry.position_report import PositionReport, Refused
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.live_source import LiveSource
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto.content_types import JSON, PROTOBUF
from plotfeed.proto.errors import PlotfeedError

MAX_DRONES_TOLD = 5
MAX_DRONES = 10_000  # That are told apart in the counts


def publish_source(url: str, settings: InjectSettings, broker: BrokerAddress) -> int:
    """Listen and publish; the exit code. Raises `PlotfeedError`."""
    if settings.speed != 1 or settings.shift or settings.raw:
        raise PlotfeedError(f"{url}: --speed, --now and --raw are for files")
    source = keys_of(InjectedSource, settings, url=url, drone=settings.drone)
    return asyncio.run(_Relay(source, settings, broker).run(settings.duration))


class _Relay:
    """Reports on their way from a source to a broker, and what becomes of them."""

    def __init__(
        self, source: InjectedSource, settings: InjectSettings, broker: BrokerAddress
    ) -> None:
        self._keys, self._settings = source, settings
        self._clock = WallClock()
        self._template = source.template
        self._source = LiveSource(
            source, now_utc_ns=time.time_ns, take=self._take, refuse=self._refuse
        )
        self._encode, self._content_type = encode_protobuf, PROTOBUF
        if settings.encoding == "json":
            self._encode, self._content_type = encode_json, JSON
        self._answers = SessionAnswers(settings.prefix, "")
        self._link = MqttTransport(
            broker, "plotfeed-inject", subscribe=self._answers.topics, on_message=self._answers.hear
        )
        self._drones: dict[str, None] = {}
        self._refused: Counter[str] = Counter()
        self._details: dict[str, str] = {}
        self._sent = self._undelivered = 0

    async def run(self, duration_s: float | None) -> int:
        """Listen until the end of the source or of the time, or until stopped."""
        stop = asyncio.Event()
        async with contextlib.AsyncExitStack() as opened:
            opened.callback(self._clock.close)
            opened.callback(self._source.close)
            await self._source.open()
            await opened.enter_async_context(self._link.connected(CONNECT_S))
            signals = opened.enter_context(stopped_by_signals(stop.set))
            await self._answers.begin()
            if self._answers.scene is None:
                prefix = self._settings.prefix
                say(f"plotfeed: no session says on {prefix}/session that it runs", err=True)
            say(f"listens to {self._source.name}, drones are {self._template}; stop: Ctrl-C")
            await self._listen(duration_s, stop)
            await self._link.drain()
            await self._answers.end()
        self._conclude()
        if signal.SIGINT in signals:
            return INTERRUPTED
        return FAILED if self._undelivered or not self._sent else 0

    async def _listen(self, duration_s: float | None, stop: asyncio.Event) -> None:
        tasks = [
            asyncio.create_task(self._source.run(), name="source"),
            asyncio.create_task(stop.wait(), name="stop"),
        ]
        status = asyncio.create_task(show_status(self._line), name="status")
        try:
            done, _ = await asyncio.wait(
                tasks, timeout=duration_s, return_when=asyncio.FIRST_COMPLETED
            )
            for task in done:
                task.result()
        finally:
            for task in (*tasks, status):
                task.cancel()
            await asyncio.gather(*tasks, status, return_exceptions=True)

    def _line(self) -> str:
        return (
            f"drones {len(self._drones)}  reports {self._sent}  "
            f"not taken {self._refused.total()}  undelivered {self._undelivered}"
        )

    def _conclude(self) -> None:
        show_last_status(self._line())
        told = ", ".join(list(self._drones)[:MAX_DRONES_TOLD])
        more = len(self._drones) - MAX_DRONES_TOLD
        say(f"drones: {told or 'none'}{f' and {more} more' if more > 0 else ''}")
        for reason, number in self._refused.most_common(MOST_REFUSALS_TOLD):
            say(f"plotfeed: not taken: {reason} {number}: {self._details[reason]}", err=True)
        meanwhile = self._answers.refused_meanwhile
        if meanwhile:
            reasons = ", ".join(f"{why} {n}" for why, n in meanwhile.most_common())
            say(f"plotfeed: meanwhile the session refused, of all that came: {reasons}", err=True)

    def _take(self, drone: str, report: PositionReport) -> None:
        if len(self._drones) < MAX_DRONES:
            self._drones[drone] = None
        message = Message(
            topic=f"{self._settings.prefix}/telemetry/{drone}",
            payload=self._encode(completed(self._keys, report)),
            content_type=self._content_type,
            due_utc_ns=report.t_utc_ns,
        )
        publish([self._link], [Outgoing(message, client=self, transports=1)])

    def _refuse(self, drone: str, refused: Refused) -> None:
        self._refused[refused.reason] += 1
        whose = f"{drone}: " if drone else ""
        self._details.setdefault(refused.reason, whose + refused.detail)

    def now_ns(self) -> int:
        """The time at which a report leaves, UTC."""
        return self._clock.now_ns()

    def settled(self, one: Outgoing) -> None:
        """Count what became of a report."""
        self._sent += one.delivered
        self._undelivered += not one.delivered
