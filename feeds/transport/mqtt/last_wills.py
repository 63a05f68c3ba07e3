"""Last wills of many beside one link: connections that carry nothing, each with a will of its own.

A broker takes one will a connection, and a sensor that dies with its session must be OFFLINE for
whoever listens.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Mapping
from uuid import uuid4

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.transport.mqtt.client import CONNECT_TIMEOUT_S, MqttTransport
from plotfeed.feeds.transport.mqtt.connection import MqttConnection, MqttError
from plotfeed.feeds.transport.ways_out import backoff_s

log = logging.getLogger(__name__)

# Connections that are made at a time: a broker has a queue for those that come, and others wait for
# the loop.
AT_ONCE = 10
FIRST_LOOK_S, LOOK_EVERY_S = 0.01, 0.25  # The latter from one look at what is lost to the next
# A broker takes a connection for lost, and publishes its will, after 1.5 times that.
PROMPT_KEEP_ALIVE_S = 3
PATIENCE_S = 1.0  # So long a session waits for its wills before it begins without the last of them


class LastWills:
    """A connection for each will, kept up while `run` runs and as long as the link beside it is.

    One that was lost is made again, and then `on_back` is told whose it is, since the broker has
    published its will.
    """

    def __init__(
        self,
        link: MqttTransport,
        wills: Mapping[str, Message],
        on_back: Callable[[str], object],
        *,
        stem: str | None = None,
        prompt: str = "",
    ) -> None:
        """`wills` are retained messages by whose they are; those that join before `run` count.

        With a `stem` of client ids, they are those that another process may have had before, and
        `on_back` is told of the first time too. Then the will that is named by `prompt` is
        published within 1.5 times `PROMPT_KEEP_ALIVE_S` where a machine is gone.
        """
        self.name = f"{link.name}-wills"
        self._link = link
        self._wills = wills
        self._on_back = on_back
        self._stem = stem
        self._prompt = prompt if stem is not None else ""
        self._client_ids: dict[str, str] = {}
        self._connections: dict[str, MqttConnection] = {}  # By whose they are, up or lost
        self._placed = asyncio.Event()  # All wills have been placed once, or it has been tried
        self._complained = False
        self._forgotten = False

    async def wait_until_up(self, timeout_s: float | None = None) -> None:
        """Return once all wills are placed, or that has taken long enough; never raises."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(min(timeout_s or PATIENCE_S, PATIENCE_S)):
                await self._placed.wait()

    async def run(self) -> None:
        """Connect, and connect again those that were lost, until cancelled.

        Then say goodbye if the wills are to be forgotten, and else leave them to the broker.
        """
        loop = asyncio.get_running_loop()
        failures, again_s = 0, 0.0
        if self._stem is not None:
            self._client_ids = {whose: f"{self._stem}-{whose}" for whose in self._wills}
        try:
            while True:
                if self._link.is_up and loop.time() >= again_s:
                    if await self._connect_missing():
                        failures = 0
                    else:
                        again_s = loop.time() + backoff_s(failures)
                        failures += 1
                    self._placed.set()
                await asyncio.sleep(LOOK_EVERY_S if self._placed.is_set() else FIRST_LOOK_S)
        finally:
            for connection in self._connections.values():
                if self._forgotten:
                    connection.say_goodbye()
                else:
                    connection.abort()

    def forget(self) -> None:
        """No will shall be published any more when its connection ends."""
        self._forgotten = True

    async def _connect_missing(self) -> bool:
        """Place all wills that are not placed, some at a time; whether that could be done."""
        up = {whose for whose, each in self._connections.items() if not each.lost.is_set()}
        missing = [whose for whose in self._wills if whose not in up]
        for first in range(0, len(missing), AT_ONCE):
            some = missing[first : first + AT_ONCE]
            found = await asyncio.gather(*map(self._place, some))
            why = next((each for each in found if each), "")
            if why:
                if self._link.is_up and not self._complained:
                    self._complained = True
                    log.warning("%s: no last will at %s (%s)", self.name, self._link.address, why)
                return False
        self._complained = False
        return True

    async def _place(self, whose: str) -> str:
        """Connect with that will; why not, if not."""
        is_back = whose in self._client_ids
        client_id = self._client_ids.setdefault(whose, f"plotfeed-{whose}-{uuid4().hex[:8]}")
        connection = MqttConnection(
            self._link.address,
            self._link.version,
            client_id,
            will=self._wills[whose],
            keep_alive_s=PROMPT_KEEP_ALIVE_S if whose == self._prompt else None,
        )
        try:
            await connection.open(CONNECT_TIMEOUT_S)
        except MqttError as error:
            return str(error)
        self._connections[whose] = connection
        if is_back:
            self._on_back(whose)
        return ""
