"""`plotfeed chart`: measures a scene, prints what came of it as a table or as JSON, and draws it.

The table is made from the values that JSON has.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from plotfeed.feeds.accuracy_chart.chart import (
    LITTLE,
    Chart,
    ChartedSensor,
    Configuration,
    charted,
)
from plotfeed.feeds.accuracy_chart.chart_pictures import draw
from plotfeed.feeds.accuracy_chart.stage import Effort, Time, errors_text, ns_text, share_text
from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.printed import finite, say
from plotfeed.feeds.console.process import keep_freed, refuse_if_there
from plotfeed.feeds.scene.scene import Scene

Values = Mapping[str, Any]


def print_chart(
    scene: Scene,
    *,
    out: Path | None,
    picture: str,
    targets: int,
    quick: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Measure and print, as a table or as JSON; with `out`, a folder, draw too.

    Raises `PlotfeedError` where figures are in that folder and nobody says to replace them.
    """
    if out is not None:
        need_extra("matplotlib.figure", "a chart", "charts")
        for path in sorted(out.glob(f"*.{picture}")):
            refuse_if_there(path, force=force)
    keep_freed()  # as a session does
    chart = charted(scene, Effort.quick(targets) if quick else Effort.usual(targets))
    values = as_values(chart)
    drawn = draw(chart, out, picture) if out is not None else []
    if as_json:
        say(json.dumps(values))
        return
    for line in lines(values):
        say(line)
    for path in drawn:
        say(f"drawn: {path}", err=True)


def as_values(chart: Chart) -> dict[str, Any]:
    """A chart for JSON: all that the table has, and the front of whole configurations."""
    return {
        "scene": chart.scene,
        "machine": _machine(),
        "targets": chart.effort.targets,
        "rounds": chart.effort.rounds,
        "sensors": [_sensor_values(sensor) for sensor in chart.sensors],
        "unseen": list(chart.unseen),
    }


def _machine() -> dict[str, Any]:
    """Where the times are from."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "scipy": version("scipy"),
    }


def processor() -> str:
    """What the machine says that it is."""
    cpuinfo = Path("/proc/cpuinfo")
    told = cpuinfo.read_text("utf-8", "replace").splitlines() if cpuinfo.exists() else []
    names = [line.partition(":")[2].strip() for line in told if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _sensor_values(sensor: ChartedSensor) -> dict[str, Any]:
    return {
        "id": sensor.name,
        "type": sensor.type,
        "own": dict(sensor.own),
        "stages": [
            {
                "stage": stage.name,
                "question": stage.question,
                "methods": [
                    {
                        "method": m.method.name,
                        "ns": _time_values(m.time),
                        "errors": dict(m.method.errors),
                        "share": finite(m.share),
                        "ours": m.method.ours,
                        "on_front": i in stage.front,
                    }
                    for i, m in enumerate(stage.methods)
                ],
            }
            for stage in sensor.stages
        ],
        "batches": [{"targets": n, "ns": _time_values(t)} for n, t in sensor.batches.items()],
        "configurations": {
            "scene": _configuration_values(sensor.whole.scene),
            "cheapest": _configuration_values(sensor.whole.cheapest),
            "front": [_configuration_values(c) for c in sensor.whole.front],
            "all": len(sensor.whole.ns),
        },
    }


def _time_values(time: Time) -> dict[str, float]:
    return {"median": time.median_ns, "low": time.low_ns, "high": time.high_ns}


def _configuration_values(found: Configuration | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "methods": dict(found.names),
        "ns": found.ns,
        "errors": dict(found.errors),
        "share": finite(found.share),
    }


def lines(chart: Values) -> Iterator[str]:
    """The whole table."""
    turns = chart["rounds"]
    yield (
        f"{chart['scene']}: {chart['targets']:,} targets at once; "
        f"ns a target-scan, median (middle half) of {turns} turns"
    )
    yield "> what the scene has, * on the front: none is both cheaper and better"
    for sensor in chart["sensors"]:
        yield from _sensor_lines(sensor)
    for name in chart["unseen"]:
        yield f"\n{name}: left out, for it hardly ever detects a drone of the scene"
    yield ""
    yield from (verdict(sensor) for sensor in chart["sensors"])


def verdict(sensor: Values) -> str:
    """The cheapest configuration that adds little, and what it saves."""
    scene, cheapest = (sensor["configurations"][name] for name in ("scene", "cheapest"))
    if cheapest is None:
        return (
            f"{sensor['id']}: no configuration adds less than {LITTLE:g} of the sensor's own error."
        )
    changed = [
        f"{method} in place of {scene['methods'][stage]}"
        for stage, method in cheapest["methods"].items()
        if method != scene["methods"][stage]
    ]
    head = (
        f"{sensor['id']}: the cheapest configuration that adds less than {LITTLE:g} of the "
        f"sensor's own error"
    )
    if not changed:
        return f"{head} is what the scene has, {ns_text(scene['ns'])} ns a target-scan."
    saved = 1 - cheapest["ns"] / scene["ns"]
    much = f"{saved:.0%} less" if saved >= 0 else f"{-saved:.0%} more"
    return (
        f"{head} takes {ns_text(cheapest['ns'])} ns a target-scan, {much} than the scene's "
        f"{ns_text(scene['ns'])}, and adds {share_text(cheapest['share'])} "
        f"(the scene's: {share_text(scene['share'])}): {'; '.join(changed)}."
    )


def _sensor_lines(sensor: Values) -> Iterator[str]:
    own = sensor["own"]
    yield f"\n{sensor['id']} ({sensor['type']}), its own error, rms: {errors_text(own)}"
    yield f"  {'':14}  {'':32}{'ns':>10}  {'':24}{'of its own':>10}  error added"
    for stage in sensor["stages"]:
        for i, method in enumerate(stage["methods"]):
            yield _method_line("" if i else stage["stage"], method)
    costs = "  ".join(f"{b['targets']:,}: {ns_text(b['ns']['median'])}" for b in sensor["batches"])
    yield f"  {'targets at once':14} {costs}"
    for name in ("scene", "cheapest"):
        found = sensor["configurations"][name]
        if found is not None:
            yield (
                f"  {name:14}  {'all stages together':32}{ns_text(found['ns']):>10}  {'':24}"
                f"{share_text(found['share']):>10}  {errors_text(found['errors'])}"
            )


def _method_line(stage: str, method: Values) -> str:
    mark = f"{'>' if method['ours'] else ' '}{'*' if method['on_front'] else ' '}"
    ns = method["ns"]
    spread = f"({ns_text(ns['low'])} to {ns_text(ns['high'])})"
    return (
        f"  {stage:14}{mark}{method['method']:32}{ns_text(ns['median']):>10}  {spread:24}"
        f"{share_text(method['share']):>10}  {errors_text(method['errors'])}"
    )
