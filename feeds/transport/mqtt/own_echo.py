"""A sample of what a link publishes, heard back: whether its broker passes on what it takes.

Without an acknowledgement nobody tells a publisher that an access list refuses its messages, and
MQTT 3.1.1 has no word for it at all. So a link subscribes to one of the topics that it publishes
on, until one of its own messages has come back, and then to the next one. A topic that it hears
anyway is the first: where nothing of its own comes back there, it may hear nothing else either.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable
from typing import Protocol

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.transport.mqtt.address import BrokerAddress

log = logging.getLogger(__name__)

# For a message to come back, and once more after the broker has answered another request.
WAIT_S = 3.0
# So often that is, where other messages come meanwhile: they may be before it in a backlog.
MOST_WAITS = 20
QUIET_S = 30.0  # A topic on which nothing was published for so long gives way to the next one
NEXT_S, ROUND_S = 1.0, 60.0  # Between two topics, and from the last one to the first again
MOST_TOPICS, MOST_SENT, MOST_COMPLAINTS = 10_000, 10_000, 10


class Subscriber(Protocol):
    """A connection, which may be asked for other topics."""

    def subscribe(self, topic_filter: str) -> None:
        """Ask for a topic."""

    def unsubscribe(self, topic_filter: str) -> None:
        """Ask for it no more."""


class OwnEcho:
    """Asks a broker for a link's own messages, and says in a line if none comes back."""

    def __init__(
        self, address: BrokerAddress, subscribed: Iterable[str], counts: Callable[[bool], object]
    ) -> None:
        """`subscribed` the link has anyway; `counts` is told of each sample whether it came."""
        self.wants = False  # Whether to be told of what is published now
        self.topic = ""  # The one that is sampled now; empty for none
        self._address, self._counts = address, counts
        self._subscribed = frozenset(subscribed)
        self._connection: Subscriber | None = None
        self._seen: set[str] = set()
        self._done: set[str] = set()
        self._asked: set[str] = set()  # Topics that this connection has subscribed to for a sample
        # Hashes of payloads that were published since the broker granted the subscription.
        self._sent: set[int] = set()
        self._asks_again = self._comes = False
        self._waits = 0
        self._complaints: set[str] = set()
        self._has_heard = False
        self._timer: asyncio.TimerHandle | None = None

    def begin(self, connection: Subscriber | None) -> None:
        """Sample over this connection from now on, or with None no more."""
        self._connection, self.topic, self.wants = connection, "", False
        self._asked.clear()
        self._look()

    def published(self, messages: Iterable[Message]) -> None:
        """Take note of what is handed to the socket now."""
        for message in messages:
            is_heard = message.topic in self._subscribed and message.topic not in self._done
            if is_heard and not self.topic:
                self._sample(message.topic)
            if self.topic:
                if message.topic == self.topic:
                    if not self._sent:
                        self._after(WAIT_S, self._ask_again)
                    if len(self._sent) < MOST_SENT:
                        self._sent.add(hash(message.payload))
            elif not message.retain and message.topic not in self._done:
                if message.topic in self._seen:
                    self._sample(message.topic)
                    break
                if len(self._seen) < MOST_TOPICS:
                    self._seen.add(message.topic)

    def answered(self, refusal: str | None) -> None:
        """The broker has granted the subscription to the topic, or refuses it with that reason."""
        if refusal is not None:
            self._complain(
                f"cannot tell whether anybody hears what is published on {self.topic}: "
                f"{self._address} does not grant the subscription to it ({refusal})"
            )
            self._finish()
        elif self._asks_again:
            self._waits, self._comes = 0, False
            self._after(WAIT_S, self._miss)
        else:
            self.wants = True
            self._after(QUIET_S, self._finish)

    def heard(self, topic: str, payload: bytes) -> bool:
        """Take what has come; whether it came for the sample alone."""
        self._comes = True
        if topic == self.topic and hash(payload) in self._sent:
            self._counts(True)
            self._has_heard |= topic not in self._subscribed
            self._finish()
        return topic in self._asked and topic not in self._subscribed

    def _sample(self, topic: str) -> None:
        self.topic, self.wants, self._asks_again = topic, False, False
        self._sent.clear()
        if topic in self._subscribed:
            self.answered(None)
        elif self._connection is not None:
            self._asked.add(topic)
            self._connection.subscribe(topic)

    def _ask_again(self) -> None:
        """Have an answer that comes after all that the broker took before."""
        if self._connection is not None:
            self._asks_again = True
            self._connection.subscribe(self.topic)

    def _miss(self) -> None:
        if self._comes and self._waits < MOST_WAITS:
            self._waits, self._comes = self._waits + 1, False
            self._after(WAIT_S, self._miss)
            return
        self._counts(False)
        if self.topic in self._subscribed:
            others = ", ".join(sorted(self._subscribed - {self.topic}))
            self._complain(
                f"nothing comes back from {self.topic}: does the access list of {self._address} "
                f"let this session write and read there? Nor may it hear {others or 'anything'}"
            )
            self._finish()
            return
        self._complain(
            f"nothing of what is published on {self.topic} comes back from {self._address}, which "
            f"has taken {len(self._sent)} messages and the subscription: does its access list let "
            "this session write there, and read there? Perhaps nobody hears it"
        )
        self._finish()

    def _complain(self, text: str) -> None:
        """Say it of the first topic, and of others where not all are alike."""
        is_news = self.topic not in self._complaints and len(self._complaints) < MOST_COMPLAINTS
        if is_news and (self._has_heard or not self._complaints):
            log.warning("%s", text)
        self._complaints.add(self.topic)

    def _finish(self) -> None:
        if self._connection is not None and self.topic not in self._subscribed:
            self._connection.unsubscribe(self.topic)
        self._done.add(self.topic)
        self.topic, self.wants = "", False
        self._after(NEXT_S, self._look)

    def _look(self) -> None:
        """Look for the next topic, for as long as the last one may have taken."""
        self.wants = self._connection is not None
        self._after(QUIET_S, self._rest)

    def _rest(self) -> None:
        self.wants = False
        self._done.clear()
        self._after(ROUND_S, self._look)

    def _after(self, delay_s: float, do: Callable[[], None]) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._connection is not None:
            self._timer = asyncio.get_running_loop().call_later(delay_s, do)
