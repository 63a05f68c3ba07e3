"""A session that runs some of a scene's sensors: which, since when, and how it says so.

Others run the rest. What comes out of all is what one session of the whole scene sends: drones,
surroundings and draws are those of the whole.
"""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

from plotfeed.feeds.delivery.lateness import lateness_us
from plotfeed.feeds.messages.message import Message, retained_message
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import SessionContext
from plotfeed.feeds.transport.leased import Lease
from plotfeed.proto.utc import NS, iso_utc

FLEET = "fleet"
"""Level of topics behind the prefix."""
STATUS_EVERY_NS = 2 * NS
RUNNING, ENDED, DIED = "RUNNING", "ENDED", "DIED"


async def join_at_once(caught_up_until_utc_ns: int) -> int:
    """Sectors that end after what is caught up with are sent."""
    return caught_up_until_utc_ns


@dataclass(frozen=True, slots=True)
class SharedInputs:
    """What one of several sessions makes of what all of them hear."""

    others: frozenset[str]
    """Sensors that other sessions run: those answer what is asked of them."""
    leads: bool
    """Whether it tells of what is refused, for all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionPart:
    """What one of several sessions of a scene runs, and in whose place."""

    name: str
    """Among the parts of the scene, and as a level of topics."""
    sensors: tuple[str, ...]
    leads: bool = True
    """Whether it also does what there is once in a scene: its cooperative drones, refusals."""
    began_utc_ns: int
    """When the whole scene began, by the session's time."""
    client_id: str = ""
    """Of its connection to a broker, which cuts off whoever has the same; empty for any."""
    wills: str = ""
    """How client ids of its last wills begin, whoever runs its sensors; empty for any."""
    lease: Lease | None = None
    """Without which it sends nothing; None where nobody else can have these sensors."""
    join: Callable[[int], Awaitable[int]] = join_at_once
    """Given until when sectors have been worked out again, returns the time up to which others
    send, so that this one sends what ends after it."""
    told: dict[str, Any] = field(default_factory=dict)
    """What its status says of who runs it."""

    def scene_of(self, scene: Scene) -> Scene:
        """The scene with these sensors alone."""
        mine = frozenset(self.sensors)
        left: dict[str, Any] = {"sensor": tuple(s for s in scene.sensor if s.id in mine)}
        if not self.leads:
            left["cooperative"] = None
        return scene.model_copy(update=left)

    def inputs_of(self, scene: Scene) -> SharedInputs:
        """How it deals with what all sessions of the scene hear."""
        every = frozenset(sensor.id for sensor in scene.sensor)
        return SharedInputs(every - frozenset(self.sensors), self.leads)


class PartPresence:
    """Says on {prefix}/fleet/{part} how a part does, for whoever looks after all of them."""

    def __init__(
        self, part: SessionPart, context: SessionContext, publish: Callable[[Message], object]
    ) -> None:
        self.topic = f"{context.scene.mqtt.prefix}/{FLEET}/{part.name}"
        self._part, self._context, self._publish = part, context, publish
        self._since_utc_ns, self._will = 0, b""

    def begin(self, start_utc_ns: int) -> None:
        """The session sends what ends after that time."""
        self._since_utc_ns = start_utc_ns
        self._say(RUNNING)
        self._plan(self._context.clock.now_ns() + STATUS_EVERY_NS)

    def end(self) -> None:
        """The session has come to its end."""
        self._say(ENDED)

    def hear(self, payload: bytes) -> None:
        """Say again that it runs, where a lost connection let a broker say that it died."""
        if self._since_utc_ns and payload == self._will:
            self._say(RUNNING)

    def complain_if_unheard(self) -> None:
        """Leave that to whoever looks after all parts."""

    def will(self, start_utc_ns: int) -> Message:
        """What a broker shall say if this session dies."""
        message = self._message(DIED, start_utc_ns)
        self._will = message.payload
        return message

    def _plan(self, due_utc_ns: int) -> None:
        def report() -> None:
            self._say(RUNNING)
            self._plan(due_utc_ns + STATUS_EVERY_NS)

        self._context.schedule.put(due_utc_ns, report)

    def _say(self, state: str) -> None:
        self._publish(self._message(state, self._context.clock.now_ns()))

    def _message(self, state: str, now_utc_ns: int) -> Message:
        totals, part = self._context.totals, self._part
        p50_us, p99_us = lateness_us(totals.lateness_ns, 50, 99)
        said = {
            "part": part.name,
            "state": state,
            **part.told,
            "time_utc": iso_utc(now_utc_ns),
            "since_utc": iso_utc(self._since_utc_ns),
            "sensors": len(part.sensors),
            "drones": totals.drones,
            "telemetry": totals.telemetry,
            "plots": totals.plots,
            "messages": totals.messages,
            "undelivered": totals.undelivered,
            "missed_scans": totals.missed_scans,
            "lateness_p50_us": p50_us,
            "lateness_p99_us": p99_us,
        }
        prefix = self._context.scene.mqtt.prefix
        payload = json.dumps(said).encode()
        return retained_message(f"{prefix}/{FLEET}", part.name, payload, now_utc_ns)
