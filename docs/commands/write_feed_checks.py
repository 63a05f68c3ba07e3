"""Writes the tables of docs/feed-checks.md: which faults are named, and what right feeds fail.

python docs/commands/write_feed_checks.py [faults] [scenes]

Faults: the radars of examples/scenes/feed-faults.toml, a hundred of each with draws of their own,
in simulated time; a minute and a half of processor time. Scenes: every scene that comes with
plotfeed or is an example, each a session of a minute with 20 seeds, judged from its recording and
by the score that runs beside it; six minutes of processor time, on
as many processes as there are cores.
"""

from __future__ import annotations

import asyncio
import os
import platform
import sys
import tempfile
from collections.abc import Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from pathlib import Path
from typing import NamedTuple

from pages import between, table
from scipy.stats import binom

import plotfeed.feeds.scene.examples
from plotfeed.feeds.engine.simulation import simulate
from plotfeed.feeds.lab.gathering import judged_recording
from plotfeed.feeds.lab.judge import FALSE_RATES, FeedTally, Verdicts, simulated_feed
from plotfeed.feeds.lab.laws import share_interval
from plotfeed.feeds.lab.live import LiveScore
from plotfeed.feeds.recording.recorder import Recorder, SessionRecorder, attachments_of
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto.utc import NS

DOCS = Path(__file__).parents[1]
PAGE = DOCS / "feed-checks.md"
EXAMPLES = DOCS.parent / "examples" / "scenes"
SCENE = EXAMPLES / "feed-faults.toml"
SCENES = sorted(
    [*Path(plotfeed.feeds.scene.examples.__file__).parent.glob("*.toml"), *EXAMPLES.glob("*.toml")],
    key=lambda path: path.stem,
)
START_UTC_NS = 1_767_268_800 * NS
FALSE_RATE = FALSE_RATES["claimed"]
SEEDS, CLEAN = 100, 1000
SECONDS = (15.0, 30.0, 60.0)
SCENE_SEEDS, SCENE_S = 20, 60.0
TITLES = {
    "askew": ("azimuth 2° off", {"azimuth"}),
    "late": ("stamped 1 s late", {"time"}),
    "blind": ("Pd × 0.6", {"Pd"}),
    "cluttered": ("false alarms × 4", {"false alarms"}),
    "lying": ("errors × 2.5", {f"{q} spread" for q in ("range", "azimuth", "elevation", "height")}),
}
PLANTED: Mapping[str, Mapping[str, set[str]]] = {
    "airport": {"south": {"azimuth", "time"}},
    "feed-faults": {sensor: names for sensor, (_, names) in TITLES.items()},
}
"""The sensors of scenes that are not as they claim, and the checks that say so."""


class _EverySecond(Observer):
    """Asks for the live score at each second of a session, and keeps what it ever calls wrong."""

    def __init__(self, live: LiveScore) -> None:
        self.wrong: set[tuple[str, str]] = set()
        self._live, self._next_ns = live, START_UTC_NS + NS

    def before_due(self, due_utc_ns: int) -> None:
        """What is due at that time is done next."""
        while due_utc_ns > self._next_ns:
            found = self._live.score(self._next_ns)
            for each in found["feed"] if found else ():
                if each["wrong"]:
                    self.wrong.add((each["sensor"], each["check"]))
            self._next_ns += NS


class SceneVerdicts(NamedTuple):
    """What is called wrong of a session, (sensor, check): in its recording, and ever live."""

    recorded: set[tuple[str, str]]
    live: set[tuple[str, str]]


def scene_verdicts(path: Path, seed: int, seconds: float) -> SceneVerdicts:
    """The verdicts on a session of a scene with that seed, in simulated time without a broker."""
    scene = load(path)
    general = scene.scene.model_copy(update={"seed": seed})
    scene = scene.model_copy(update={"scene": general, "http": (), "udp": ()})
    live = LiveScore()
    every = _EverySecond(live)
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "run.mcap"

        async def session() -> None:
            with Recorder(record, attachments=attachments_of(scene, START_UTC_NS)) as recorder:
                recording = SessionRecorder(recorder, ledger_is_sent=scene.mqtt.truth)
                await run(
                    scene,
                    clock=InstantClock(START_UTC_NS),
                    broker="none",
                    duration_s=seconds,
                    observers=[recording, live, every],
                )

        asyncio.run(session())
        told = judged_recording(record, "claimed").verdicts
        recorded = {(each.sensor, each.name) for each in told.wrong}
    return SceneVerdicts(recorded, every.wrong)


def of_right_feeds(scene: str, wrong: Iterable[tuple[str, str]]) -> set[str]:
    """What is called wrong of the sensors that are as they claim."""
    planted = PLANTED.get(scene, {})
    return {f"{sensor}: {check}" for sensor, check in wrong if sensor not in planted}


def names_all(scene: str, wrong: set[tuple[str, str]]) -> bool:
    """Whether each sensor that is not as it claims has its fault named."""
    return all(
        {check for sensor, check in wrong if sensor == each} & names
        for each, names in PLANTED.get(scene, {}).items()
    )


def called_wrong(scene: Scene, name: str, copies: int, seconds: float) -> list[set[str]]:
    """The checks that each of so many equal radars fails."""
    sensor = next(s for s in scene.sensor if s.id == name)
    many = tuple(sensor.model_copy(update={"id": f"{name}-{i}"}) for i in range(copies))
    made = scene.model_copy(update={"sensor": many})
    found = []
    for seen in simulate(made, seconds, start_utc_ns=START_UTC_NS).values():
        tally = FeedTally("claimed")
        tally.take(simulated_feed(made, seen))
        found.append({c.name for c in Verdicts.of(tally.checks(), "claimed").wrong})
    return found


def write_faults() -> None:
    """Count how often each planted fault is named, and write the table."""
    scene, rows = load(SCENE), []
    for name, (title, names) in TITLES.items():
        cells = []
        for seconds in SECONDS:
            found = called_wrong(scene, name, SEEDS, seconds)
            named = sum(bool(names & each) for each in found)
            alone = sum(bool(each) and each <= names for each in found)
            cells.append(f"{named} ({alone})")
            print(name, seconds, cells[-1], flush=True)
        rows.append((title, ", ".join(sorted(names)), *cells))
    clean = []
    for seconds in SECONDS:
        failed = sum(map(bool, called_wrong(scene, "clean", CLEAN, seconds)))
        low, high = share_interval(failed, CLEAN)
        clean.append(f"{failed} of {CLEAN} ({100 * low:.1f}-{100 * high:.1f} %)")
        print("clean", seconds, clean[-1], flush=True)
    rows.append(("none", "none", *clean))
    head = ("fault", "named", *(f">{seconds:g} s" for seconds in SECONDS))
    between(PAGE, "rates", "\n".join(table(head, rows)))


def write_scenes() -> None:
    """Count the wrong verdicts on every scene, live and recorded, and write the table."""
    rows, sums, seeds = [], {"recorded": 0, "live": 0}, range(1, SCENE_SEEDS + 1)
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        by_scene = [
            (path.stem, pool.map(scene_verdicts, repeat(path), seeds, repeat(SCENE_S)))
            for path in SCENES
        ]
        for name, sessions in by_scene:
            called, cells, named, found = set(), [], [], list(sessions)
            for way in sums:
                of_way = [getattr(each, way) for each in found]
                wrong = [of_right_feeds(name, each) for each in of_way]
                count = sum(map(bool, wrong))
                called.update(*wrong)
                sums[way] += count
                cells += [count, f"{_as_many(count, SCENE_SEEDS):.2g}"]
                named.append(str(sum(names_all(name, each) for each in of_way)))
            told = " and ".join(named) if name in PLANTED else ""
            rows.append((name, *cells, ", ".join(sorted(called)), told))
            print(*rows[-1], flush=True)
    every = SCENE_SEEDS * len(SCENES)
    total = [f(n) for n in sums.values() for f in (str, lambda n: f"{_as_many(n, every):.2g}")]
    rows.append((f"all {every} sessions", *total, "", ""))
    head = ("scene", ">recorded", ">p", ">live", ">p", "called wrong", "planted faults named")
    made = (
        f"{SCENE_SEEDS} sessions of {SCENE_S:g} s each, seeds 1 to {SCENE_SEEDS}; "
        f"Python {platform.python_version()}, {platform.system()} {platform.machine()}, "
        f"{os.cpu_count()} cores."
    )
    between(PAGE, "scenes", "\n".join([*table(head, rows), "", made]))


def _as_many(count: int, of: int) -> float:
    """Probability of as many wrong verdicts or more at the rate that is stated."""
    return float(binom.sf(count - 1, of, FALSE_RATE))


def main() -> None:
    """Count, and write."""
    asked = sys.argv[1:] or ["faults", "scenes"]
    if "faults" in asked:
        write_faults()
    if "scenes" in asked:
        write_scenes()


if __name__ == "__main__":
    main()
