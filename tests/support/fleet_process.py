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

import pytest
from support.command import PLOTFEED
from support.fleet_oracle import Verdict, judged, reference
from support.mqtt_client import Client
from support.waiting import wait_until

from plotfeed.feeds.scene.scene import load

NS = 1_000_000_000


def skip_without_ray(errors: str) -> None:
    """Skip a test where Ray's own processes do not start, as on a machine that is far too busy."""
    if "Ray cannot be started" in errors:
        pytest.skip("Ray cannot be started here")


class Fleet:
    """One at work, and what is heard of it."""

    def __init__(
        self, scene: Path, port: int, errors: Path, *more: str, by_port: int | None = None
    ) -> None:
        """`by_port` is what its workers take for the broker's."""
        self.scene, self.port, self._errors = scene, port, errors
        self.client = Client(port, 5, "plotfeed/#")
        url = f"mqtt://127.0.0.1:{by_port or port}"
        words = ["fleet", str(scene), "--broker", url, *more]
        with errors.open("w") as file:
            self.process = subprocess.Popen(
                [*PLOTFEED, *words], stdout=subprocess.DEVNULL, stderr=file
            )

    def health(self) -> dict[str, Any]:
        """What the fleet said last."""
        said = (m.payload for m in reversed([*self.client.heard]) if m.topic == "plotfeed/fleet")
        return dict(json.loads(next(said, b'{"parts": [], "takeovers": 0, "gaps": []}')))

    def errors(self) -> str:
        return self._errors.read_text()

    def wait(self, holds: Callable[[], object], says: str) -> None:
        def is_so() -> bool:
            skip_without_ray(self.errors())
            assert self.process.poll() is None, self.errors()
            return bool(holds())

        deadline_s = time.monotonic() + 180
        while True:
            try:
                return wait_until(is_so, says)
            except AssertionError:
                if time.monotonic() > deadline_s or self.process.poll() is not None:
                    raise AssertionError(f"{says}: {self.health()} {self.errors()}") from None

    def sends(self, parts: int, takeovers: int) -> bool:
        told = self.health()
        return (
            len(told["parts"]) == parts
            and told["takeovers"] >= takeovers
            and all(part["sends"] for part in told["parts"])
        )

    def pids(self) -> dict[str, int]:
        parts = self.health()["parts"]
        held = {part["part"]: part["worker"].rpartition(":")[2] for part in parts}
        return {part: int(pid) for part, pid in held.items() if pid}

    def end(self) -> tuple[int, float]:
        """Have it end: its exit code, and how long it ran in all, seconds."""
        ended_ns = time.time_ns()
        self.process.terminate()
        code = self.process.wait(120)
        return code, (ended_ns - self.began_ns) / NS

    @property
    def began_ns(self) -> int:
        """When its scene began."""
        return int(self.health()["began_utc_ns"])

    def verdict(
        self,
        duration_s: float,
        more_gaps: Iterable[dict[str, Any]] = (),
        first: int | None = None,
    ) -> Verdict:
        """What was heard of plots and tracks, or first of it, against what one process sends."""
        wanted, heard = reference(load(self.scene), self.began_ns, duration_s), defaultdict(list)
        topics = {message.topic for message in wanted}
        for message in self.client.heard[:first]:
            if message.topic in topics:
                heard[message.topic].append(message.payload)
        return judged(wanted, heard, [*self.health()["gaps"], *more_gaps])

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
        for pid in found.pids().values():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
        found.process.terminate()
        try:
            found.process.wait(60)
        finally:
            found.process.kill()
            found.client.close()
