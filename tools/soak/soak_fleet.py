"""A fleet whose processes are killed, frozen and cut off at random times, against one process.

    python tools/soak/soak_fleet.py --minutes 10 --seed 1
    python tools/soak/soak_fleet.py --minutes 10 --page       # and its figures in docs/fleet.md

Every few seconds a process gets SIGKILL, or SIGSTOP for a while and then SIGCONT, or all are cut
off from the broker for a while; the seed says what and when. What a subscriber heard is held
against what one process sends of the same scene. Fails where a message came twice, or out of order,
or is none that one process sends, or where one is missing outside the gaps that the parts tell of.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

sys.path.extend(
    str(Path(__file__).parents[2] / room) for room in ("tests", "docs/commands", "tools/benchmarks")
)

from aims import spread
from pages import between
from support.brokers import free_port, quiet_mosquitto
from support.fleets import NS, Fleet, fleet
from support.scene_files import DRONE, radar, scene_file, scene_text
from support.servers import Proxy, proxied

DOCS = Path(__file__).parents[2] / "docs" / "fleet.md"
# Of what came of it: each must be 0.
PROPERTIES = ("twice", "foreign", "disordered", "missing", "code")
FAULTS = ("killed", "frozen", "cut off")
FROZEN_S, CUT_S, PAUSE_S = (0.3, 8.0), (0.0, 3.0), (3.0, 8.0)
TRACKS_OF = 4  # One radar of so many sends tracks: those at one end, so that they are in one part


def tracking(radars: int) -> range:
    """Which of the radars send tracks."""
    return range(radars - radars // TRACKS_OF, radars)


def text_of_scene(radars: int) -> str:
    """Radars in a row; the last ones send tracks, which keep a state."""
    tracks = '\nreport = ["asterix-062"]'
    sensors = []
    for i in range(radars):
        place = f"position_enu_m = [{400.0 * i}, 0.0, 0.0]"
        more = place + tracks if i in tracking(radars) else place
        sensors.append(radar(f"r{i}", period_s=1.0, sectors=8, more=more))
    return scene_text(sensors="".join(sensors), drones=DRONE)


class Disturber:
    """What becomes of workers, by chance."""

    def __init__(self, at_work: Fleet, proxy: ProxyThread, seed: int) -> None:
        self.did: Counter[str] = Counter()
        self._fleet, self._proxy = at_work, proxy
        self._by_chance = random.Random(seed)  # noqa: S311

    def disturb(self, until_s: float) -> None:
        """One fault after the other, until then."""
        while time.monotonic() < until_s:
            time.sleep(self._by_chance.uniform(*PAUSE_S))
            what = self._by_chance.choice(FAULTS)
            pid = self._fleet.pid(self._by_chance.choice(sorted(self._fleet.statuses())))
            with suppress(ProcessLookupError):
                os.kill(pid, 0)
                self.did[what] += 1
                if what == "killed":
                    os.kill(pid, signal.SIGKILL)
                elif what == "frozen":
                    os.kill(pid, signal.SIGSTOP)
                    time.sleep(self._by_chance.uniform(*FROZEN_S))
                    os.kill(pid, signal.SIGCONT)
                else:
                    self._cut_off(self._by_chance.uniform(*CUT_S))

    def _cut_off(self, for_s: float) -> None:
        self._proxy.cut(closed=True)
        time.sleep(for_s)
        self._proxy.cut(closed=False)


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
    words = ["--workers", str(asked.workers), "--spares", str(asked.spares)]
    with quiet_mosquitto(folder, port):
        proxy = ProxyThread(port)
        with fleet(scene, port, *words, by_port=proxy.port) as at_work:
            at_work.wait(lambda: at_work.sends(asked.workers), "it never began")
            at_work.heard_of(names)
            disturber = Disturber(at_work, proxy, asked.seed)
            disturber.disturb(time.monotonic() + 60 * asked.minutes)
            at_work.wait(lambda: at_work.sends(asked.workers), "it never sent again")
            at_work.heard_of(names)
            verdict = at_work.verdict()
            told, gaps = at_work.statuses(), at_work.gaps()
            code = at_work.end()
    with_state = {f"r{i}" for i in tracking(asked.radars)}
    gaps_s: dict[str, list[float]] = {"late": [], "taken over": [], "taken over, tracks": []}
    for gap in gaps:
        kind = "taken over, tracks" if with_state & set(gap["sensors"]) else "taken over"
        is_late = not gap["why"].endswith("no longer sends")
        length_s = (gap["to_utc_ns"] - gap["from_utc_ns"]) / NS
        gaps_s["late" if is_late else kind].append(length_s)
    return {
        "code": code,
        "minutes": asked.minutes,
        "workers": asked.workers,
        "spares": asked.spares,
        "did": dict(disturber.did),
        "takeovers": sum(each["claim"] - 1 for each in told.values()),
        "gaps_s": gaps_s,
        "heard": verdict.heard,
        "twice": verdict.twice,
        "foreign": verdict.foreign,
        "disordered": verdict.disordered,
        "in_gaps": verdict.in_gaps,
        "missing": len(verdict.missing),
        "load": os.getloadavg()[1],
    }


def lines(found: dict[str, Any]) -> list[str]:
    """What came of it, as the page has it."""
    did = ", ".join(f"{n} {what}" for what, n in sorted(found["did"].items()))
    gaps = {kind: _lengths(each) for kind, each in found["gaps_s"].items()}
    return [
        f"- {found['minutes']:g} minutes, load average {found['load']:.1f}; {found['workers']} "
        f"parts, of each {found['spares']} standing by: {did}; {found['takeovers']} take-overs.",
        f"- Gaps told of a take-over: {gaps['taken over']}; where a part keeps tracks: "
        f"{gaps['taken over, tracks']}.",
        f"- Gaps told since a process was late, or had no broker: {gaps['late']}.",
        f"- Heard: {found['heard']:,} messages of plots and tracks. Not one process's bytes: "
        f"{found['foreign']}; twice: {found['twice']}; out of order: {found['disordered']}.",
        f"- Missing in the gaps that were told: {found['in_gaps']:,}; outside: {found['missing']}.",
    ]


def _lengths(gaps_s: list[float]) -> str:
    if not gaps_s:
        return "no time"
    return f"{spread(gaps_s)} s, {len(gaps_s)} times"


def main() -> None:
    """Runs it, prints what came of it, and fails where that is not as it should be."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--radars", type=int, default=12)
    parser.add_argument("--spares", type=int, default=1)
    parser.add_argument("--page", action="store_true", help="write the figures to docs/fleet.md")
    asked = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # and end all that was started
    with tempfile.TemporaryDirectory() as name:
        found = soaked(Path(name), asked)
    print("\n".join(lines(found)))
    print(json.dumps(found))
    if asked.page:
        between(DOCS, "soak", "\n".join(lines(found)))
    wrong = [what for what in PROPERTIES if found[what]]
    if wrong or not found["heard"]:
        sys.exit(f"not as it should be: {', '.join(wrong) or 'nothing was heard'}")


if __name__ == "__main__":
    main()
