"""Routes of a replay's messages: topic, link, and over which transports."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.link.outbox import Outbox
from plotfeed.feeds.link.uplink import Uplink
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import Transport, publish
from plotfeed.feeds.replaying.destinations import ReplayUdp
from plotfeed.feeds.replaying.replay_settings import ReplayError, ReplaySettings, is_topic
from plotfeed.feeds.timing.clock import Clock, Schedule
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.recorded import Recorded

# Messages that leave in one go where there are no deadlines: a system call costs more than one.
TOGETHER = 64
MAX_LINKS = 1000  # Sources with a link of their own
# Last levels of what a session says beside what its sensors report.
NOT_OVER_LINKS = frozenset({"status", "settings", "description", "session", "errors", "truth"})
_FORMAT = re.compile(r"(.+)/(?:asterix/\d{1,3}|plots|sapient)")


@dataclass(slots=True)
class ReplayCounters(SessionCounters):
    """What a replay has done so far."""

    worst_ns: int = 0  # The greatest lateness
    octets: int = 0  # Of payloads that were sent, each copy counted
    laps: int = 0  # Begun
    # Messages that were not sent, by the reason.
    skipped: Counter[str] = field(default_factory=Counter)
    # Times that were left alone although they should have been moved, by what they are in.
    left: Counter[str] = field(default_factory=Counter)

    def settle(self, fate: pb.Fate, copy: int, lateness_ns: int, octets: int) -> None:
        """Count what became of a copy of a message, with so many octets of payload."""
        SessionCounters.settle(self, fate, copy, lateness_ns, octets)
        if fate == pb.SENT:
            self.octets += octets
            self.worst_ns = max(self.worst_ns, lateness_ns)


def source_of(topic: str) -> str:
    """The sensor that a topic is of: what stands before the format, else two levels at most."""
    found = _FORMAT.fullmatch(topic)
    if found is not None:
        return found[1]
    return topic if topic.startswith("udp/") else "/".join(topic.split("/")[:2])


class Route(NamedTuple):
    """What becomes of the messages on a topic."""

    topic: str
    # The link that they go through, and then their way out; None if they go through none.
    over: tuple[Uplink, Outbox] | None
    obstacle: str = ""  # Why they are not sent; empty if they are
    # Sends a payload, where that is all that has to be done.
    datagram: Callable[[bytes], bool] | None = None


class Routes:
    """The routes of all topics, each found once, and what leaves by them."""

    def __init__(
        self,
        transports: Sequence[Transport],
        settings: ReplaySettings,
        *,
        clock: Clock,
        schedule: Schedule,
        totals: ReplayCounters,
    ) -> None:
        # How far the replay's time is ahead of the recorded one, at its beginning.
        self.later_ns = 0
        self._transports = transports
        self._settings = settings
        self._clock = clock
        self._schedule = schedule
        self._totals = totals
        self._together = TOGETHER if settings.fastest else 1
        self._gathered: list[Message] = []
        self._routes: dict[tuple[str, str], Route] = {}
        self._over: dict[str, tuple[Uplink, Outbox]] = {}

    def of(self, recorded: Recorded) -> Route:
        """The route of a recorded message."""
        key = (recorded.topic, recorded.content_type)
        route = self._routes.get(key)
        if route is None:
            route = self._routes[key] = self._found(recorded)
        return route

    def send(self, message: Message, over: tuple[Uplink, Outbox] | None) -> None:
        """Send it now, through its link if it has one."""
        if over is not None:
            self.flush()
            uplink, outbox = over
            outbox.send(uplink.passed([message]))
            return
        self._gathered.append(message)
        if len(self._gathered) >= self._together:
            self.flush()

    def send_datagram(self, send: Callable[[bytes], bool], payload: bytes, due_ns: int) -> None:
        """Send a datagram that is its payload and nothing else."""
        fate = pb.SENT if send(payload) else pb.UNDELIVERED
        self._totals.settle(fate, 0, self._clock.now_ns() - due_ns, len(payload))

    def flush(self) -> None:
        """Send what was gathered to leave together."""
        if self._gathered:
            together, self._gathered = self._gathered, []
            publish(self._transports, together, self)

    def now_ns(self) -> int:
        """The time by which it sends, UTC."""
        return self._clock.now_ns()

    def settled(self, one: Message) -> None:
        """The fate of a message that goes through no link is known."""
        late_ns = 0
        if not self._settings.fastest:  # else there are no deadlines
            late_ns = (one.sent_utc_ns or self._clock.now_ns()) - one.due_utc_ns
        self._totals.settle(one.fate, 0, late_ns, len(one.payload))

    def end(self) -> None:
        """What links still hold does not arrive."""
        for _, outbox in self._over.values():
            outbox.end()

    def _found(self, recorded: Recorded) -> Route:
        found = (rule.apply(recorded.topic) for rule in self._settings.topics)
        topic = next((new for new in found if new is not None), recorded.topic)
        message = Message(
            topic=topic, payload=b"", content_type=recorded.content_type, due_utc_ns=0
        )
        if not is_topic(topic):
            return Route(topic, None, "their topic is none that a broker takes")
        if not any(transport.carries(message) for transport in self._transports):
            return Route(topic, None, "they are no datagrams, or of no destination")
        over, first = self._link_of(recorded.topic), self._transports[0]
        if over is None and len(self._transports) == 1 and isinstance(first, ReplayUdp):
            return Route(topic, None, datagram=first.send)
        return Route(topic, over)

    def _link_of(self, topic: str) -> tuple[Uplink, Outbox] | None:
        rules = (rule for rule in self._settings.links if rule.holds_for(topic))
        rule = next(rules, None)
        if rule is None or topic.rpartition("/")[2] in NOT_OVER_LINKS:
            return None
        source = source_of(topic)
        if source not in self._over:
            if len(self._over) >= MAX_LINKS:
                raise ReplayError(f"more than {MAX_LINKS} sources of messages: give fewer a link")
            # Named as in a session, so that the same seed loses alike.
            name, seed = source.rpartition("/")[2], self._settings.seed
            uplink = Uplink(rule.link, seed, name, later_ns=self.later_ns)
            outbox = Outbox(
                self._clock, self._transports, schedule=self._schedule, totals=self._totals
            )
            self._over[source] = uplink, outbox
        return self._over[source]
