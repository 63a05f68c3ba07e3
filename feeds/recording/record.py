"""A broker's messages, or datagrams, into a file: until it is stopped, or is full of them."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import time
from pathlib import Path
from typing import Any

from plotfeed.feeds.console import FAILED, INTERRUPTED
from plotfeed.feeds.console.printed import say
from plotfeed.feeds.console.process import refuse_if_there, stopped_by_signals
from plotfeed.feeds.console.status_line import interval_s, show_last_status, show_status
from plotfeed.feeds.messages.message import checked_topic_filter
from plotfeed.feeds.recording.record_sources import BrokerSource, UdpSource
from plotfeed.feeds.recording.recorder import SUFFIX, Recorder
from plotfeed.feeds.recording.recording_settings import RecordSettings
from plotfeed.feeds.scene.output_keys import Endpoint
from plotfeed.feeds.transport.mqtt.address import (
    DEFAULT_PORTS,
    AddressError,
    without_secrets,
)
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.recorded import Recorded

MAX_TOPICS = 65_536  # That are counted


LIVE = "mqtt://HOST:PORT/TOPIC-FILTER or udp://ADDRESS:PORT"
CaptureSource = BrokerSource | UdpSource


def source_of(
    url: str,
    access: dict[str, Any],
    interface: str | None,
    name: str = "plotfeed-record",
    expected: str = LIVE,
) -> CaptureSource:
    """The source at mqtt://HOST:PORT/FILTER or udp://ADDRESS:PORT; raises `PlotfeedError`.

    `access` holds the keyword arguments of `BrokerAddress.parse`, `name` is that of the client,
    and `expected` is what an error says is wanted.
    """
    scheme, _, rest = url.partition("://")
    if scheme == "udp":
        try:
            return UdpSource(Endpoint.parse(rest.rstrip("/")), interface)
        except ValueError as error:
            raise AddressError(f"{without_secrets(url)}: {error}") from None
    if interface is not None and scheme in DEFAULT_PORTS:
        raise AddressError("--interface: only for udp://")
    source = BrokerSource.parse(url, access, name, expected=expected)
    checked_topic_filter(source.topic_filter)
    return source


def record_source(url: str, target: Path, access: dict[str, Any], settings: RecordSettings) -> int:
    """Record until it is stopped or has enough; the exit code.

    Raises `PlotfeedError`, and `OSError` if the file cannot be written.
    """
    source = source_of(url, access, settings.interface)
    if target.suffix.lower() != SUFFIX:
        raise PlotfeedError(
            f"{target}: expected a name that ends in {SUFFIX}, of which plotfeed convert makes more"
        )
    refuse_if_there(target, force=settings.force)
    return asyncio.run(_Recording(source, target, settings).run())


class _Recording:
    """One source into one file."""

    def __init__(self, source: CaptureSource, target: Path, settings: RecordSettings) -> None:
        self._source = source
        self._target = target
        self._settings = settings
        self._stop = asyncio.Event()
        self._topics: set[str] = set()
        self._early: list[Recorded] = []  # What comes before there is a file for it
        self._recorder: Recorder | None = None
        self._told = 0  # Messages when the last status line was written

    async def run(self) -> int:
        """The exit code."""
        began_s = time.monotonic()
        try:
            await self._source.open(self._receive)
            with stopped_by_signals(self._stop.set) as signals:
                recorder = self._recorder = Recorder(self._target, force=self._settings.force)
                try:
                    await self._work(recorder)
                    await self._source.close()
                finally:
                    await recorder.stop()
        finally:
            await self._source.close()
        self._conclude(recorder, time.monotonic() - began_s)
        if recorder.failure:
            return FAILED
        return INTERRUPTED if signal.SIGINT in signals else 0

    async def _work(self, recorder: Recorder) -> None:
        for recorded in self._early:
            self._receive(recorded)
        if not self._settings.as_json:
            say(f"recording {self._source.shown} to {self._target}; stop: Ctrl-C")
            sys.stdout.flush()
        flushing = asyncio.create_task(recorder.run(), name="flush")
        stopping = asyncio.create_task(self._stop.wait(), name="stop")
        tasks: set[asyncio.Task[Any]] = {flushing, stopping}
        if not self._settings.as_json:
            status = show_status(lambda: self._status(recorder))
            tasks.add(asyncio.create_task(status, name="status"))
        duration_s = self._settings.duration
        await asyncio.wait(tasks, timeout=duration_s, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _receive(self, recorded: Recorded) -> None:
        if self._recorder is None:
            self._early.append(recorded)
            return
        count = self._settings.count
        if count is not None:
            if self._recorder.messages >= count:
                return
            if self._recorder.messages == count - 1:
                self._stop.set()
        self._recorder.write(recorded)
        if len(self._topics) < MAX_TOPICS:
            self._topics.add(recorded.topic)

    def _status(self, recorder: Recorder) -> str:
        rate = (recorder.messages - self._told) / interval_s()
        self._told = recorder.messages
        return f"{self._line(recorder)}  {rate:.0f}/s"

    def _line(self, recorder: Recorder) -> str:
        text = (
            f"messages {recorder.messages}  topics {len(self._topics)}  "
            f"{recorder.octets / 1e6:.2f} MB"
        )
        lost = (self._source.lost or 0) + recorder.dropped + recorder.refused
        return f"{text}  lost {lost}" if lost else text

    def _conclude(self, recorder: Recorder, lasted_s: float) -> None:
        """The totals, and what is missing."""
        lost = self._source.lost
        if self._settings.as_json:
            totals = {
                "file": str(self._target),
                "messages": recorder.messages,
                "octets": recorder.octets,
                "topics": len(self._topics),
                "seconds": round(lasted_s, 3),
                "lost": lost,
                "dropped": recorder.dropped,
                "refused": recorder.refused,
            }
            say(json.dumps(totals))
        else:
            show_last_status(self._line(recorder))
        if lost:
            say(f"plotfeed: {lost} datagrams were lost: the socket had no room", err=True)
        for line in recorder.losses():
            say(f"plotfeed: {line}", err=True)
