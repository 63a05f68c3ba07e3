"""Promises that take long, or a quiet machine, to try: a table in docs/soak.md with the date.

    python tools/soak/promises.py          # `make soak` runs it; it fails where a promise is broken

Each session is `plotfeed run` in a process of its own, with mosquitto or the embedded broker.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

sys.path.extend(
    str(Path(__file__).parents[2] / room)
    for room in ("tools", "tests", "docs/commands", "tools/benchmarks")
)

from fuzz.first_seeds import seeds_of
from pages import between, table
from soak_scene import reported
from support.brokers import free_port, mosquitto, quiet_mosquitto, wait_until_listening
from support.command import PLOTFEED, plotfeed
from support.scene_files import radar, scene_file, scene_text

from plotfeed.testing import MqttReceiver

DOCS = Path(__file__).parents[2] / "docs"
START = "2026-01-01T12:00:00Z"
SENSORS = radar("one", period_s=1.0, sectors=32) + radar("two", period_s=2.0, sectors=16)
EXIT_S = 2.0


def begun(*words: object) -> subprocess.Popen[bytes]:
    """A session that ends with its totals."""
    command = [*PLOTFEED, *map(str, words), "--json"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)


def totals_of(session: subprocess.Popen[bytes]) -> dict[str, Any]:
    """What a session that ends by itself says at its end."""
    found: dict[str, Any] = json.loads(session.communicate(timeout=120)[0].splitlines()[-1])
    return found


class Kept(NamedTuple):
    """A promise, what was seen, and whether it was kept."""

    promise: str
    seen: str
    is_kept: bool


def exits(folder: Path, times: int) -> Kept:
    """SIGTERM to a session that records, serves its page, and whose broker is there or paused."""
    took_s = []
    for number in range(times):
        port = free_port()
        with mosquitto(folder, port) as broker:
            session = begun(
                *("run", scene_file(folder, scene_text(sensors=SENSORS)), "--page", free_port()),
                *("--broker", f"mqtt://127.0.0.1:{port}", "--force"),
                *("--record", folder / "exit.mcap"),
            )
            tracker = MqttReceiver(port, 5, "plotfeed/one/plots")
            tracker.wait_for(lambda _heard: True)
            if number % 2:
                broker.send_signal(signal.SIGSTOP)
                time.sleep(1.0)
            begin_s = time.monotonic()
            session.send_signal(signal.SIGTERM)
            assert session.wait(60) == 0
            took_s.append(time.monotonic() - begin_s)
            broker.send_signal(signal.SIGCONT)
            with suppress(OSError):
                tracker.close()
    took_s.sort()
    return Kept(
        f"A session ends within {EXIT_S:.0f} s of SIGTERM, its broker there or paused",
        f"{times} times, {took_s[0]:.2f} to {took_s[-1]:.2f} s, median {took_s[times // 2]:.2f}",
        took_s[-1] <= EXIT_S,
    )


def paused(folder: Path, for_s: float) -> Kept:
    """A broker that stands still: with QoS 1 everything is there in the end, once and in order."""
    port, scene = free_port(), scene_file(folder, scene_text(sensors=SENSORS, mqtt="qos = 1"))
    with mosquitto(folder, port) as broker:
        heard = MqttReceiver(port, 5, "plotfeed/+/asterix/034")
        options = ("--broker", f"mqtt://127.0.0.1:{port}", "--duration", for_s + 15)
        session = begun("run", scene, *options)
        heard.wait_for(lambda _: True)
        time.sleep(3.0)
        broker.send_signal(signal.SIGSTOP)
        time.sleep(for_s)
        broker.send_signal(signal.SIGCONT)
        totals = totals_of(session)
        time.sleep(1.0)
        came = {(m.topic, m.user_properties["id"]) for m in heard.heard if not m.retained}
        heard.close()
    sent_034 = (for_s + 15) * (33 + 17 / 2)
    return Kept(
        f"A broker paused for {for_s:.0f} s has all of QoS 1 afterwards; no scan is missed",
        f"{len(came):,} of about {sent_034:,.0f} messages of category 034, undelivered "
        f"{totals['undelivered']}, scans missed {totals['missed_scans']}",
        not totals["undelivered"] and not totals["missed_scans"] and len(came) > 0.97 * sent_034,
    )


def garbage(folder: Path, for_s: float) -> Kept:
    """Telemetry and commands that are none: each is counted, and no octet that leaves changes."""
    port = free_port()
    text = scene_text(sensors=SENSORS, start_utc=START, port=port)
    scene, calm, beside = scene_file(folder, text), folder / "calm", folder / "beside"
    options = ("--duration", for_s + 2, "--force")
    plotfeed("run", scene, *options, "--write", calm, "--speed", "max", "--broker", "none")
    rng, published = random.Random(1), 0  # noqa: S311
    seeds = [seed for name in ("telemetry", "control") for seed in seeds_of(name) if seed]
    session = begun("run", scene, *options, "--write", beside)
    wait_until_listening(port + 1)
    client = MqttReceiver(port + 1, 5, "plotfeed/one/plots")
    client.wait_for(lambda _: True)
    until_s = time.monotonic() + for_s
    while time.monotonic() < until_s:
        some = [bytearray(rng.choice(seeds)) for _ in range(100)]
        for octets in some:
            octets[rng.randrange(len(octets))] ^= 1 << rng.randrange(8)
        with suppress(OSError):
            client.publish_all(
                (f"plotfeed/telemetry/g{n % 7}", b"\xff" + bytes(octets))
                for n, octets in enumerate(some)
            )
            published += len(some)
        time.sleep(0.05)
    totals = totals_of(session)
    same = beside.read_bytes() == calm.read_bytes()
    return Kept(
        f"Garbage for {for_s:.0f} s changes no octet that leaves, and is counted",
        f"{published:,} messages, refused {totals['refused']:,}, of them dropped as a flood "
        f"{totals['flooded']:,}; octets {'the same' if same else 'OTHERS'}; "
        f"late p50 {totals['lateness_p50_us'] / 1e3:.2f} ms, p99 "
        f"{totals['lateness_p99_us'] / 1e3:.2f} ms",
        same and totals["refused"] == published,
    )


def burst(folder: Path, messages: int) -> Kept:
    """So many reports of fifty drones at once, by a broker that drops none: each is told of."""
    port, scene = free_port(), scene_file(folder, scene_text(sensors=SENSORS, drones=""))
    with quiet_mosquitto(folder, port):
        session = begun(*("run", scene, "--duration", 20, "--broker", f"mqtt://127.0.0.1:{port}"))
        client = MqttReceiver(port, 5, "plotfeed/one/plots")
        client.wait_for(lambda _: True)
        now_ns = time.time_ns()
        client.publish_all(
            (f"plotfeed/telemetry/d{n % 50}", reported(n % 50, now_ns + n // 50 * 1000))
            for n in range(messages)
        )
        totals = totals_of(session)
    told = totals["telemetry"] + totals["refused"]
    return Kept(
        f"Of {messages:,} messages at once, by mosquitto, each is told of",
        f"taken {totals['telemetry']:,}, refused {totals['refused']:,}, scans missed "
        f"{totals['missed_scans']}",
        told == messages and not totals["missed_scans"],
    )


@contextmanager
def _folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="plotfeed-promises-") as folder:
        yield Path(folder)


def main() -> None:
    """Tries them all, and writes the table; the exit code is 1 if one is broken."""
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--quick", action="store_true", help="in two minutes; nothing is written")
    quick = options.parse_args().quick
    tries: list[tuple[Any, Any]] = [
        (exits, 4 if quick else 40),
        (paused, 5.0),
        (garbage, 5.0 if quick else 60.0),
        (burst, 50_000),
    ]
    found = []
    for promise, much in tries:
        with _folder() as folder:
            found.append(promise(folder, much))
            print(*found[-1], sep="\n  ", flush=True)
    if not quick:
        rows = [(each.promise, each.seen, "kept" if each.is_kept else "BROKEN") for each in found]
        day = f"{datetime.now(UTC):%Y-%m-%d}, load average {os.getloadavg()[0]:.1f}, two cores."
        text = "\n".join(table(("promise", "seen", ""), rows))
        between(DOCS / "soak.md", "promises", f"{text}\n\nTried on {day}")
    sys.exit(not all(each.is_kept for each in found))


if __name__ == "__main__":
    main()
