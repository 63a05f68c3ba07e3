"""`plotfeed fleet` in a process of its own, and what a broker passes on of it."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from support.command import PLOTFEED
from support.fleet_oracle import Verdict, judged, reference
from support.waiting import wait_until

from plotfeed.feeds.scene.scene import load
from plotfeed.testing import MqttReceiver

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

    def verdict(self, more_gaps: Iterable[dict[str, Any]] = ()) -> Verdict:
        """What was heard of plots and tracks against what one process sends."""
        so_far, began_ns = [*self.client.heard], self.statuses()[1]["began_utc_ns"]
        duration_s = (time.time_ns() - began_ns) / NS + 1
        wanted, heard = reference(load(self.scene), began_ns, duration_s), defaultdict(list)
        topics = {message.topic for message in wanted}
        for message in so_far:
            if message.topic in topics:
                heard[message.topic].append(message.payload)
        return judged(wanted, heard, [*self.gaps(), *more_gaps])

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
