"""How the parts of a fleet do, as they say at a broker: for a terminal, and for the page."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from plotfeed.feeds.fleet.part_hold import PATIENCE_S, part_status, told_gaps
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.part import FLEET
from plotfeed.feeds.session.presence import DIED, ENDED, session_told
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto.utc import NS, utc_ns

SILENT, UNKNOWN = "silent", "not heard of"
SHOWN = ("worker", "sensors", "plots", "missed_scans", "lateness_p99_us", "sent_until_utc", "age_s")


class FleetWatch:
    """Listens to the parts that run on a scene's prefix."""

    def __init__(self, scene: Scene, address: BrokerAddress) -> None:
        self.scene = scene
        self.root = f"{scene.mqtt.prefix}/{FLEET}"
        self.link = MqttTransport(
            address, "plotfeed-fleet", subscribe=[f"{self.root}/#"], on_message=self._hear
        )
        self._statuses: dict[int, dict[str, Any]] = {}
        # When a part was last heard to go on, by this machine's monotonic clock.
        self._fresh_s: dict[int, float] = {}
        self._gone: dict[int, str] = {}  # Processes of which a last will says that they died
        self._gaps: dict[int, list[dict[str, Any]]] = {}
        self._shift_ns = 0

    @property
    def is_heard(self) -> bool:
        """Whether any part has said anything."""
        return bool(self._statuses)

    @property
    def now_utc_ns(self) -> int:
        """The scene's time."""
        return time.time_ns() + self._shift_ns

    def news(self) -> dict[str, Any]:
        """What is known, as JSON: a row for each part of the fleet that was heard of last."""
        told, nobody = self._statuses.values(), {"parts": 0, "scene": ""}
        last: dict[str, Any] = max(told, key=lambda each: str(each["time_utc"]), default=nobody)
        parts = range(1, last["parts"] + 1)
        rows = [self._row(k, last["parts"]) for k in parts]
        return {
            "scene": last["scene"],
            "takeovers": sum(max(row["claim"] - 1, 0) for row in rows),
            "parts": rows,
            "gaps": [{"part": k, **gap} for k in parts for gap in self._gaps.get(k, ())],
        }

    def _row(self, part: int, parts: int) -> dict[str, Any]:
        told = self._statuses.get(part, {})
        if told.get("parts") != parts:
            nothing = {"sensors": [], "claim": 0, "lateness_p99_us": 0.0}
            return dict.fromkeys(SHOWN, None) | {"part": part, "state": UNKNOWN} | nothing
        fresh_s, state = self._fresh_s.get(part), told["state"]
        age_s = None if fresh_s is None else time.monotonic() - fresh_s
        if state != ENDED and self._gone.get(part) == told["process"]:
            state = DIED
        elif state != ENDED and (age_s is None or age_s > PATIENCE_S):
            state = SILENT
        shown = {key: told[key] for key in ("part", "claim", *SHOWN[:-1])}
        return {**shown, "state": state, "age_s": age_s}

    def _hear(self, topic: str, payload: bytes, _content_type: str | None) -> None:
        level, _, kind = topic.removeprefix(f"{self.root}/").partition("/")
        part = int(level) if level.isdecimal() and len(level) < 6 else 0
        if kind == "gaps" and part:
            self._gaps[part] = told_gaps(payload)
        elif kind == "session" and (told := session_told(payload)) is not None:
            self._gone[part] = told["session"] if told["state"] == DIED else ""
        elif not kind and (status := part_status(payload)) is not None and status["part"] == part:
            before = self._statuses.get(part)
            if before is not None and before["number"] != status["number"]:
                self._fresh_s[part] = time.monotonic()
                now_ns = time.time_ns()
                self._shift_ns = (utc_ns(status["time_utc"]) or now_ns) - now_ns
            self._statuses[part] = status


def gap_words(gap: Mapping[str, Any]) -> str:
    """A gap in a line: whose, how long, and why."""
    length_s = (gap["to_utc_ns"] - gap["from_utc_ns"]) / NS
    return f"nothing of part {gap['part']} for {length_s:.2f} s: {gap['why']}"
