"""A fleet whose workers are killed, frozen and cut off at random times, against one process.

    python tests/soak/soak_fleet.py --minutes 10 --seed 1
    python tests/soak/soak_fleet.py --minutes 10 --page       # and its figures in docs/fleet.md

Every few seconds a worker gets SIGKILL, or SIGSTOP for longer or shorter than its lease and then
SIGCONT, or all are cut off from the broker for a while; the seed says what and when. What a
subscriber heard is held against what one process sends of the same scene. Fails where a message
came twice, or out of order, or is none that one process sends, or where one is missing outside the
gaps that the fleet tells of, the times without a broker, and scans that it says it has missed.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import signal
import statistics
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.brokers import free_port, mosquitto
from support.cut_proxy import Proxy, proxied
from support.fleet_process import NS, Fleet, fleet
from support.scene_files import DRONE, radar, scene_file, scene_text

DOCS = Path(__file__).parents[2] / "docs" / "fleet.md"
BEGIN, END = "<!-- soak: begin -->", "<!-- soak: end -->"
FAULTS = ("killed", "frozen", "cut off")
AROUND_NS = NS
"""Before and after the times without a broker: until that is noticed, and connections are back."""


def text_of_scene(radars: int) -> str:
    """Radars in a row; one of four sends tracks, which keep a state."""
    tracks = '\nreport = ["asterix-062"]'
    sensors = [
        radar(
            f"r{i}",
            period_s=1.0,
            sectors=8,
            more=f"position_enu_m = [{400.0 * i}, 0.0, 0.0]" + (tracks if i % 4 == 3 else ""),
        )
        for i in range(radars)
    ]
    return scene_text(sensors="".join(sensors), drones=DRONE)


class Disturber:
    """What becomes of workers, by chance."""

    def __init__(self, at_work: Fleet, proxy: ProxyThread, seed: int, lease_s: float) -> None:
        self.did: Counter[str] = Counter()
        self.without_broker: list[tuple[int, int]] = []
        self._fleet, self._proxy, self._lease_s = at_work, proxy, lease_s
        self._by_chance = random.Random(seed)  # noqa: S311

    def disturb(self, until_s: float) -> None:
        """One fault after the other, until then."""
        while time.monotonic() < until_s:
            time.sleep(self._by_chance.uniform(2.0, 3 * self._lease_s))
            what = self._by_chance.choice(FAULTS)
            pids = sorted(self._fleet.pids().items())
            if not pids:
                continue
            _, pid = self._by_chance.choice(pids)
            self.did[what] += 1
            with suppress(ProcessLookupError):
                if what == "killed":
                    os.kill(pid, signal.SIGKILL)
                elif what == "frozen":
                    os.kill(pid, signal.SIGSTOP)
                    time.sleep(self._lease_s * self._by_chance.uniform(0.2, 2.5))
                    os.kill(pid, signal.SIGCONT)
                else:
                    self._cut_off(self._by_chance.uniform(0.0, 3.0))

    def _cut_off(self, for_s: float) -> None:
        from_ns = time.time_ns()
        self._proxy.cut(closed=True)
        time.sleep(for_s)
        self._proxy.cut(closed=False)
        self.without_broker.append((from_ns, time.time_ns()))


class ProxyThread:
    """What lies between the workers and the broker, in an event loop of its own."""

    def __init__(self, to_port: int) -> None:
        self.port = 0
        self._to_port = to_port
        self._ready = threading.Event()
        self._loop: asyncio.AbstractEventLoop
        self._proxy: Proxy
        threading.Thread(target=lambda: asyncio.run(self._run()), daemon=True).start()
        self._ready.wait()

    def cut(self, *, closed: bool) -> None:
        """Reset all connections, and take others or not."""

        def do() -> None:
            self._proxy.is_closed = closed
            self._proxy.cut()

        self._loop.call_soon_threadsafe(do)

    async def _run(self) -> None:
        async with proxied(self._to_port) as self._proxy:
            self._loop, self.port = asyncio.get_running_loop(), self._proxy.port
            self._ready.set()
            await asyncio.Event().wait()


def soaked(folder: Path, asked: argparse.Namespace) -> dict[str, Any]:
    """What came of it."""
    port = free_port()
    scene = scene_file(folder, text_of_scene(asked.radars))
    names = [f"r{i}" for i in range(asked.radars)]
    quiet = f"listener {port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\n"
    words = ["--workers", str(asked.workers), "--lease", str(asked.lease), "--spares", "2"]
    with mosquitto(folder, port, quiet):
        proxy = ProxyThread(port)
        with fleet(scene, port, *words, by_port=proxy.port) as at_work:
            at_work.wait(lambda: at_work.sends(asked.workers, 0), "it never began")
            at_work.heard_of(names)
            disturber = Disturber(at_work, proxy, asked.seed, asked.lease)
            disturber.disturb(time.monotonic() + 60 * asked.minutes)
            at_work.wait(lambda: at_work.sends(asked.workers, 0), "it never sent again")
            at_work.heard_of(names)
            told, missed = at_work.health(), missed_scans(at_work)
            code, duration_s = at_work.end()
        without = [
            {"sensors": names, "from_utc_ns": a - AROUND_NS, "to_utc_ns": b + 5 * AROUND_NS}
            for a, b in disturber.without_broker
        ]
        verdict = at_work.verdict(duration_s + 5, without)
    gaps_s = [(g["to_utc_ns"] - g["from_utc_ns"]) / NS for g in told["gaps"] if g["to_utc_ns"]]
    return {
        "code": code,
        "minutes": asked.minutes,
        "did": dict(disturber.did),
        "takeovers": told["takeovers"],
        "gaps_s": gaps_s,
        "heard": verdict.heard,
        "twice": verdict.twice,
        "foreign": verdict.foreign,
        "disordered": verdict.disordered,
        "in_gaps": verdict.in_gaps,
        "missing": len(verdict.missing),
        "missed_scans": missed,
    }


def missed_scans(at_work: Fleet) -> int:
    """Scans that workers say they have left out, being late."""
    found: dict[tuple[str, int], int] = {}
    for message in list(at_work.client.heard):
        if message.topic.startswith("plotfeed/fleet/") and "control" not in message.topic:
            told = json.loads(message.payload)
            found[told["part"], told["epoch"]] = told["missed_scans"]
    return sum(found.values())


def lines(found: dict[str, Any]) -> list[str]:
    """What came of it, as the page has it."""
    did = ", ".join(f"{n} {what}" for what, n in sorted(found["did"].items()))
    gaps = found["gaps_s"] or [0.0]
    return [
        f"- {found['minutes']:g} minutes; workers {did}; {found['takeovers']} take-overs.",
        f"- A gap lasted {statistics.median(gaps):.2f} s (median), {max(gaps):.2f} s at most.",
        f"- Heard: {found['heard']:,} messages of plots and tracks, octets as of one process; "
        f"twice {found['twice']}, out of order {found['disordered']}, others {found['foreign']}.",
        f"- Missing: {found['in_gaps']:,} in the gaps that were told or without a broker, "
        f"{found['missing']} outside; scans missed by late workers {found['missed_scans']}.",
    ]


def main() -> None:
    """Runs it, prints what came of it, and fails where that is not as it should be."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--radars", type=int, default=12)
    parser.add_argument("--lease", type=float, default=2.0)
    parser.add_argument("--page", action="store_true", help="write the figures to docs/fleet.md")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        found = soaked(Path(name), asked)
    print("\n".join(lines(found)))
    print(json.dumps(found))
    if asked.page:
        text = DOCS.read_text()
        before, _, rest = text.partition(BEGIN)
        _, _, after = rest.partition(END)
        DOCS.write_text(f"{before}{BEGIN}\n" + "\n".join(lines(found)) + f"\n{END}{after}")
    wrong = found["twice"] + found["foreign"] + found["disordered"] + found["code"]
    if wrong or (found["missing"] and not found["missed_scans"]):
        sys.exit(1)


if __name__ == "__main__":
    main()
