"""How cost and memory grow with drones, sensors, sectors and messages.

    python tests/benchmarks/bench_scaling.py

Writes the table of docs/speed-accuracy.md, between its marks, and draws docs/scaling.png.
Every point is a process of its own, so that its memory is its own: CPU time of a second of the
scene, without a broker and as fast as it can, and the largest size that the process had. Points are
taken in turns. A straight line on log axes is a power; a + b n, which bends where n is a/b, is
fitted too.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
import resource
import statistics
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).parents[2]
PAGE = PROJECT / "docs" / "speed-accuracy.md"
PICTURE = PROJECT / "docs" / "scaling.png"
START_UTC = "2026-01-01T12:00:00Z"
TURNS = 3
SECONDS_A_POINT = 0.6
"""Of CPU, at least, unless one simulated second takes longer."""
MOST_SCANS = 256
MIB = 2**20

SERIES: dict[str, tuple[str, tuple[int, ...]]] = {
    "drones, staring": ("drones", (1, 10, 100, 1000, 10_000, 100_000)),
    "drones, rotating": ("drones", (1, 10, 100, 1000, 10_000, 100_000)),
    "sensors": ("sensors", (1, 3, 10, 30, 100, 300, 1000)),
    "sectors": ("sectors a turn", (4, 8, 16, 32, 64, 128, 256)),
    "messages": ("messages a second", (4, 16, 64, 256)),
}
"""What grows, and from where to where; of messages it is the number of sensors."""
FEW_DRONES, SOME_DRONES = 10, 100
END = 2
"""Points to which an exponent is fitted."""


def radar() -> dict[str, Any]:
    """The active radar of scene section-4, reporting in category 048."""
    tree = tomllib.loads((files("plotfeed.feeds.scene.examples") / "section-4.toml").read_text())
    (found,) = (s for s in tree["sensor"] if s["id"] == "active")
    return {**found, "report": ["asterix-048"]}


def scene_of(sensors: int, sectors: int) -> Any:
    """So many radars, 100 m from each other, that turn or, of one sector, stare."""
    from plotfeed.feeds.scene.scene import from_tree

    scan = {"kind": "rotating", "period_s": 1.0, "sectors": sectors}
    if sectors == 1:
        scan = {"kind": "staring", "period_s": 1.0}
    side = math.ceil(sensors**0.5)
    place = {"latitude_deg": 40.45, "longitude_deg": -3.73, "height_m": 650.0}
    tree = {
        "scene": {"name": "scaling", "seed": 1, "site": place},
        "mqtt": {"truth": False},
        "sensor": [
            {**radar(), "id": f"s{i}", "scan": scan,
             "position_enu_m": [100.0 * (i % side), 100.0 * (i // side), 0.0]}
            for i in range(sensors)
        ],
    }  # fmt: skip
    return from_tree(tree, Path("scaling.toml"))


def flown(scene: Any, n: int) -> Any:
    """Drones of 0.01 m2 all around, 2 to 7 km away, at 15 m/s; nobody hears of them anew."""
    import numpy as np

    from plotfeed.feeds.scene.fields import site_frame
    from plotfeed.models.frames import aer_to_enu
    from plotfeed.models.state import Signature
    from plotfeed.models.truth import Trajectories
    from plotfeed.proto.utc import NS

    rng, frame = np.random.default_rng(1), site_frame(scene.scene.site)
    start = aer_to_enu(rng.uniform(0, 360, n), rng.uniform(1, 10, n), rng.uniform(2000, 7000, n))
    moved = start + aer_to_enu(rng.uniform(0, 360, n), 0.0, 15.0 * 3600)
    knots = np.stack([frame.to_ecef(start), frame.to_ecef(moved)], axis=1)
    trajectories = Trajectories(stale_after_s=3.0)
    begin_ns = start_ns()
    for i in range(n):
        trajectories.add_path(f"d{i}", [begin_ns, begin_ns + 3600 * NS], knots[i],
                              signature=Signature(rcs_m2=0.01))  # fmt: skip
    return trajectories


def start_ns() -> int:
    """When every scene begins."""
    from datetime import datetime

    return int(datetime.fromisoformat(START_UTC).timestamp()) * 10**9


def stations_point(sensors: int, sectors: int, drones: int) -> dict[str, float]:
    """CPU of a second of stations that are asked for sector after sector; no session around."""
    from plotfeed.feeds.sensing.emulated_sensor import EmulatedSensor

    scene = scene_of(sensors, sectors)
    trajectories = flown(scene, drones)
    stations = [EmulatedSensor(scene, sensor, trajectories) for sensor in scene.sensor]
    at = [station.sector_at(start_ns() + 10**9) for station in stations]
    messages = 0

    def second() -> None:
        nonlocal messages
        for _ in range(sectors):
            for i, station in enumerate(stations):
                messages += len(station.report(at[i]).messages)
                at[i] = station.next_sector(at[i])

    second()  # what is made once is made
    messages, seconds = 0, 0
    began = time.process_time()
    while (spent := time.process_time() - began) < SECONDS_A_POINT and seconds < MOST_SCANS:
        second()
        seconds += 1
    spent = time.process_time() - began
    return {"cpu_s": spent / seconds, "messages": messages / seconds} | memory()


def session_point(sensors: int) -> dict[str, float]:
    """CPU of a second of a whole session, without a broker, of radars with 32 sectors.

    Two sessions, of which one lasts longer: what both spend, to begin and to end, falls out.
    """
    scene, seconds = scene_of(sensors, 32), max(4, 256 // sensors)
    short_s, _ = run_session(scene, 1)
    spent_s, messages = run_session(scene, 1 + seconds)
    return {"cpu_s": (spent_s - short_s) / seconds, "messages": messages} | memory()


def run_session(scene: Any, seconds: int) -> tuple[float, float]:
    """CPU, and messages a second."""
    from plotfeed.feeds.session.session import run
    from plotfeed.feeds.timing.clock import InstantClock

    seen = 0

    def tap(*_: object) -> None:
        nonlocal seen
        seen += 1

    began = time.process_time()
    clock = InstantClock(start_ns())
    asyncio.run(run(scene, clock=clock, broker="none", duration_s=float(seconds), tap=tap))
    return time.process_time() - began, seen / seconds


def memory() -> dict[str, float]:
    """The largest size that this process had."""
    return {"mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / MIB}


def point(series: str, n: int) -> dict[str, float]:
    """One of the points, in this process."""
    if series == "drones, staring":
        return stations_point(1, 1, n)
    if series == "drones, rotating":
        return stations_point(1, 32, n)
    if series == "sensors":
        return stations_point(n, 32, FEW_DRONES)
    if series == "sectors":
        return stations_point(1, n, SOME_DRONES)
    return session_point(n)


def in_a_process(series: str, n: int) -> dict[str, float]:
    """The same in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, "point", series, str(n)],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    return dict(json.loads(done.stdout))


def measured() -> dict[str, list[dict[str, float]]]:
    """Medians of all points, taken in turns: `n` is what grew."""
    found: dict[tuple[str, int], list[dict[str, float]]] = {}
    for _ in range(TURNS):
        for series, (_, sizes) in SERIES.items():
            for n in sizes:
                found.setdefault((series, n), []).append(in_a_process(series, n))
    return {
        series: [_median(series, n, found[series, n]) for n in sizes]
        for series, (_, sizes) in SERIES.items()
    }


def _median(series: str, n: int, turns: Sequence[dict[str, float]]) -> dict[str, float]:
    middle = {key: statistics.median(turn[key] for turn in turns) for key in turns[0]}
    return middle | {"n": middle["messages"] if series == "messages" else float(n)}


def exponent(x: Sequence[float], y: Sequence[float]) -> float:
    """Of the power that fits best on log axes."""
    a, b = [math.log(v) for v in x], [math.log(v) for v in y]
    mean_a, mean_b = statistics.fmean(a), statistics.fmean(b)
    across = sum((p - mean_a) * (q - mean_b) for p, q in zip(a, b, strict=True))
    return across / sum((p - mean_a) ** 2 for p in a)


def affine(x: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """a and b of a + b x, neither below zero, with least squares of relative errors."""
    # Of ones by 1/y and x/y: two equations.
    u, v = [1 / q for q in y], [p / q for p, q in zip(x, y, strict=True)]
    uu, vv = sum(p * p for p in u), sum(p * p for p in v)
    uv = sum(p * q for p, q in zip(u, v, strict=True))
    su, sv = sum(u), sum(v)
    det = uu * vv - uv * uv
    a, b = (su * vv - sv * uv) / det, (sv * uu - su * uv) / det
    if a < 0:
        return 0.0, sv / vv
    return (su / uu, 0.0) if b < 0 else (a, b)


def main() -> None:
    """Measures, writes the table and draws the picture."""
    sys.path.insert(0, str(PROJECT / "docs" / "commands"))
    from pages import between

    from plotfeed.feeds.accuracy_chart.chart_command import processor

    found = measured()
    when = f"{os.cpu_count()} cores, {processor()}; {datetime.now(UTC):%Y-%m-%d}"
    head = f"CPU of a second of the scene, median of {TURNS} turns; {when}:"
    text = "\n".join([head, "", *table(found)])
    print(text)
    between(PAGE, "scaling", text)
    draw(found)


def table(found: dict[str, list[dict[str, float]]]) -> Iterator[str]:
    """By series: least and most, the exponents at both ends, and where it bends."""
    yield "| | from | to | CPU ms | exponent at the start | at the end | bends at | MiB |"
    yield "|---|--:|--:|--:|--:|--:|--:|--:|"
    for series, points in found.items():
        x, y = [p["n"] for p in points], [p["cpu_s"] for p in points]
        a, b = affine(x, y)
        bend = f"{a / b:,.0f}" if a > 0 and b > 0 else "nowhere"
        yield (
            f"| {series} | {x[0]:,.0f} | {x[-1]:,.0f} | {y[0] * 1e3:.3g} to {y[-1] * 1e3:.3g} "
            f"| {exponent(x[:END], y[:END]):.2f} | {exponent(x[-END:], y[-END:]):.2f} | {bend} "
            f"| {points[0]['mib']:.0f} to {points[-1]['mib']:.0f} |"
        )


def draw(found: dict[str, list[dict[str, float]]]) -> None:
    """Cost above, memory below; a column each for what grows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = {"drones": ["drones, staring", "drones, rotating"]}
    columns |= {name: [name] for name in ("sensors", "sectors", "messages")}
    figure: Any = Figure(figsize=(15, 7.2), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(columns), sharex="col", sharey="row")
    for column, names in enumerate(columns.values()):
        above, below = axes[0][column], axes[1][column]
        for i, name in enumerate(names):
            points, color = found[name], f"C{i}"
            x, y = [p["n"] for p in points], [p["cpu_s"] * 1e3 for p in points]
            a, b = affine(x, y)
            steep = exponent(x[-END:], y[-END:])
            above.plot(x, y, "o", color=color, label=f"{name}: n^{steep:.2f} at the end")
            above.plot(x, [a + b * n for n in x], "-", lw=1, color=color, alpha=0.6)
            if a > 0 and b > 0 and x[0] < a / b < x[-1]:
                above.axvline(a / b, color=color, ls=":", lw=1)
            below.plot(x, [p["mib"] for p in points], "o-", ms=4, lw=1, color=color)
        for panel in (above, below):
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.grid(visible=True, which="major", alpha=0.3)
        above.legend(fontsize=8, loc="upper left")
        below.set_xlabel(SERIES[names[0]][0])
    axes[0][0].set_ylabel("CPU ms a second of the scene")
    axes[1][0].set_ylabel("MiB, the largest size")
    figure.suptitle(
        "Dots: measured. Lines: a + b n. Dotted: where they bend, n = a/b.", fontsize=11
    )
    figure.savefig(PICTURE, metadata={"Software": None})


if __name__ == "__main__":
    if sys.argv[1:2] == ["point"]:
        from plotfeed.feeds.console.process import keep_freed

        keep_freed()
        print(json.dumps(point(sys.argv[2], int(sys.argv[3]))))
    else:
        main()
