"""How the parts of a fleet do, as they say at a broker: for a terminal, and for the page."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Mapping
from typing import Any

from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.session_part import (
    ENDED,
    FLEET,
    PATIENCE_S,
    part_status,
    told_gaps,
)
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto.utc import NS, utc_ns

DIED, SILENT, UNKNOWN = "DIED", "silent", "not heard of"


class FleetWatch:
    """Listens to the parts that run on a scene's prefix."""

    def __init__(self, scene: Scene, address: BrokerAddress) -> None:
        self.scene = scene
        self.root = f"{scene.mqtt.prefix}/{FLEET}"
        self.link = MqttTransport(
            address, "plotfeed-fleet", subscribe=[f"{self.root}/#"], on_message=self._hear
        )
        self._statuses: dict[int, dict[str, Any]] = {}
        self._fresh_s: dict[int, float] = {}
        """When a part was last heard to go on, by this machine's monotonic clock."""
        self._gone: dict[int, str] = {}
        """Processes of which a last will says that they died."""
        self._gaps: dict[int, list[dict[str, Any]]] = {}
        self._shift_ns = 0

    @property
    def is_heard(self) -> bool:
        """Whether any part has said anything."""
        return bool(self._statuses)

    @property
    def is_known(self) -> bool:
        """Whether it is known of every part how it does."""
        return self.is_heard and all(
            row["state"] not in (SILENT, UNKNOWN) for row in self.news()["parts"]
        )

    @property
    def now_utc_ns(self) -> int:
        """The scene's time."""
        return time.time_ns() + self._shift_ns

    def news(self) -> dict[str, Any]:
        """What is known, as JSON: a row for each part of the fleet that was heard of last."""
        statuses = self._statuses
        last = max(statuses.values(), key=lambda told: str(told.get("time_utc")), default=None)
        parts = 0 if last is None else last["parts"]
        mine = {k: t for k, t in statuses.items() if k <= parts and t["parts"] == parts}
        return {
            "scene": "" if last is None else str(last.get("scene")),
            "takeovers": sum(max(told["claim"] - 1, 0) for told in mine.values()),
            "parts": [self._row(k, mine.get(k)) for k in range(1, parts + 1)],
            "gaps": [
                {"part": k, **gap} for k in range(1, parts + 1) for gap in self._gaps.get(k, ())
            ],
        }

    def _row(self, part: int, told: dict[str, Any] | None) -> dict[str, Any]:
        if told is None:
            return {"part": part, "state": UNKNOWN, "sensors": [], "worker": "", "claim": 0,
                    "plots": None, "missed_scans": None, "lateness_p99_ms": 0.0,
                    "sent_until_utc": "", "age_s": None}  # fmt: skip
        fresh_s, state = self._fresh_s.get(part), told["state"]
        age_s = None if fresh_s is None else time.monotonic() - fresh_s
        if state != ENDED and self._gone.get(part) == told["process"]:
            state = DIED
        elif state != ENDED and (age_s is None or age_s > PATIENCE_S):
            state = SILENT
        return {
            "part": part,
            "state": state,
            "sensors": [str(name) for name in told["sensors"]],
            "worker": told["worker"],
            "claim": told["claim"],
            "plots": told["plots"],
            "missed_scans": int(told["missed_scans"]),
            "lateness_p99_ms": float(told["lateness_p99_us"]) / 1e3,
            "sent_until_utc": told["sent_until_utc"],
            "age_s": age_s,
        }

    def _hear(self, topic: str, payload: bytes, _content_type: str | None) -> None:
        level, _, kind = topic.removeprefix(f"{self.root}/").partition("/")
        part = int(level) if level.isdecimal() and len(level) < 6 else 0
        told: Any = None
        with contextlib.suppress(ValueError, RecursionError):
            told = json.loads(payload)
        if kind == "gaps" and part:
            self._gaps[part] = told_gaps(payload)
        elif kind == "session" and isinstance(told, dict):
            self._gone[part] = str(told.get("session")) if told.get("state") == DIED else ""
        elif not kind and (status := part_status(payload)) is not None and status["part"] == part:
            before = self._statuses.get(part)
            if before is not None and before["number"] != status["number"]:
                self._fresh_s[part] = time.monotonic()
                now_ns = utc_ns(str(status.get("time_utc")))
                self._shift_ns = 0 if now_ns is None else now_ns - time.time_ns()
            self._statuses[part] = status


def gap_words(gap: Mapping[str, Any]) -> str:
    """A gap in a line: whose, how long, and why."""
    length_s = (gap["to_utc_ns"] - gap["from_utc_ns"]) / NS
    return f"nothing of part {gap['part']} for {length_s:.2f} s: {gap['why']}"
