"""Writes the tables of docs/feed-checks.md: which faults are named, and what right feeds fail.

python docs/commands/write_feed_checks.py [faults] [kinds] [scenes]

Faults: the radars of examples/scenes/feed-faults.toml, a hundred of each with draws of their own,
in simulated time; a minute and a half of processor time. Kinds: a sensor of each kind of the
shipped scenes, 16 with each fault, over 40 and 120 s; five minutes of processor time. Scenes: every
scene that comes with plotfeed or is an example, each a session of a minute with 20 seeds, judged
from its recording and by the score that runs beside it; six minutes of processor time, on as many
processes as there are cores.
"""

from __future__ import annotations

import os
import platform
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pages import between, table
from scipy.stats import binom, norm, poisson

import plotfeed.feeds.scene.examples
from plotfeed.feeds.engine.simulation import SimulatedSensor, simulate
from plotfeed.feeds.lab.evidence import AskedSensor
from plotfeed.feeds.lab.gathering import FeedReport
from plotfeed.feeds.lab.judge import FALSE_RATES, FeedTally, Verdicts, simulated_feed
from plotfeed.feeds.lab.live import LiveScore
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.session.observer import Observer
from plotfeed.models.residuals import Check
from plotfeed.models.verdicts import share_interval
from plotfeed.proto.utc import NS
from plotfeed.testing import fly

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
# The sensors of scenes that are not as they claim, and the checks that say so.
PLANTED: Mapping[str, Mapping[str, set[str]]] = {
    "airport": {"south": {"azimuth", "time"}},
    "feed-faults": {sensor: names for sensor, (_, names) in TITLES.items()},
}


class Kind(NamedTuple):
    """A sensor of a scene, and by how much its azimuth is set off."""

    scene: str
    sensor: str
    azimuth_deg: float = 2.0
    # Whether its azimuths are off as they are told: of several receivers a bias is not modelled.
    tells_wrong: bool = False


KINDS = {
    "radar": Kind("field-day", "tower"),
    "steered beams": Kind("perimeter", "north-gate"),
    "MIMO": Kind("section-4", "mimo"),
    "passive": Kind("section-4", "passive"),
    "microphones": Kind("field-day", "ears", 5.0),
    "RF": Kind("field-day", "rf", 5.0),
    "camera": Kind("field-day", "camera"),
    "several receivers": Kind("several-receivers", "masts", tells_wrong=True),
}
# Errors are not judged of these: their plots do not err by the spread that they state.
UNJUDGED = "a pair of arrays, a layout"
COPIES, LENGTHS = 16, (40.0, 120.0)
# Named in so many of the copies, or with that probability, a fault needs no longer run.
MOST_NAMED, OFTEN = 15, 0.9
# Heights above mean sea level that are taken for those above the ellipsoid.
DATUM_M = 51.0
# By fault: the keys that a sensor has in truth, and which names are right.
OF_KINDS: Mapping[str, tuple[Mapping[str, Mapping[str, float]], Sequence[str]]] = {
    "azimuth off": ({"bias": {"azimuth_offset_deg": 1.0}}, ("azimuth", "azimuth or time")),
    "1 s late": ({"bias": {"time_offset_s": 1.0}}, ("time", "or time")),
    "Pd × 0.6": ({"degradation": {"pd_factor": 0.6}}, ("Pd",)),
    "clutter × 4": ({"degradation": {"false_alarm_factor": 4.0}}, ("false alarms",)),
    "σ × 2.5": ({"degradation": {"error_factor": 2.5}}, ("spread",)),
    "σ ÷ 2": ({"degradation": {"error_factor": 0.5}}, ("spread",)),
    "height datum": ({}, ("height",)),
    "none": ({}, ()),
}


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
        fly(scene, seconds, START_UTC_NS, record=record, observers=[live, every])
        told = FeedReport(record, "claimed").verdicts
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
        found.append({c.name for c in Verdicts(tally.checks(), "claimed").wrong})
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


def faulty(kind: Kind) -> Iterator[tuple[str, Scene, SimulatedSensor]]:
    """Each fault, the scene that says nothing of it, and what its sensor did, time and again."""
    path = next(path for path in SCENES if path.stem == kind.scene)
    scene = load(path)
    own = next(s for s in scene.sensor if s.id == kind.sensor)
    tree, copies = own.model_dump(exclude_unset=True), []
    for n, (fault, (keys, _)) in enumerate(OF_KINDS.items()):
        does = tree | {name: dict(table) for name, table in keys.items()}
        if kind.tells_wrong and fault == "azimuth off":
            does.pop("bias")
        elif "azimuth_offset_deg" in does.get("bias", {}):
            does["bias"]["azimuth_offset_deg"] = kind.azimuth_deg
        made = type(own).model_validate(does)
        copies += [made.model_copy(update={"id": f"fault-{n}-{i}"}) for i in range(COPIES)]
    whole = scene.model_copy(update={"sensor": tuple(copies)})
    found = simulate(whole, max(LENGTHS), start_utc_ns=START_UTC_NS)
    for sensor in copies:
        fault = list(OF_KINDS)[int(sensor.id.split("-")[1])]
        seen = found[sensor.id]
        if fault == "azimuth off" and kind.tells_wrong:
            told_deg = (seen.plots.azimuth_deg + kind.azimuth_deg) % 360
            seen = replace(seen, plots=seen.plots.but(azimuth_deg=told_deg))
        if fault == "height datum":
            seen = replace(seen, plots=seen.plots.but(height_m=seen.plots.height_m - DATUM_M))
        yield fault, whole, seen


def until(seen: SimulatedSensor, seconds: float) -> SimulatedSensor:
    """What a sensor did until then."""
    end_ns = START_UTC_NS + round(seconds * NS)
    return replace(
        seen,
        plots=seen.plots.rows(seen.plots.t_utc_ns < end_ns),
        looks=seen.looks.rows(seen.looks.t_utc_ns < end_ns),
        sectors=seen.sectors.rows(seen.sectors.end_ns < end_ns),
    )


def write_kinds(names: Iterable[str] = KINDS) -> None:
    """Count how often each fault of each kind of sensor is named, and write the table."""
    rows = []
    for name in names:
        found: dict[str, list[list[Sequence[Check]]]] = {fault: [[], []] for fault in OF_KINDS}
        for fault, scene, seen in faulty(KINDS[name]):
            says = seen.sensor.model_copy(update={"bias": None, "degradation": None})
            for runs, seconds in zip(found[fault], LENGTHS, strict=True):
                feed = simulated_feed(scene, until(seen, seconds))
                tally = FeedTally("claimed")
                tally.take(feed._replace(expected=[AskedSensor(scene, says).claimed]))
                runs.append(Verdicts(tally.checks(), "claimed").checks)
        period_s = says.scan.period_s
        rows.append((name, *(told_rates(fault, *found[fault], period_s) for fault in OF_KINDS)))
        print(*rows[-1], sep=" | ", flush=True)
    counted = ("Pd × 0.6", "clutter × 4", "none")
    of_others = ["not counted" if fault in counted else "not judged" for fault in OF_KINDS]
    rows.append((UNJUDGED, *of_others))
    head = ("kind", *(f">{fault}" for fault in OF_KINDS))
    between(PAGE, "kinds", "\n".join(table(head, rows)))


def told_rates(
    fault: str, short: list[Sequence[Check]], long: list[Sequence[Check]], period_s: float
) -> str:
    """In how many runs of each length a fault was named, and of which length it would be."""
    if fault == "none":
        return " / ".join(str(sum(any(c.wrong for c in run) for run in r)) for r in (short, long))
    ends = tuple(OF_KINDS[fault][1])
    named = [
        sum(any(c.wrong and c.name.endswith(ends) for c in run) for run in r) for r in (short, long)
    ]
    checks = [[c for c in run if c.name.endswith(ends)] for run in long]
    judged = [[c for c in run if c.is_judged] for run in checks]
    if not any(checks):
        return "-"
    if not any(judged):
        return "not judged"
    if fault == "clutter × 4" and not judged[0][0].expected:
        return "there is none"
    told = " / ".join(map(str, named))
    if named[-1] >= MOST_NAMED:
        return told
    least = FALSE_RATE / sum(c.is_judged for c in long[0])
    if fault == "clutter × 4":
        per_s = judged[0][0].expected / period_s
        means = np.geomspace(1e-3, 1e3, 500)
        seen = poisson.sf(poisson.isf(least, means), 4 * means) > OFTEN
        seconds = means[seen.argmax()] / per_s
    else:
        z = float(np.median([max(abs(c.z) for c in run) for run in judged if run]))
        seconds = max(LENGTHS) * ((norm.isf(least / 2) + norm.ppf(OFTEN)) / z) ** 2
    return f"{told}, {as_duration(seconds)}"


def as_duration(seconds: float) -> str:
    """A length of time in the unit that suits it, to two digits."""
    for unit, lasts_s in (("days", 86_400), ("h", 3600), ("min", 60)):
        if seconds > 3 * lasts_s:
            return f"{float(f'{seconds / lasts_s:.2g}'):g} {unit}"
    return f"{seconds:.0f} s"


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
    asked = sys.argv[1:] or ["faults", "kinds", "scenes"]
    if "faults" in asked:
        write_faults()
    if "kinds" in asked:
        write_kinds()
    if "scenes" in asked:
        write_scenes()


if __name__ == "__main__":
    main()
