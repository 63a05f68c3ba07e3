"""What waits to leave by an MQTT link: in a bounded queue, and then in the buffer of its socket."""

from __future__ import annotations

import asyncio
from collections import Counter, OrderedDict, defaultdict, deque
from collections.abc import Callable, Hashable, Sequence
from itertools import count

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.transports import Client
from plotfeed.feeds.scene.output_keys import MqttQueueKeys

MAX_WAITING_OCTETS = 32 << 20  # Of payloads; more do not wait, however few messages they are
OVERRUN = 10_000  # What is taken beyond the limit from whoever publishes although he should wait


def loop_s() -> float:
    """Seconds by the clock of the running loop."""
    return asyncio.get_running_loop().time()


class SendQueue:
    """The messages of one QoS that wait for one link: in order, counted, dropped by a policy.

    Each client has as much room as the settings say, so that none takes that of another.
    """

    def __init__(
        self,
        settings: MqttQueueKeys,
        qos: int,
        destination: str,
        now_s: Callable[[], float] = loop_s,
    ) -> None:
        """`destination` is what ledgers call the broker."""
        self._policy = settings.policy
        self._limit = settings.limit(qos)
        self._max_age_s = settings.max_age_s
        self._destination = destination
        self._now_s = now_s
        self._numbers = count()
        # By their keys, which are the topics of those that are retained.
        self._of_client: defaultdict[Client | None, OrderedDict[Hashable, Message]]
        self._of_client = defaultdict(OrderedDict)
        self._octets: Counter[Client | None] = Counter()  # Of the payloads
        self._order: OrderedDict[Hashable, Client | None] = OrderedDict()  # Whose, by their keys

    def __len__(self) -> int:
        """How many wait."""
        return len(self._order)

    def waiting_of(self, client: Client | None) -> int:
        """How many of that client wait."""
        return len(self._of_client.get(client, ()))

    @property
    def is_full(self) -> bool:
        """Whether, by the policy, others shall wait now instead of publishing."""
        if self._policy != "wait" or not self._order:
            return False
        return any(
            waiting and (len(waiting) >= self._limit or self._octets[client] >= MAX_WAITING_OCTETS)
            for client, waiting in self._of_client.items()
        )

    def put(self, one: Message) -> None:
        """Let it wait, or drop what the policy drops: dropped is settled as not delivered."""
        self.expire()
        one.since_s = self._now_s()
        key: Hashable = one.topic if one.retain else next(self._numbers)
        given_up = [self._take_out(key)] if key in self._order else []
        while not self._has_room(one) and (key_of := self._gives_way(one)) is not None:
            given_up.append(self._take_out(key_of))
        if self._has_room(one):
            self._put(key, one)
        else:
            given_up.append(one)
        for each in given_up:
            self._drop(each)

    def take(self) -> Message | None:
        """The one whose turn it is, if any is left."""
        self.expire()
        return self._take_out(next(iter(self._order))) if self._order else None

    def put_back(self, messages: Sequence[Message]) -> None:
        """Let these, which were sent, go before all others, in their order.

        They may be more than the limit.
        """
        for one in reversed(messages):
            key: Hashable = one.topic if one.retain else next(self._numbers)
            if key in self._order:  # a newer one on its topic, which is all that counts
                self._drop(one)
                continue
            self._put(key, one)
            self._order.move_to_end(key, last=False)
            self._of_client[one.client].move_to_end(key, last=False)

    def expire(self) -> None:
        """Drop what has waited too long."""
        if self._max_age_s is None:
            return
        before_s = self._now_s() - self._max_age_s
        while self._order:
            key, client = next(iter(self._order.items()))
            if self._of_client[client][key].since_s >= before_s:
                break
            self._drop(self._take_out(key))

    def give_up(self) -> None:
        """Settle all that waits as not delivered."""
        while self._order:
            self._drop(self._take_out(next(iter(self._order))))

    def _gives_way(self, one: Message) -> Hashable | None:
        """What of its client gives way to one that has no room, by its key; None for nothing.

        What is retained, such as a status, takes the place of another by any policy.
        """
        waiting = self._of_client[one.client]
        if self._policy == "drop-oldest":
            return next(iter(waiting), None)
        passing = (key for key in reversed(waiting) if not waiting[key].retain)
        return next(passing, None) if one.retain else None

    def _has_room(self, one: Message) -> bool:
        """Whether its client may have it wait; alone, however large it is."""
        waiting, waits = self._of_client[one.client], self._policy == "wait"
        if len(waiting) >= self._limit + (OVERRUN if waits else 0):
            return False
        octets = self._octets[one.client] + len(one.payload)
        return not waiting or octets <= MAX_WAITING_OCTETS * (2 if waits else 1)

    def _put(self, key: Hashable, one: Message) -> None:
        self._order[key] = one.client
        self._of_client[one.client][key] = one
        self._octets[one.client] += len(one.payload)

    def _take_out(self, key: Hashable) -> Message:
        client = self._order.pop(key)
        found = self._of_client[client].pop(key)
        self._octets[client] -= len(found.payload)
        return found

    def _drop(self, one: Message) -> None:
        one.settle(delivered=False, to=self._destination)


# What may wait in a socket for a broker that has stalled; more is not taken.
MAX_UNSENT_OCTETS = 8 << 20
# So many messages of QoS 0, too: asyncio looks at each of them whenever it takes another.
MAX_UNSENT_MESSAGES = 4096
GIVE_UP_S = 20.0  # A socket that has taken nothing for so long has nobody at its other end


class SocketBuffer:
    """Writes to one transport; a message of QoS 0 is delivered when it has left its buffer.

    Octets that TLS adds can only make that seem later.
    """

    def __init__(
        self,
        transport: asyncio.WriteTransport,
        on_room: Callable[[], None],
        now_s: Callable[[], float] = loop_s,
    ) -> None:
        """`on_room` is called whenever the socket has taken everything after it had not.

        The transport's protocol tells `hold` and `release`.
        """
        self.moved_s = now_s()  # When it last took something that had to wait
        self._transport = transport
        self._on_room = on_room
        self._now_s = now_s
        # What has not left, and how many octets have when it has.
        self._unsent: deque[tuple[int, Message]] = deque()
        self._written = self._taken = 0
        self._holds = False

    @property
    def octets(self) -> int:
        """Octets that it has not taken."""
        return self._transport.get_write_buffer_size()

    @property
    def has_room(self) -> bool:
        """Whether it may be given more."""
        if not self._holds:
            return not self._transport.is_closing()
        return (
            self._look() <= MAX_UNSENT_OCTETS
            and len(self._unsent) < MAX_UNSENT_MESSAGES
            and not self._transport.is_closing()
        )

    def write(self, octets: bytes) -> bool:
        """Hand octets to the socket; whether all have left."""
        self._written += len(octets)
        self._transport.write(octets)
        if not self._holds:
            self._taken = self._written
        return not self._holds

    def keep(self, one: Message, octets_behind: int = 0) -> None:
        """One that was written last but for so many octets; settled once it has left."""
        self._unsent.append((self._written - octets_behind, one))
        self._settle_taken()

    def give_up(self, destination: str) -> None:
        """The connection is lost: settle what was not taken."""
        while self._unsent:
            self._unsent.popleft()[1].settle(delivered=False, to=destination)

    def is_stuck(self) -> bool:
        """Whether it has taken nothing for long, though it should."""
        if not self._holds and not self._transport.is_closing():
            return False
        self._look()
        return self._now_s() - self.moved_s > GIVE_UP_S

    def hold(self) -> None:
        """The socket has not taken everything."""
        self._holds = True
        self.moved_s = self._now_s()
        self._taken = self._written - self.octets

    def release(self) -> None:
        """The socket has taken everything."""
        self._holds = False
        self.moved_s = self._now_s()
        self._taken = self._written
        self._settle_taken()
        self._on_room()

    def _look(self) -> int:
        """Settle what has left; how many octets have not."""
        octets = self.octets
        if self._written - octets > self._taken:
            self._taken, self.moved_s = self._written - octets, self._now_s()
            self._settle_taken()
        return octets

    def _settle_taken(self) -> None:
        while self._unsent and self._unsent[0][0] <= self._taken:
            self._unsent.popleft()[1].settle(delivered=True)
