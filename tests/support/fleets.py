"""`plotfeed fleet` in a process of its own, and what a broker passes on of it."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from support.command import PLOTFEED
from support.waiting import wait_until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.testing import START_NS, MqttReceiver, fly, radar, rotating, scene, staring, waypoint

NS = 1_000_000_000


class Fleet:
    """One at work, and what is heard of it."""

    def __init__(
        self, scene: Path, port: int, errors: Path, *more: str, by_port: int | None = None
    ) -> None:
        """`by_port` is what its processes take for the broker's."""
        self.scene, self.port, self._errors = scene, port, errors
        self.client = MqttReceiver(port, 5, "plotfeed/#")
        url = f"mqtt://127.0.0.1:{by_port or port}"
        words = ["fleet", str(scene), "--broker", url, *more]
        self._out = errors.with_name("out")
        with self._out.open("w") as out, errors.open("w") as err:
            self.process = subprocess.Popen(
                [*PLOTFEED, *words], stdout=out, stderr=err, start_new_session=True
            )

    def statuses(self) -> dict[int, dict[str, Any]]:
        """What each part said last."""
        found = {}
        for message in [*self.client.heard]:
            level = message.topic.removeprefix("plotfeed/fleet/")
            if level.isdecimal():
                found[int(level)] = json.loads(message.payload)
        return found

    def gaps(self) -> list[dict[str, Any]]:
        """What all parts said last that nobody sent."""
        heard = {m.topic: m.payload for m in [*self.client.heard] if m.topic.endswith("/gaps")}
        return [gap for payload in heard.values() for gap in json.loads(payload)]

    def states(self, topic: str) -> list[str]:
        """What was said on a topic of how somebody is, one after the other."""
        heard = [m.payload for m in [*self.client.heard] if m.topic == topic and m.payload]
        return [str(json.loads(payload)["state"]) for payload in heard]

    def errors(self) -> str:
        return self._errors.read_text()

    def wait(self, holds: Callable[[], object], says: str) -> None:
        def is_so() -> bool:
            assert self.process.poll() is None, self.errors()
            return bool(holds())

        try:
            wait_until(is_so, says)
        except AssertionError:
            raise AssertionError(f"{says}: {self.statuses()} {self.errors()}") from None

    def sends(self, parts: int, claims: int = 0) -> bool:
        """Whether all parts do, and were taken so many times."""
        told = self.statuses()
        return (
            len(told) == parts
            and sum(each["claim"] for each in told.values()) >= claims
            and all(each["state"] == "RUNNING" for each in told.values())
        )

    def pid(self, part: int) -> int:
        """The process that has a part."""
        return int(self.statuses()[part]["worker"].rpartition(":")[2])

    def end(self, how: signal.Signals = signal.SIGTERM) -> int:
        """Have it end with all of its processes, as a terminal does: its exit code."""
        os.killpg(self.process.pid, how)
        return self.process.wait(120)

    def said(self) -> Any:
        """What it has printed, in JSON."""
        return json.loads(self._out.read_text())

    def verdict(self) -> Verdict:
        """What was heard of plots and tracks against what one process sends."""
        so_far, began_ns = [*self.client.heard], self.statuses()[1]["began_utc_ns"]
        duration_s = (time.time_ns() - began_ns) / NS + 1
        wanted, heard = reference(load(self.scene), began_ns, duration_s), defaultdict(list)
        topics = {message.topic for message in wanted}
        for message in so_far:
            if message.topic in topics:
                heard[message.topic].append(message.payload)
        return judged(wanted, heard, self.gaps())

    def heard_of(self, sensors: Iterable[str]) -> None:
        """Wait until each of those has sent more."""
        since = len(self.client.heard)
        for sensor in sensors:
            self.wait(
                lambda sensor=sensor: any(
                    m.topic.startswith(f"plotfeed/{sensor}/") and not m.retained
                    for m in self.client.heard[since:]
                ),
                f"nothing of {sensor}",
            )


@contextmanager
def fleet(scene: Path, port: int, *more: str, by_port: int | None = None) -> Iterator[Fleet]:
    """One at work, until this ends."""
    found = Fleet(scene, port, scene.with_name("errors"), *more, by_port=by_port)
    try:
        yield found
    finally:
        for each in found.statuses().values():
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(each["worker"].rpartition(":")[2]), signal.SIGCONT)
        found.process.terminate()
        try:
            found.process.wait(60)
        finally:
            found.process.kill()
            found.client.close()


@dataclass
class Verdict:
    """Numbers of messages, and which of one process's nobody heard, by topic."""

    heard: int = 0
    twice: int = 0
    foreign: int = 0  # That one process would not have sent
    foreign_topics: set[str] = field(default_factory=set)
    disordered: int = 0
    # Outside the gaps, up to the last that was heard of each topic.
    missing: list[Message] = field(default_factory=list)
    in_gaps: int = 0


def reference(scene: Scene, began_utc_ns: int, duration_s: float) -> list[Message]:
    """What one process sends of plots and tracks."""
    sent = fly(scene, duration_s, began_utc_ns).messages
    topics = by_topic(sent, began_utc_ns).keys()
    return [m for m in sent if not m.retain and m.topic in topics]


def judged(
    wanted: Sequence[Message],
    heard: Mapping[str, Sequence[bytes]],
    gaps: Sequence[Mapping[str, Any]],
) -> Verdict:
    """What was heard, by topic, against what one process sends."""
    verdict, of_topic = Verdict(), defaultdict[str, list[Message]](list)
    for message in wanted:
        of_topic[message.topic].append(message)
    for topic, payloads in heard.items():
        known = {message.payload: place for place, message in enumerate(of_topic[topic])}
        at = [known[payload] for payload in payloads if payload in known]
        verdict.heard += len(payloads)
        verdict.twice += len(payloads) - len(set(payloads))
        verdict.foreign += len(payloads) - len(at)
        verdict.foreign_topics |= {topic} if len(payloads) > len(at) else set()
        verdict.disordered += sum(a > b for a, b in pairwise(at))
        came = set(at)
        missed = [m for place, m in enumerate(of_topic[topic][: max(came, default=-1) + 1])
                  if place not in came]  # fmt: skip
        told = [any(_is_in(gap, message) for gap in gaps) for message in missed]
        verdict.in_gaps += sum(told)
        verdict.missing += [m for m, is_told in zip(missed, told, strict=True) if not is_told]
    return verdict


def _is_in(gap: Mapping[str, Any], message: Message) -> bool:
    sensor = message.topic.split("/")[1]
    ends_ns = gap["to_utc_ns"]
    return (
        sensor in gap["sensors"]
        and message.due_utc_ns > gap["from_utc_ns"]
        and (ends_ns is None or message.due_utc_ns <= ends_ns)
    )


EVENT = {"from_s": 2.0, "to_s": 3.5, "set": {"pfa": 1e-4}}


def sensors() -> list[dict[str, Any]]:
    """Eight groups: of a tracker, a beam that is steered, a camera that a radar cues."""
    far = radar(pfa=1e-6, scan=rotating(1.0, 16))
    kinds: dict[str, dict[str, Any]] = {
        "turns": far,
        "jitters": far | {"scan": rotating(0.7, 8) | {"jitter_ms": 2.0}},
        "changes": far | {"event": [EVENT]},
        "drifts": far | {"drift": {"sigma_range_m": 3.0, "time_constant_s": 60.0}},
        "tracks": far | {"report": ["asterix-062"], "tracks": {"kind": "plain"}},
        "steers": far
        | {"scan": {"kind": "electronic", "period_s": 0.5, "dwell_s": 0.01}, "integration_s": 0.01},
        "stares": far | {"scan": staring(0.5)},
        "cues": far,
        "camera": {
            "type": "camera", "scan": staring(0.2), "range_max_m": 5000.0,
            "horizontal_fov_deg": 40.0, "pixels_across": 8000, "pixels_down": 6000,
            "false_alarms_per_frame": 0.3, "mount": {"cued_by": "cues"},
        },
    }  # fmt: skip
    return [
        keys | {"id": name, "position_enu_m": [700.0 * i - 2000.0, 300.0 * (i % 3), 0.0]}
        for i, (name, keys) in enumerate(kinds.items())
    ]


def drones(
    n: int = 12, seed: int = 1, elevation_deg: float = 15.0, reach_m: tuple[int, int] = (500, 5000)
) -> list[dict[str, Any]]:
    by_chance = random.Random(seed)  # noqa: S311

    def place() -> dict[str, float]:
        azimuth_deg, up_deg = by_chance.uniform(0, 360), by_chance.uniform(2, elevation_deg)
        return waypoint(azimuth_deg, up_deg, by_chance.uniform(*reach_m))

    return [
        {"id": f"d{seed}-{i}", "speed_m_s": by_chance.uniform(5, 60), "repeat": True, "rcs_m2": 0.5,
         "path": [place() for _ in range(3)]}
        for i in range(n)
    ]  # fmt: skip


def mixed(**more: Any) -> Scene:
    """A scene of all of them."""
    return scene(sensors(), drones(), seed=11, **more)


def stateless(**more: Any) -> Scene:
    """Those whose octets are the same where a slow machine has left scans out before."""
    state = {"tracks", "steers", "camera"}
    some = [sensor for sensor in sensors() if sensor["id"] not in state]
    return scene(some, drones(), seed=11, **more)


def by_topic(messages: list[Message], after_ns: int = START_NS) -> dict[str, list[bytes]]:
    """Payloads of plots and tracks by topic, of what was due after a time; in their order."""
    found = defaultdict(list)
    for message in messages:
        if not message.retain and message.due_utc_ns > after_ns:
            found[message.topic].append(message.payload)
    found.pop("plotfeed/truth", None)
    return dict(found)
