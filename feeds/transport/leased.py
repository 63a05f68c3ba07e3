"""What may be sent only while a lease is held: of sensors that another may have taken over."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.messages.outgoing import Client, Outgoing, Transport
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.connection import MqttConnection
from plotfeed.feeds.transport.mqtt.last_wills import LastWills

NO_LEASE = "no lease"
"""What the ledger calls where such a message did not get."""


class Lease(Protocol):
    """A right for a while, which ends by itself where nobody renews it."""

    @property
    def holds(self) -> bool:
        """Whether it is held now."""

    async def renewed(self) -> None:
        """Return once it has been renewed by an answer to what was asked after this call."""


class LeasedTransport:
    """A transport that takes nothing, and says so, while its lease is not held."""

    def __init__(self, transport: Transport, lease: Lease) -> None:
        self._transport, self._lease = transport, lease

    def waiting_of(self, client: Client) -> int:
        """Messages of that client that wait for it."""
        return self._transport.waiting_of(client)

    def carries(self, message: Message) -> bool:
        """Whether it is for that message."""
        return self._transport.carries(message)

    def prepare(self, messages: Sequence[Message]) -> None:
        """Do ahead of time what can be done for messages that will be published soon."""
        self._transport.prepare(messages)

    def publish(self, outgoing: Sequence[Outgoing]) -> None:
        """Send them if the lease is held; else none of them gets anywhere."""
        if self._lease.holds:
            self._transport.publish(outgoing)
            return
        for one in outgoing:
            one.settle(delivered=False, to=NO_LEASE)

    async def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until it has sent everything, or the time is up."""
        await self._transport.drain(timeout_s)


class LeasedLink(MqttTransport):
    """A link to a broker under a client id that others may take over, held by a lease.

    A broker cuts off whoever connects with an id as somebody else does. So this one connects, and
    connects again, only when its lease was renewed since it wanted to.
    """

    def __init__(self, address: BrokerAddress, client_id: str, lease: Lease, **how: Any) -> None:
        """Link up as `MqttTransport` does, which takes its client id for its name."""
        super().__init__(address, client_id, **how)
        self._client_id, self._lease = client_id, lease

    async def _connect(self) -> MqttConnection:
        await self._lease.renewed()
        return await super()._connect()


class LeasedWills(LastWills):
    """Last wills of sensors that others may take over, under client ids that these have then.

    None is placed before this session sends, nor when it has handed its sensors over.
    """

    def __init__(
        self,
        link: MqttTransport,
        wills: Mapping[str, Message],
        on_back: Callable[[str], object],
        *,
        stem: str,
        lease: Lease,
    ) -> None:
        """`stem` begins the client ids."""
        super().__init__(link, wills, on_back)
        self._stem, self._lease = stem, lease
        self._may_place = False

    async def wait_until_up(self, timeout_s: float | None = None) -> None:
        """Return at once: they come when the session sends."""

    async def run(self) -> None:
        """Connect once it may; what a broker says of those before is put right by `on_back`."""
        self._client_ids.update({whose: f"{self._stem}-{whose}" for whose in self._wills})
        await super().run()

    def place(self) -> None:
        """Place them from now on."""
        self._may_place = True

    async def _connect_missing(self) -> bool:
        if not self._may_place or not self._lease.holds:
            return True
        return await super()._connect_missing()
