"""A long session, and what it costs: docs/soak.md and its pictures.

    python tools/soak/soak.py --minutes 30                  # under everything at once
    python tools/soak/soak.py --minutes 30 --radars 200     # many sensors, and nothing goes wrong
    python tools/soak/soak.py --page FOLDER                 # the page again, from what a run left

Under everything at once: the four sensors of section 4 and three rotating radars, each over an
impaired link of its own; live telemetry with some garbage in it, commands, a broker that is killed,
stopped and paused by turns, everything recorded. With `--radars`, as many of 32 sectors at 1 Hz in
step, telemetry of 50 drones at 10 Hz, a subscriber to all of it and clock_nanosleep of C beside it;
`--fault-every` has the broker go there too. The session is `plotfeed run` in a process of its own,
looked at from outside.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

sys.path.extend(str(Path(__file__).parents[2] / room) for room in ("tests", "tools/benchmarks"))

import numpy as np
from aims import cpu_s
from beside import Arrivals, nanosleep
from prometheus_client.parser import text_string_to_metric_families
from soak_page import write_page
from soak_scene import KEPT_MESSAGES, Load, everything, many_radars, reported
from support.brokers import free_port, mosquitto, own_broker, wait_until_listening
from support.command import PLOTFEED
from support.tools import place_of

from plotfeed.testing import MqttReceiver

DOCS = Path(__file__).parents[2] / "docs"
SAMPLE_EVERY_S = 5.0
CONTROL_EVERY_S = 17.0
# What happens to the broker by turns, and for how long.
FAULTS = (("killed", 5.0), ("stopped", 20.0), ("paused", 10.0))


class Broker:
    """Mosquitto where it is installed and wanted, else our own; it can be brought down and up."""

    def __init__(self, folder: Path, name: str) -> None:
        self.port = free_port()
        self.is_up = False
        self.name = name if place_of("mosquitto") else "embedded"
        self._folder = folder
        self._running: Any = None
        self._process: subprocess.Popen[bytes]

    def start(self) -> None:
        if self.name == "mosquitto":
            self._running = mosquitto(self._folder, self.port)
        else:
            self._running = own_broker(self._folder, self.port)
        self._process = self._running.__enter__()
        self.is_up = True

    def stop(self) -> None:
        self.is_up = False
        self._running.__exit__(None, None, None)

    def own_mb(self) -> float:
        """Its own memory; NaN while it is down."""
        with suppress(OSError):
            return of_process(self._process.pid)["own_mb"]
        return math.nan

    def suffer(self, what: str, for_s: float, wait: Callable[[float], object]) -> None:
        """One of the faults."""
        self.is_up = False
        if what == "paused":
            self._process.send_signal(signal.SIGSTOP)
            wait(for_s)
            self._process.send_signal(signal.SIGCONT)
            self.is_up = True
            return
        if what == "killed":
            self._process.kill()
            self._process.wait()
        self.stop()
        wait(for_s)
        self.start()


@dataclass
class Soak:
    """A run: who works beside the session, and what is seen of it."""

    folder: Path
    minutes: float
    load: Load
    broker_name: str
    faults: list[dict[str, Any]] = field(default_factory=list)
    over: threading.Event = field(default_factory=threading.Event)
    published: int = 0
    commands: int = 0

    def __post_init__(self) -> None:
        self.broker = Broker(self.folder, self.broker_name)

    def run(self) -> None:
        """All of it."""
        scene = self.folder / "scene.toml"
        scene.write_text(self.load.scene)
        self.broker.start()
        beside, arrivals = None, None
        try:
            if not self.load.is_recorded:
                arrivals = Arrivals(self.broker.port)
            with self.session(scene) as (process, port):
                if not self.load.is_recorded:
                    beside = nanosleep(round(self.minutes * 60 * 100), 10_000_000)
                helpers = [
                    threading.Thread(target=work, daemon=True)
                    for work in (self.publish, self.disturb)
                ]
                for helper in helpers:
                    helper.start()
                began = {"utc_ns": time.time_ns(), "load": os.getloadavg()}
                self.sample(process, port)
                self.over.set()
                for helper in helpers:
                    helper.join()
                exit_s, code = ended(process)
            arrived = None if arrivals is None else arrivals.count()
        finally:
            self.broker.stop()
        if beside is not None:
            np.save(self.folder / "nanosleep.npy", beside())
        said = {
            "arrived": arrived,
            "began": began,
            "minutes": self.minutes,
            "broker": self.broker.name,
            "faults": self.faults,
            "published": self.published,
            "commands": self.commands,
            "exit_s": exit_s,
            "exit_code": code,
            "queue_messages": KEPT_MESSAGES,
            "sensors": self.load.scene.count("active_radar"),
            "drones": self.load.drones,
            "telemetry_hz": self.load.telemetry_hz,
            "nice": os.nice(0),
        }
        (self.folder / "run.json").write_text(json.dumps(said))

    @contextmanager
    def session(self, scene: Path) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
        """The session, at work, and the port of its metrics."""
        port = free_port()
        options = ["--broker", f"mqtt://127.0.0.1:{self.broker.port}", "--metrics", str(port)]
        if self.load.is_recorded:
            options += ["--record", str(self.folder / "soak.mcap")]
        options += ["--json"]
        with (self.folder / "out").open("wb") as out, (self.folder / "err").open("wb") as err:
            process = subprocess.Popen(
                [*PLOTFEED, "run", str(scene), *options], stdout=out, stderr=err
            )
            try:
                wait_until_listening(port)
                yield process, port
            finally:
                process.kill()
                process.wait()

    def disturb(self) -> None:
        """One fault after the other."""
        number = 0
        if math.isinf(self.load.fault_every_s):
            return
        while not self.over.wait(self.load.fault_every_s):
            what, for_s = FAULTS[number % len(FAULTS)]
            number += 1
            from_ns = time.time_ns()
            self.broker.suffer(what, for_s, self.over.wait)
            self.faults.append({"what": what, "from_ns": from_ns, "to_ns": time.time_ns()})

    def publish(self) -> None:
        """Telemetry and commands, by a client that comes back as often as it is thrown out."""
        load, client = self.load, None
        period_s = 1 / load.telemetry_hz
        next_s = next_command_s = time.monotonic() + period_s
        while not self.over.wait(max(0.0, next_s - time.monotonic())):
            next_s = max(next_s + period_s, time.monotonic() - 1.0)
            if client is None or client.ended:
                client = self._client()
                continue
            with suppress(OSError):
                client.publish_all([self._telemetry(drone) for drone in range(load.drones)])
                if load.commands and time.monotonic() > next_command_s:
                    next_command_s = time.monotonic() + CONTROL_EVERY_S
                    command = load.commands[self.commands % len(load.commands)]
                    client.publish("plotfeed/control", command)
                    self.commands += 1
        if client is not None:
            client.close()

    def _telemetry(self, drone: int) -> tuple[str, bytes]:
        self.published += 1
        payload = reported(drone, time.time_ns())
        if self.load.garbage_every and self.published % self.load.garbage_every == 0:
            payload = random.Random(self.published).randbytes(200)  # noqa: S311 - no secret
        return f"plotfeed/telemetry/d{drone}", payload

    def _client(self) -> MqttReceiver | None:
        with suppress(OSError):
            return MqttReceiver(self.broker.port, 5) if self.broker.is_up else None
        return None

    def sample(self, process: subprocess.Popen[bytes], port: int) -> None:
        """Look at the session now and then, until the time is up."""
        begin_s = time.monotonic()
        with (self.folder / "samples.jsonl").open("w") as file:
            for i in range(1 + round(self.minutes * 60 / SAMPLE_EVERY_S)):
                time.sleep(max(0.0, begin_s + i * SAMPLE_EVERY_S - time.monotonic()))
                if process.poll() is not None:
                    raise SystemExit(f"the session ended: {(self.folder / 'err').read_text()}")
                seen = {"t_s": time.monotonic() - begin_s, **of_process(process.pid)}
                seen["broker_mb"] = self.broker.own_mb()
                file.write(json.dumps(seen | of_machine() | of_session(port)) + "\n")
                file.flush()


def of_process(pid: int) -> dict[str, float]:
    """Memory, processor time, descriptors, threads."""
    status = dict(
        line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines()
    )
    return {
        "rss_mb": int(status["VmRSS"].split()[0]) * 1024 / 1e6,
        "own_mb": int(status["RssAnon"].split()[0]) * 1024 / 1e6,
        "cpu_s": cpu_s(pid),
        "threads": int(status["Threads"]),
        "descriptors": sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir()),
    }


def of_machine() -> dict[str, float]:
    """Its load, and the processor time that all took together."""
    times = [int(x) for x in Path("/proc/stat").read_text().splitlines()[0].split()[1:9]]
    busy = sum(times) - times[3] - times[4]
    return {"load": os.getloadavg()[0], "machine_cpu_s": busy / os.sysconf("SC_CLK_TCK")}


def of_session(port: int) -> dict[str, float]:
    """Its metrics, those of sensors added up."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics") as answer:
        text = answer.read().decode()
    found: dict[str, float] = {}
    for family in text_string_to_metric_families(text):
        for one in family.samples:
            name = one.name + one.labels.get("quantile", "")
            found[name] = found.get(name, 0.0) + one.value
    return found


def ended(process: subprocess.Popen[bytes]) -> tuple[float, int]:
    """How long a session takes to end when it is told to, and its exit code."""
    begin_s = time.monotonic()
    process.send_signal(signal.SIGTERM)
    code = process.wait(60)
    return time.monotonic() - begin_s, code


def prefer(nice: int) -> None:
    """Be as nice as that, to others of the same session of the system and to other sessions."""
    os.nice(nice)
    group = Path("/proc/self/autogroup")  # Linux shares time between groups first; see sched(7)
    if nice and group.exists():
        group.write_text(str(nice))


def main() -> None:
    """Runs, and writes the page."""
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--minutes", type=float, default=30.0)
    options.add_argument("--radars", type=int, metavar="N", help="instead of everything at once")
    options.add_argument("--fault-every", type=float, metavar="SECONDS")
    options.add_argument("--broker", choices=("mosquitto", "embedded"), default="mosquitto")
    options.add_argument("--nice", type=int, default=0, help="of all that the run consists of")
    options.add_argument("--page", type=Path, metavar="FOLDER", help="of a run that is over")
    options.add_argument("--to", type=Path, default=DOCS)
    asked = options.parse_args()
    folder = asked.page
    if folder is None:
        folder = Path(tempfile.mkdtemp(prefix="plotfeed-soak-"))
        print(folder, flush=True)
        prefer(asked.nice)
        load = everything() if asked.radars is None else many_radars(asked.radars)
        if asked.fault_every is not None:
            load = replace(load, fault_every_s=asked.fault_every)
        Soak(folder, asked.minutes, load, asked.broker).run()
    write_page(folder, asked.to)


if __name__ == "__main__":
    main()
