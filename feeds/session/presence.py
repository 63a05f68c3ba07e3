"""Sessions on one prefix: what this one says of itself, retained, and whom else it hears.

Each names those that it has heard, so that two know of each other only if both are there: what a
broker has kept of a session that is gone names nobody who came later.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Any
from uuid import uuid4

from plotfeed.feeds.engine.emulated_sensors import AHEAD_NS
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.message import Message, retained_message
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.part import PartHold, SessionPart
from plotfeed.feeds.timing.clock import Clock, InstantClock
from plotfeed.proto.utc import NS_IN_MS, iso_utc

log = logging.getLogger(__name__)

RUNNING, ENDED, DIED = "RUNNING", "ENDED", "DIED"
MOST_HEARD = 100  # Sessions; what comes from more is nothing that a session would say


class SessionPresence:
    """Says on {prefix}/session that this session runs, and notices others that say so there."""

    def __init__(
        self,
        scene: Scene,
        clock: Clock,
        totals: SessionCounters,
        publish: Callable[[Message], object],
        *,
        part: SessionPart | None = None,
        hold: PartHold,
    ) -> None:
        """A session of a `part` says so on the topic of that part."""
        is_simulated = isinstance(clock, InstantClock)
        drawn = f"{scene.scene.seed:012x}"[-12:] if is_simulated else uuid4().hex[:12]
        # Of this run of the scene; simulated time gives the same octets at every run.
        self.id = hold.process or drawn
        self._part = part
        self._source = scene.mqtt.prefix if part is None else part.source(scene)
        self.topic = f"{self._source}/session"
        self._scene, self._clock, self._totals, self._publish = scene, clock, totals, publish
        self._start_ns: int | None = None
        self._speed_told = 1.0
        # Other sessions that say that they run, and whether they have heard this one.
        self._heard: dict[str, bool] = {}

    def begin(self, start_utc_ns: int) -> None:
        """The session runs, since then."""
        self._start_ns = start_utc_ns
        self._say(RUNNING)

    def end(self) -> None:
        """The session has come to its end."""
        self._say(ENDED)
        self._start_ns = None

    def will(self, start_utc_ns: int) -> Message:
        """What a broker shall say if this session dies."""
        return self._message(DIED, start_utc_ns, start_utc_ns)

    def tell_speed(self) -> None:
        """Say at which speed the clock runs, where that is other than was said by a tenth."""
        reached = self._totals.speed_reached
        if reached is not None and abs(reached - self._speed_told) > 0.1 * self._speed_told:
            self._speed_told = reached
            self._say(RUNNING)

    def hear(self, payload: bytes) -> None:
        """Take what was said on the topic, by this session or another; anything else is nothing."""
        told = session_told(payload)
        if self._start_ns is None or told is None:
            return
        other, state = told["session"], told["state"]
        if other == self.id:
            if state != RUNNING:  # a connection was lost, and with it a last will was published
                self._say(RUNNING)
        elif state != RUNNING:
            self._gone(other, state)
        elif self._part is not None:
            return  # which process has the part is not decided here
        elif other in self._heard or len(self._heard) < MOST_HEARD:
            is_new = other not in self._heard
            knew = self._heard.setdefault(other, False)
            if self.id in told["heard"] and not knew:
                self._heard[other] = True
                self._totals.other_sessions = sum(self._heard.values())
                log.warning(
                    "another session (%s, scene %.60r) publishes on %s/# too: what both send is "
                    "mixed up there; give one of them another mqtt.prefix",
                    other,
                    str(told.get("scene")),
                    self._scene.mqtt.prefix,
                )
            if is_new:
                self._say(RUNNING)

    def _gone(self, other: str, state: str) -> None:
        """Another has ended; what is retained is of it, but this one runs."""
        if self._heard.pop(other, False):
            log.warning("the other session (%s) has %s", other, state.lower())
        self._totals.other_sessions = sum(self._heard.values())
        self._say(RUNNING)

    def _say(self, state: str) -> None:
        if self._start_ns is not None:
            self._publish(self._message(state, self._start_ns, self._clock.now_ns()))

    def _message(self, state: str, start_utc_ns: int, now_utc_ns: int) -> Message:
        of: dict[str, Any] = {"session": self.id, "state": state, "heard": [*self._heard]}
        asked, reached = self._totals.speed, self._totals.speed_reached
        if asked is not None and reached is not None and asked > 1:
            of |= {"speed": asked, "speed_reached": round(reached, 2)}
        if self._part is not None:
            of |= {"part": self._part.number, "parts": self._part.parts}
        scene = self._scene
        said = {
            **of,
            "scene": scene.scene.name,
            "seed": scene.scene.seed,
            "start_utc": iso_utc(start_utc_ns),
            "start_utc_ns": start_utc_ns,
            "tick_ms": AHEAD_NS // NS_IN_MS,
            "sensors": [sensor.id for sensor in scene.sensor],
            "site": scene.scene.site.model_dump(exclude_none=True),
            "plotfeed": version("plotfeed"),
        }
        return retained_message(self._source, "session", json.dumps(said).encode(), now_utc_ns)


def session_told(payload: bytes) -> dict[str, Any] | None:
    """What a session has said, if it is that."""
    try:
        told = json.loads(payload)
    except (ValueError, RecursionError):
        return None
    if not isinstance(told, dict) or told.get("state") not in (RUNNING, ENDED, DIED):
        return None
    name, heard = told.get("session"), told.get("heard")
    is_name = isinstance(name, str) and len(name) <= 64 and name.isalnum() and name.isascii()
    return told if is_name and isinstance(heard, Sequence) else None
