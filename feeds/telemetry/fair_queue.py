"""What has come in and waits: a short queue a topic, so that who floods drops only its own."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable

# Telemetry of a second from a few thousand drones; beyond it a topic has room for one message.
MAX_WAITING = 20_000
MAX_OF_TOPIC = 64  # Of one drone: a second of more than anybody sends
MAX_STRANGERS = 1_000  # Topics at a time from which nothing has been taken yet
LARGE_OCTETS = 16_384
MAX_LARGE_OCTETS = 16 << 20  # Of payloads that are large; no telemetry and few commands are
MAX_TOPICS_TOLD = 50  # Of those that drop, between two askings; the rest is one number
BEHIND_EVERY_S = 0.1

# A topic, and the payloads and content types that waited, in the order in which they came.
Turn = tuple[str, list[tuple[bytes, str | None]]]


class FairQueue:
    """Messages by topic, taken topic after topic in turn. A full one gives up its oldest."""

    def __init__(
        self,
        limit: int = MAX_WAITING,
        *,
        limit_of_topic: int = MAX_OF_TOPIC,
        limit_of_strangers: int = MAX_STRANGERS,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        # Messages that found no room or gave way, since it was last cleared; by topic, or "" of
        # more topics than are told apart.
        self.dropped: Counter[str] = Counter()
        self._limit = limit
        self._limit_of_topic = limit_of_topic
        self._limit_of_strangers = limit_of_strangers
        self._now_s = now_s
        self._turns: dict[str, list[tuple[bytes, str | None]]] = {}
        self._since_s: dict[str, float] = {}
        self._known: set[str] = set()
        self.given_up = 0  # How many those were from the beginning
        self._strangers = self._waiting = self._large_octets = 0
        self._behind = (0.0, 0.0)

    def __len__(self) -> int:
        """How many wait."""
        return self._waiting

    def of_topic(self, topic: str) -> int:
        """How many messages of a topic wait."""
        return len(self._turns.get(topic, ()))

    def know(self, topic: str) -> None:
        """Keep room for that topic from now on: something of it was taken."""
        if topic not in self._known:
            self._known.add(topic)
            self._strangers -= topic in self._turns

    def forget(self, topic: str) -> None:
        """Keep no room for that topic any more."""
        if topic in self._known:
            self._known.remove(topic)
            self._strangers += topic in self._turns

    def put(self, topic: str, payload: bytes, content_type: str | None) -> None:
        """Let a message wait; if there is no room, it or the oldest of its topic is dropped."""
        if len(payload) > LARGE_OCTETS:
            if self._large_octets + len(payload) > MAX_LARGE_OCTETS:
                self._drop(topic)
                return
            self._large_octets += len(payload)
        waiting = self._turns.get(topic)
        if waiting is None:
            if topic not in self._known:
                if self._strangers >= self._limit_of_strangers or self._waiting >= self._limit:
                    self._drop(topic)
                    self._forget(payload)
                    return
                self._strangers += 1
            waiting = self._turns[topic] = []
            self._since_s[topic] = self._now_s()
        elif len(waiting) >= self._limit_of_topic or self._waiting >= self._limit:
            self._forget(waiting.pop(0)[0])
            self._waiting -= 1
            self._drop(topic)
        waiting.append((payload, content_type))
        self._waiting += 1

    def take(self, least: int) -> list[Turn]:
        """All that waits of the topics whose turn it is, until it is so many messages or more."""
        turns, number = [], 0
        while self._turns and number < least:
            topic = next(iter(self._turns))
            waiting = self._turns.pop(topic)
            del self._since_s[topic]
            if topic not in self._known:
                self._strangers -= 1
            turns.append((topic, waiting))
            number += len(waiting)
            if self._large_octets:
                for payload, _ in waiting:
                    self._forget(payload)
        self._waiting -= number
        return turns

    def take_one(self) -> Turn:
        """The oldest message of the topic whose turn it is; its others wait for its next turn."""
        topic = next(iter(self._turns))
        waiting = self._turns.pop(topic)
        first = waiting.pop(0)
        if waiting:
            self._turns[topic] = waiting
        else:
            del self._since_s[topic]
            self._strangers -= topic not in self._known
        self._forget(first[0])
        self._waiting -= 1
        return topic, [first]

    def behind_s(self) -> float:
        """How long some topic has waited, seconds; looked up ten times a second at most."""
        if not self._turns:
            return 0.0
        now_s = self._now_s()
        if now_s - self._behind[0] >= BEHIND_EVERY_S:
            self._behind = (now_s, now_s - min(self._since_s.values()))
        return self._behind[1]

    def _drop(self, topic: str) -> None:
        self.given_up += 1
        told = topic in self.dropped or len(self.dropped) < MAX_TOPICS_TOLD
        self.dropped[topic if told else ""] += 1

    def _forget(self, payload: bytes) -> None:
        if len(payload) > LARGE_OCTETS:
            self._large_octets -= len(payload)
