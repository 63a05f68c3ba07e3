"""A session of some of a scene's sensors: which, and whether this process is the one to send them.

Other sessions run the other sensors. What comes out of all of them is what one session of the whole
scene sends: drones, surroundings and draws are those of the whole.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.messages.transports import Transport
from plotfeed.feeds.scene.scene import Scene

if TYPE_CHECKING:
    from plotfeed.feeds.transport.mqtt.address import BrokerAddress
    from plotfeed.feeds.transport.mqtt.client import MqttTransport
    from plotfeed.feeds.transport.mqtt.connection import OnMessage

FLEET = "fleet"  # Level of topics behind the prefix


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionPart:
    """Which of a scene's sensors a session runs."""

    number: int = 1  # From 1 to the number of parts
    parts: int = 1
    sensors: tuple[str, ...]
    began_utc_ns: int  # When the scene began, by its own time: the same for all parts

    @property
    def leads(self) -> bool:
        """Whether it does what there is once in a scene: its cooperative drones, refusals."""
        return self.number == 1

    @property
    def name(self) -> str:
        """Such as 2/3."""
        return f"{self.number}/{self.parts}"

    def source(self, scene: Scene) -> str:
        """The topic on which the part says how it does; others are below it."""
        return f"{scene.mqtt.prefix}/{FLEET}/{self.number}"

    def scene_of(self, scene: Scene) -> Scene:
        """The scene with these sensors alone."""
        mine = frozenset(self.sensors)
        left: dict[str, Any] = {"sensor": tuple(s for s in scene.sensor if s.id in mine)}
        if not self.leads:
            left["cooperative"] = None
        return scene.model_copy(update=left)

    def others(self, scene: Scene) -> frozenset[str]:
        """Sensors of the scene that other sessions run."""
        return frozenset(sensor.id for sensor in scene.sensor) - frozenset(self.sensors)


class PartHold:
    """Whether this process may send what a session sends: always, where nobody else runs the same.

    That is the case here; where several processes were started, one at a time may.
    """

    process = ""  # What this process calls itself among them
    client_id: str | None = None  # That of whichever of them may send
    margin_ns = 0  # Who takes over begins so much after now
    is_claimed = True  # Whether this process has said that it has the part
    is_taken = False  # Whether another process has taken the part over from this one

    def link(
        self, to: BrokerAddress, topics: Sequence[str], on_message: OnMessage, **how: Any
    ) -> MqttTransport:
        """The link to a broker of whoever may send, which hears those topics meanwhile."""
        from plotfeed.feeds.transport.mqtt.client import MqttTransport

        return MqttTransport(to, "plotfeed-session", subscribe=topics, on_message=on_message, **how)

    def guarded(self, transport: Transport) -> Transport:
        """A transport that takes nothing while another process may send."""
        return transport

    def kept(self, session: Any, tasks: asyncio.TaskGroup) -> AbstractAsyncContextManager[None]:
        """Listen and say how the part does meanwhile."""
        del session, tasks
        return nullcontext()

    async def wait_for_turn(self, session: Any, end_ns: int | None) -> None:
        """Have a part stand by until this process may send it, or that time has come."""
        del end_ns
        if session.part is not None:
            await session.stand_by(lambda: True)

    def begin(self) -> None:
        """The session sends from now on what ends after it has joined."""
