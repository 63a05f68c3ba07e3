"""What `plotfeed sensors` and `plotfeed scenes` print: what comes with plotfeed."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from plotfeed.feeds.cli.check import TestTarget, row_lines, sensor_report
from plotfeed.feeds.console.printed import aligned, say
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.presets.preset import (
    SITE,
    Preset,
    PresetTarget,
    names,
    preset,
    short,
    system_names,
)
from plotfeed.feeds.scene.presets.system import SystemPreset, system
from plotfeed.feeds.scene.scene import example
from plotfeed.feeds.scene.sensors.illuminator_keys import broadcasts

DISCLAIMER = "Models of published figures, not measurements of the products."


def print_presets(name: str | None, *, as_json: bool) -> None:
    """Print one preset or system, or a line on each."""
    found: Any
    if name is None:
        systems = [system_summary(system(each)) for each in system_names()]
        found = [*(summary(preset(each)) for each in names()), *systems]
        lines = _list_lines(found[: -len(systems)], systems)
    elif name in system_names():
        found = system_summary(system(name))
        lines = _system_lines(found)
    else:
        found = details(preset(name))
        lines = detail_lines(found)
    say(json.dumps(found) if as_json else "\n".join(lines))


def print_scenes(*, as_json: bool) -> None:
    """Print a line on each shipped scene, and where its file is."""
    found = [
        {"name": name, "about": about, "file": str(example(name).file(f"{name}.toml"))}
        for name, about in summaries().items()
    ]
    if as_json:
        say(json.dumps(found))
        return
    rows = [[scene["name"], scene["about"]] for scene in found]
    folder = Path(found[0]["file"]).parent
    say("\n".join([*aligned([["name", "about"], *rows], "<"), "", f"Their files are in {folder}."]))


def summary(shown: Preset) -> dict[str, Any]:
    """A preset in short, and how far it sees the target that its source quotes."""
    return {
        "name": shown.name,
        "title": shown.title,
        "maker": shown.maker,
        "type": shown.type,
        "source": shown.source,
        "target": str(shown.target),
        "range_at_pd_80_percent_m": reach_m(shown, shown.target),
    }


def system_summary(shown: SystemPreset) -> dict[str, Any]:
    """A system: the sensors that it brings, each with the preset that stands for it, and why."""
    return {
        "name": shown.name,
        "title": shown.title,
        "maker": shown.maker,
        "type": "system",
        "source": shown.source,
        "sensors": {
            name: {"preset": member.preset, "note": member.note}
            for name, member in shown.members.items()
        },
        "left_out": list(shown.left_out),
    }


def details(shown: Preset) -> dict[str, Any]:
    """All that `summary` says, every key with its mark, and what to expect against range."""
    report = sensor_report(SITE, shown.sensor, _test_target(shown.target))
    return {
        **summary(shown),
        "target_note": shown.target.note,
        "other_targets": [
            {
                "target": str(other),
                "quoted_range_m": other.range_m,
                "range_at_pd_80_percent_m": reach_m(shown, other),
                "note": other.note,
            }
            for other in shown.other_target
        ],
        "left_out": list(shown.left_out),
        "keys": [asdict(marked) for marked in shown.marked_keys()],
        **{name: report[name] for name in ("false_alarms_per_scan", "table", "warnings")},
    }


def reach_m(shown: Preset, target: PresetTarget) -> float | None:
    """The furthest range at which that target's Pd is at least 0.8; None if it is nowhere."""
    sensor = shown.sensor.model_copy(update=target.when)
    found = sensor_report(SITE, sensor, _test_target(target))["range_at_pd_80_percent_m"]
    return None if found is None else float(found)


def shown_value(value: Any) -> str:
    """A key's value as short as it can be read."""
    if isinstance(value, dict):
        return ", ".join(f"{key} {shown_value(part)}" for key, part in value.items())
    if value in (None, "", ()):
        return "-"
    if isinstance(value, list | tuple):
        return ", ".join(map(shown_value, value))
    if isinstance(value, bool):
        return str(value).lower()
    return short(value) if isinstance(value, float) else str(value)


def shown_reach(range_m: float | None) -> str:
    """A range of detection."""
    if range_m is None:
        return "nowhere"
    return f"{range_m:.0f} m" if range_m < 1000 else f"{range_m / 1000:.2f} km"


def _test_target(target: PresetTarget) -> TestTarget:
    return TestTarget(
        signature=target.signature, azimuth_deg=0.0, above_site_m=target.above_sensor_m
    )


def _left_out(found: dict[str, Any]) -> list[str]:
    """What a product's source states and its model leaves out, if anything."""
    told = [f"  {text}" for text in found["left_out"]]
    return ["", "Stated and not modelled:", *told] if told else []


def _system_lines(found: dict[str, Any]) -> list[str]:
    rows = [(f"id-{name}", of["preset"], of["note"]) for name, of in found["sensors"].items()]
    return [
        f"{found['name']}: {found['maker']} {found['title']}, a [[system]], {found['source']}",
        DISCLAIMER,
        "",
        *aligned([("sensor", "preset", "why"), *rows], "<<<"),
        *_left_out(found),
    ]


def _list_lines(found: list[dict[str, Any]], systems: list[dict[str, Any]]) -> list[str]:
    rows: list[tuple[str, ...]] = [("name", "type", "Pd 0.8 to", "for", "product")]
    brought: list[tuple[str, ...]] = [("system", "sensors", "product")]
    for each in (*found, *systems):
        product = f"{each['maker']} {each['title']} ({each['source']})"
        if "sensors" in each:
            members = ", ".join(of["preset"] for of in each["sensors"].values())
            brought.append((each["name"], members, product))
        else:
            reach = shown_reach(each["range_at_pd_80_percent_m"])
            rows.append((each["name"], each["type"], reach, each["target"], product))
    return [
        *aligned(rows, "<<<<"),
        "",
        *aligned(brought, "<<<"),
        "",
        DISCLAIMER,
        "",
        f"Transmitters of a passive radar have presets too: {', '.join(broadcasts())}.",
    ]


def detail_lines(found: dict[str, Any]) -> list[str]:
    """One preset as text."""
    lines = [
        f"{found['name']}: {found['maker']} {found['title']}, {found['type']}, {found['source']}",
        f"For {found['target']}. {found['target_note']}",
        DISCLAIMER,
        "",
    ]
    rows = [(key["key"], shown_value(key["value"]), key["mark"], why(key)) for key in found["keys"]]
    lines += aligned([("key", "value", "mark", "why"), *rows], "<<<")
    for other in found["other_targets"]:
        lines += [
            "",
            f"For {other['target']}: Pd 0.8 to {shown_reach(other['range_at_pd_80_percent_m'])}, "
            f"quoted {shown_reach(other['quoted_range_m'])}. {other['note']}",
        ]
    lines += _left_out(found)
    reach = shown_reach(found["range_at_pd_80_percent_m"])
    alarms = f"{found['false_alarms_per_scan']:.3g} false alarms a scan"
    return [*lines, "", f"Pd 0.8 to {reach}, {alarms}", *row_lines(found, found["name"])]


def why(key: dict[str, Any]) -> str:
    """The rule by which a key was derived, if it was, and its note."""
    return f"{key['rule']}. {key['note']}" if key["rule"] else str(key["note"])
