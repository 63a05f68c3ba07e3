"""Messages of many clients that leave together, against the same ones sent one by one."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.link.outbox import Departure, Outbox, send_all
from plotfeed.feeds.link.uplink import Uplink
from plotfeed.feeds.messages.message import Message, records
from plotfeed.feeds.messages.transports import Client
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.timing.clock import InstantClock, Schedule
from plotfeed.proto import plotfeed_pb2 as pb

DUE_NS = 7_000


class Socket:
    """Takes all at once, some of it later, or all but some."""

    def __init__(self, how: str, together: bool) -> None:
        self.how, self.together = how, together
        self.carried: list[bytes] = []
        self.writes = 0
        self._kept: list[Message] = []

    def publish(self, outgoing: Sequence[Message]) -> bool:
        self.writes += 1
        if self.together and self.how == "at once":
            self.carried += [one.payload for one in outgoing]
            return True
        for delivery in outgoing:
            delivery.leave()
            self.carried.append(delivery.payload)
            if self.how == "later":
                self._kept.append(delivery)
            else:
                delivery.settle(delivered=self.how == "at once" or self._takes(delivery))
        return False

    def settle_kept(self) -> None:
        for delivery in self._kept:
            delivery.settle(delivered=self._takes(delivery))

    def _takes(self, message: Message) -> bool:
        return message.payload[0] % 3 > 0

    def carries(self, _message: Message) -> bool:
        return True

    def waiting_of(self, _client: Client) -> int:
        return 0

    def prepare(self, _messages: Sequence[Message]) -> None:
        pass

    async def drain(self, _timeout_s: float = 1.0) -> None:
        pass


sockets = st.lists(
    st.tuples(st.sampled_from(["at once", "later", "all but some"]), st.booleans()), max_size=3
)
links = st.sampled_from([None, {}, {"loss": {"kind": "random", "probability": 0.5}}])
clients = st.lists(st.tuples(st.integers(0, 4), links, st.sets(st.integers(0, 2))), max_size=6)


class Case:
    """Clients that share sockets, and all that is told of what they send."""

    def __init__(self, how: Sequence[tuple[str, bool]], clients: Sequence[Any]) -> None:
        self.sockets = [Socket(*each) for each in how]
        self.totals = SessionCounters()
        self.told: list[tuple[str, bytes, int]] = []
        self.entries: dict[int, list[pb.Sent]] = {}
        clock = InstantClock(DUE_NS + 1000)
        self.departures = []
        for i, (messages, link, left_out) in enumerate(clients):
            outbox = Outbox(
                clock,
                [each for k, each in enumerate(self.sockets) if k not in left_out],
                schedule=Schedule(),
                totals=self.totals,
                before_link=[lambda m: self.told.append(("before", m.payload, 0))],
                after_link=[lambda m, t: self.told.append(("after", m.payload, t))],
            )
            uplink = Uplink(None if link is None else LinkSettings.model_validate(link), 1, f"s{i}")
            some = [
                Message(topic=f"s{i}", payload=bytes((k, i)), content_type="x", due_utc_ns=DUE_NS)
                for k in range(messages)
            ]
            self.departures.append((outbox, uplink, some))

    def handed(self) -> list[Departure[Any]]:
        """What each hands over now, each time anew."""
        return [
            (outbox, outgoing, (i, outgoing))
            for i, (outbox, uplink, some) in enumerate(self.departures)
            for outgoing in [uplink.passed([message.again() for message in some])]
        ]

    def keep(self, complete: Sequence[tuple[int, Sequence[Message]]]) -> None:
        for i, outgoing in complete:
            assert i not in self.entries
            self.entries[i] = records(outgoing)

    def settle(self) -> None:
        for socket in self.sockets:
            socket.settle_kept()

    def counts(self) -> list[Any]:
        each = [self.totals, *(outbox.counters for outbox, _, _ in self.departures)]
        return [
            {name: getattr(one, name) for name in one.__slots__ if name != "lateness_ns"}
            | {"lateness_ns": list(one.lateness_ns)}
            for one in each
        ]


@given(sockets, clients)
def test_together_as_one_by_one(how: list[tuple[str, bool]], clients: list[Any]) -> None:
    """Twice, so that numbers go on."""
    together, apart = Case(how, clients), Case(how, clients)
    for _ in range(2):
        for case in (together, apart):
            case.entries.clear()
        send_all(together.handed(), together.keep)
        for outbox, outgoing, what in apart.handed():
            outbox.send(outgoing, partial(apart.keep, [what]))
        for case in (together, apart):
            case.settle()
            for socket in case.sockets:
                socket._kept.clear()
        assert together.entries == apart.entries
        assert together.entries.keys() == set(range(len(clients)))
    assert together.counts() == apart.counts()
    assert sorted(together.told) == sorted(apart.told)
    for one, other in zip(together.sockets, apart.sockets, strict=True):
        assert sorted(one.carried) == sorted(other.carried)
        for i in range(len(clients)):  # whatever the others do
            of_client = [p for p in one.carried if p[1] == i]
            assert of_client == [p for p in other.carried if p[1] == i]


@pytest.mark.parametrize("clients", [1, 50])
def test_each_socket_is_asked_once(clients: int) -> None:
    case = Case([("at once", True)] * 2, [(2, None, ())] * clients)
    send_all(case.handed(), case.keep)
    assert [socket.writes for socket in case.sockets] == [1, 1]
    payloads = [message.payload for _, _, messages in case.departures for message in messages]
    assert [socket.carried for socket in case.sockets] == [payloads, payloads]
    assert case.totals.messages == 2 * clients


def test_what_leaves_is_on_its_way_before_anybody_is_told() -> None:
    case = Case([("at once", True)], [(1, None, ())] * 3)
    seen: list[int] = []
    send_all(case.handed(), lambda done: seen.extend(len(case.sockets[0].carried) for _ in done))
    assert seen == [3, 3, 3]
