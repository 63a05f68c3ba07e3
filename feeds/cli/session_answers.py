"""What a session says on its topics while a flight is published to it: whether it takes it in."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from plotfeed.feeds.engine.visibility import HINDRANCES, LIMITS, Hindrance, cover_of, outside
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.models.frames import LocalFrame, distance_m, geodetic_to_ecef
from plotfeed.models.state import AltitudeReference, Floats

log = logging.getLogger(__name__)

ANSWER_S = 1.0  # For what is retained to come after a subscription
STATUS_S = 6.0  # For the next status to come: a session says one every 5 s
MOST_REFUSALS_KEPT = 1000
MOST_SENSORS = 10_000
NEEDED = ("latitude_deg", "longitude_deg", "height_m", "range_max_m")  # Of a sensor's description


class SessionAnswers:
    """Hears a session on its prefix: that it runs, where its sensors stand, whom it refuses."""

    def __init__(self, prefix: str, drone: str) -> None:
        self._prefix, self._drone = prefix, drone
        self.topics = [f"{prefix}/{end}" for end in ("errors", "session", "fleet/+/session")]
        self.topics += [f"{prefix}/+/description", f"{prefix}/+/status"]
        # The name of the scene that a session runs; None while none is heard.
        self.scene: str | None = None
        self.refused = 0  # Reports of the drone of which the session has said that it refused them
        self.details: list[str] = []  # Why, of the first of them
        # Sessions that say so, by their topics: one, or those of the parts of a fleet.
        self._running: dict[str, dict[str, Any]] = {}
        self._sensors: dict[str, dict[str, Any]] = {}
        self._refused_by: Counter[str] | None = None
        self._before: Counter[str] | None = None
        self._statuses = 0
        self._news = asyncio.Event()

    def hear(self, topic: str, payload: bytes, _content_type: str | None) -> None:
        """Take what came on one of the topics; what no session would say is nothing."""
        kind = topic.rpartition("/")[2]
        self._news.set()
        try:
            told = json.loads(payload)
            if kind == "errors":
                if told.get("drone") == self._drone:
                    self.refused += 1
                    if len(self.details) < MOST_REFUSALS_KEPT:
                        self.details.append(str(told.get("detail")))
            elif kind == "session":
                self._running.pop(topic, None)
                if told["state"] == "RUNNING" and len(self._running) < MOST_SENSORS:
                    self._running[topic] = {
                        "scene": str(told["scene"]),
                        "sensors": frozenset(map(str, told["sensors"])),
                    }
                found = next(iter(self._running.values()), None)
                self.scene = None if found is None else found["scene"]
            elif kind == "description" and len(self._sensors) < MOST_SENSORS:
                self._sensors[str(told["sensor"])] = {
                    name: float(told[name])
                    for name in (
                        "latitude_deg",
                        "longitude_deg",
                        "height_m",
                        "range_max_m",
                        *LIMITS,
                    )
                    if name in told or name not in LIMITS
                }
            elif kind == "status":
                counts = told.get("refused_by_reason", {})
                self._refused_by = Counter({str(why): int(n) for why, n in counts.items()})
                self._statuses += 1
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            log.warning("%s: something came that no session says", topic)

    async def begin(self) -> None:
        """Wait a moment for what is retained, and note what was refused before."""
        await self._news_until(
            ANSWER_S,
            lambda: (
                self.scene is not None
                and all(self._sensors.keys() >= each["sensors"] for each in self._running.values())
            ),
        )
        self._before = self._refused_by

    async def end(self) -> None:
        """Wait for what the session says of the last reports, if one runs: its next status."""
        if self.scene is None:
            return
        known = self._statuses
        await self._news_until(STATUS_S, lambda: self._statuses > known or self.scene is None)
        await asyncio.sleep(0.2)  # for errors, which may come behind it

    async def _news_until(self, most_s: float, is_so: Callable[[], bool]) -> None:
        """Wait until that is so, but not for longer."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(most_s):
                while not is_so():
                    self._news.clear()
                    await self._news.wait()

    @property
    def refused_meanwhile(self) -> Counter[str]:
        """How many messages the session has refused since the beginning, for what, of whoever."""
        return (self._refused_by or Counter()) - (self._before or Counter())

    def nearest(
        self, reports: Sequence[PositionReport]
    ) -> tuple[str, float, float, Hindrance | None] | None:
        """The sensor that comes nearest to seeing a flight, how near that comes, how far it sees.

        With them, metres, what keeps the flight out of its cover, if anything does. Of sensors that
        it comes into the cover of, the one whose range it enters deepest; None if no sensor has
        said where it is. Heights of unknown reference are taken as they are.
        """
        best: tuple[Hindrance, str, float, float, Hindrance | None] | None = None
        for name, told in self._sensors.items():
            frame = LocalFrame(told["latitude_deg"], told["longitude_deg"], told["height_m"])
            place_m, cover = frame.from_ecef(_ecef_m(reports, frame.height_m)), cover_of(told)
            near_m, sees_m = float(distance_m(place_m).min()), cover.range_max_m
            hindrance = outside(cover, place_m)
            order = hindrance or Hindrance(len(HINDRANCES), sees_m - near_m, "")
            if best is None or order > best[0]:
                best = order, name, near_m, sees_m, hindrance
        return None if best is None else best[1:]


def _ecef_m(reports: Sequence[PositionReport], ground_m: float) -> Floats:
    """Where the reports are; above take-off counts from `ground_m`. (n, 3)."""
    above_m = {AltitudeReference.ABOVE_TAKEOFF: ground_m}
    rows = [
        (r.latitude_deg, r.longitude_deg, r.altitude_m + above_m.get(r.altitude_reference, 0.0))
        for r in reports
    ]
    return geodetic_to_ecef(*np.array(rows, np.float64).T)
