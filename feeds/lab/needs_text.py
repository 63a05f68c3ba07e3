"""`plotfeed needs` and `plotfeed chart`: what was found of a scene, in words, pictures and TOML."""

from __future__ import annotations

import json
import os
import platform
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.printed import finite, say
from plotfeed.feeds.console.process import keep_freed, refuse_if_there
from plotfeed.feeds.lab.lab_settings import ChartSettings, NeedsSettings
from plotfeed.feeds.lab.needs import (
    SENSOR_EFFECTS,
    Change,
    Finding,
    Needs,
    choices_of,
    needs_of,
    on_front,
    variants_of,
)
from plotfeed.feeds.lab.pictures import INK, QUIET, Label, figure_of, place_labels, save_picture
from plotfeed.feeds.lab.tables import Table, of_cells
from plotfeed.feeds.scene.scene import Scene, parsed
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

GROUPS = {
    "needed": "Needed: without it, a tracker would notice",
    "can go": "Can go: without it, a tracker would notice nothing",
    "missing": "Missing: with it, a tracker would notice",
    "no need": "No need: with it, a tracker would notice nothing",
    "undecided": "Undecided: more runs, or longer ones, would tell",
}
# Figures by what they are called in words, and their units.
WORDS = {
    "pd": ("share of scans in which a drone in range is plotted", ""),
    "range_m": ("range error, rms", " m"),
    "azimuth_deg": ("azimuth error, rms", "°"),
    "elevation_deg": ("elevation error, rms", "°"),
    "alarms": ("false plots a scan", ""),
    "gospa_m": ("GOSPA of a plain tracker", " m"),
    "completeness": ("share of drones that a plain tracker follows", ""),
    "delay_s": ("delay", " s"),
    "lost": ("share of messages lost", ""),
}
SEED = 1
# Where the scene does not say when it begins.
START_UTC_NS = 1_767_268_800 * NS


def print_needs(scene: Scene, settings: NeedsSettings) -> None:
    """Say what a scene needs and what it can leave out; raises `PlotfeedError`."""
    matters = _share(settings.matters)
    _check_files(settings, settings.lean, settings.full)
    found = _found(scene, variants_of(scene), settings, matters)
    written = []
    for path, verdict in ((settings.lean, "can go"), (settings.full, "missing")):
        if path is not None:
            path.write_text(rewritten(scene, found, verdict), encoding="utf-8")
            written.append(path)
    _tell(found, settings, [*_lines(found), *_sensor_lines(found)], written)


def print_chart(scene: Scene, settings: ChartSettings) -> None:
    """Chart the choices that a scene has, accuracy against speed; raises `PlotfeedError`."""
    _check_files(settings)
    variants = [*choices_of(scene), *(each for each in variants_of(scene) if not each.adds)]
    found = _found(scene, variants, settings, 0.02)
    _tell(found, settings, list(_choice_lines(found)), [])


def _check_files(settings: ChartSettings, *others: Path | None) -> None:
    if settings.chart is not None:
        need_extra("matplotlib.figure", "a picture", "charts")
    for path in (settings.chart, *others):
        if path is not None:
            refuse_if_there(path, force=settings.force)


def _found(scene: Scene, variants: Sequence[Any], settings: ChartSettings, matters: float) -> Needs:
    keep_freed()  # as a session does
    began_s = time.monotonic()

    def progress(done: int, most: int, undecided: int) -> None:
        took_s = time.monotonic() - began_s
        line = f"{done} of {most} runs at most, {undecided} undecided, {took_s:.0f} s"
        say(line, err=True)

    return needs_of(
        scene,
        variants,
        matters=matters,
        runs=settings.runs,
        duration_s=settings.duration,
        seed=SEED,
        start_utc_ns=scene.scene.start_utc_ns or START_UTC_NS,
        progress=progress,
    )


def _share(text: str) -> float:
    """A share such as 2% or 0.02."""
    plain, percent = text.removesuffix("%"), text.endswith("%")
    try:
        share = float(plain) / (100 if percent else 1)
    except ValueError:
        share = np.nan
    if not 0 < share < 1:
        raise PlotfeedError(f"--matters: expected a share such as 2% or 0.02, not {text!r}")
    return share


def _tell(
    found: Needs, settings: ChartSettings, lines: Sequence[str], written: Sequence[Path]
) -> None:
    if settings.chart is not None:
        draw(found, settings.chart)
        written = [*written, settings.chart]
    if settings.as_json:
        say(json.dumps(finite({**as_values(found), "files": list(map(str, written))})))
        return
    for line in (*lines, *(f"written: {path}" for path in written)):
        say(line)


def as_values(found: Needs) -> dict[str, Any]:
    """Findings for JSON."""
    return {
        "scene": found.scene,
        "machine": {  # Where the times are from
            "processor": processor(),
            "cores": os.cpu_count(),
            "system": platform.system(),
            "python": platform.python_version(),
            "numpy": version("numpy"),
        },
        "matters": found.matters,
        "duration_s": found.duration_s,
        "runs": found.runs,
        "runs_needed": found.runs_needed,
        "processor_s_per_s": found.cost_s,
        "as_it_is": {name: dict(figures) for name, figures in found.as_it_is.items()},
        "findings": [
            {
                "variant": each.variant.name,
                "effects": list(each.variant.effects),
                "verdict": each.verdict,
                "processor": dict(zip(("ratio", "low", "high"), each.cost, strict=True)),
                "changes": [change._asdict() for change in each.changes],
            }
            for each in found.findings
        ],
        "cover": {
            name: {"with": one, "without": other} for name, (one, other) in found.covers.items()
        },
    }


def processor() -> str:
    """What the machine says that it is."""
    cpuinfo = Path("/proc/cpuinfo")
    told = cpuinfo.read_text("utf-8", "replace").splitlines() if cpuinfo.exists() else []
    names = [line.partition(":")[2].strip() for line in told if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _head(found: Needs) -> str:
    return (
        f"{found.scene}: {found.runs} runs of {found.duration_s:g} s, each variant with the seeds "
        f"of the scene as it is; a change of {found.matters:.3g} matters"
    )


def _lines(found: Needs) -> Iterator[str]:
    """The groups, each with its largest changes first."""
    yield _head(found)
    for verdict, title in GROUPS.items():
        rows = [
            (each.variant.name, change_text(each.largest), cost_text(each))
            for each in sorted(found.findings, key=_size, reverse=True)
            if each.verdict == verdict
        ]
        if rows:
            heads = ("", "what changes most (interval of 95 %)", "processor time")
            yield from Table(title, of_cells(heads, "<<<"), rows).lines()


def _size(found: Finding) -> float:
    return abs(found.largest.share) if found.largest else 0.0


def change_text(change: Change | None) -> str:
    """A change in words, with its interval."""
    if change is None:
        return "nothing that could be compared"
    if not change.value and change.low == change.high:
        return "nothing at all"
    what, unit = WORDS.get(change.metric, (change.metric, ""))
    after = change.before + change.value
    return (
        f"{change.sensor}: {what} {change.before:.3g}{unit} becomes {after:.3g}{unit}, "
        f"{change.share:+.1%} ({change.share_low:+.1%} to {change.share_high:+.1%})"
    )


def cost_text(found: Finding) -> str:
    """How much more processor time a variant takes, with its interval."""
    value, low, high = found.cost
    return f"{value - 1:+.0%} ({low - 1:+.0%} to {high - 1:+.0%})"


def _sensor_lines(found: Needs) -> Iterator[str]:
    """What is lost without each sensor, and how many runs a verdict takes."""
    rows = [
        (name, f"{one:.1%}", f"{other:.1%}", f"{other - one:+.1%}")
        for name, (one, other) in found.covers.items()
    ]
    heads = ("without the sensor", "seen by any sensor before", "after", "change")
    title = "Sensors: the share of stretches of 5 s in which a drone is plotted"
    yield from Table(title, of_cells(heads, "<>>>"), rows).lines()
    yield ""
    yield (
        f"A second of the scene takes {1e3 * found.cost_s:.3g} ms of processor. All of this would "
        f"be decided by some {found.runs_needed:,} runs of {found.duration_s:g} s."
    )


def _choice_lines(found: Needs) -> Iterator[str]:
    """All choices, the cheapest first; the front is marked."""
    yield _head(found)
    front = {found.findings[i].variant.name for i in _front(found)}
    rows = [
        (
            "*" if each.variant.name in front else "",
            each.variant.name,
            cost_text(each),
            change_text(each.largest),
        )
        for each in sorted(found.findings, key=lambda each: each.cost[0])
    ]
    heads = ("", "the scene", "processor time", "what changes most (interval of 95 %)")
    title = "Choices; * is on the front: none is both cheaper and nearer to the scene as it is"
    yield from Table(title, of_cells(heads, "<<<<"), rows).lines()
    yield ""
    yield f"As it is, a second of the scene takes {1e3 * found.cost_s:.3g} ms of processor."


def _front(found: Needs) -> list[int]:
    costs = np.array([each.cost[0] for each in found.findings])
    rows: list[int] = on_front(costs, np.array(list(map(_size, found.findings)))).tolist()
    return rows


def draw(found: Needs, path: Path) -> None:
    """Draw what each variant changes against what it costs, with intervals, and the front."""
    colours = {"needed": "#c2410c", "missing": "#1d4ed8", "undecided": QUIET}
    title = f"What it changes against what it costs: scene {found.scene}"
    with figure_of((9.0, 6.0), title) as figure:
        axes, labels = figure.subplots(), []
        for each in found.findings:
            change, (x, low, high) = each.largest, each.cost
            if change is None:
                continue
            y = max(abs(change.share), 1e-4)
            half = (change.share_high - change.share_low) / 2
            spans = [[max(x - low, 0)], [max(high - x, 0)]], [[min(half, y * 0.9)], [half]]
            x_span, y_span = (np.nan_to_num(s, posinf=0.0) for s in spans)
            axes.errorbar([x], [y], xerr=x_span, yerr=y_span, color=QUIET, lw=0.8, zorder=1)
            axes.scatter([x], [y], s=36, color=colours.get(each.verdict, "#15803d"), zorder=3)
            labels.append(Label(x=x, y=y, text=each.variant.name, color=INK))
        rows = [i for i in _front(found) if found.findings[i].largest is not None]
        steps = (
            [found.findings[i].cost[0] for i in rows],
            [max(_size(found.findings[i]), 1e-4) for i in rows],
        )
        axes.step(*steps, where="post", color="#1d4ed8", lw=1, alpha=0.6)
        axes.axhline(found.matters, color="#15803d", ls="--", lw=1)
        axes.set_yscale("log")
        axes.set_xlabel("processor time, times that of the scene as it is")
        axes.set_ylabel("largest change of what a tracker sees, as a share")
        axes.grid(visible=True, alpha=0.3)
        axes.margins(x=0.15)
        place_labels(figure, [(axes, labels)])
        save_picture(figure, path)


def rewritten(scene: Scene, found: Needs, verdict: str) -> str:
    """The scene's text without what can go, or with what is missing; raises `PlotfeedError`.

    What goes stays as a comment, below one that says what that changes.
    """
    if not scene.text:
        raise PlotfeedError("the scene has no text of its own, which could be written otherwise")
    text = scene.text
    for each in found.findings:
        if each.verdict != verdict or len(each.variant.effects) != 1:
            continue
        (effect,) = each.variant.effects
        why = f"{each.variant.name}: {change_text(each.largest)}"
        if verdict == "missing":
            text = _added(text, each, effect, why)
        else:
            owners = None if effect.startswith("[") else each.variant.sensors
            text = _commented_out(text, effect.strip("[]"), owners, why)
    parsed(text.encode(), scene.folder / "scene.toml")  # what does not load is not written
    return text


def _commented_out(text: str, key: str, owners: frozenset[int] | None, why: str) -> str:
    """The text with a key or table as comments: of the scene, or of sensors by their numbers."""
    lines, number, table, depth, inside = [], -1, "", 0, False
    name = re.escape(key)
    header = rf"\[+{name}[\].]" if owners is None else rf"\[+sensor\.{name}[\].]"
    for line in text.splitlines():
        plain = line.strip()
        if depth == 0 and plain.startswith("["):
            table = plain
            number += plain.startswith("[[sensor]]")
            inside = bool(re.match(header, plain)) and (owners is None or number in owners)
            if inside:
                lines.append(f"# {why}")
        elif depth == 0 and plain.startswith("#"):
            inside = False
        begins = (
            owners is not None
            and number in owners
            and table.startswith("[[sensor]]")
            and re.match(rf"{name}[\s.=]", plain)
        )
        if begins and depth == 0:
            lines.append(f"# {why}")
        goes = inside or depth > 0 or bool(begins)
        if goes and (begins or depth > 0):
            depth += sum(map(plain.count, "[{")) - sum(map(plain.count, "]}"))
        lines.append(f"# {line}" if goes and plain else line)
    return "\n".join(lines) + "\n"


def _added(text: str, found: Finding, effect: str, why: str) -> str:
    """The text with a key of sensors that it did not name."""
    on = next(each.on for each in SENSOR_EFFECTS if each.name == effect)
    lines, number = [], -1
    for line in text.splitlines():
        lines.append(line)
        if line.strip().startswith("[[sensor]]"):
            number += 1
            if number in found.variant.sensors:
                value = getattr(found.variant.scene.sensor[number], effect)
                told = value.model_dump(exclude_unset=True) if hasattr(value, "model_dump") else on
                lines += [f"# {why}", f"{effect} = {_toml(told)}"]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    """A value as TOML writes it inline."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_toml(each)}" for key, each in value.items()) + " }"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)
