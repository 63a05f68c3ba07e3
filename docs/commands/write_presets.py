"""Writes docs/presets.md: every preset with the origin of each of its keys.

python docs/commands/write_presets.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pages import table

from plotfeed.feeds.cli.show_sensors import details, shown_reach, shown_value, system_summary, why
from plotfeed.feeds.scene.presets.preset import names, preset, system_names
from plotfeed.feeds.scene.presets.system import system
from plotfeed.feeds.scene.sensors.illuminator_keys import OF_A_KIND, broadcasts

BROADCAST_HEAD = """
## Broadcasts as illuminators

A passive radar's transmitters have presets of kinds; their powers above all are assumed.
`noise_environment` reaches to 250 MHz; above stands `external_noise_db`.

```toml
[[sensor.transmitters]]
id = "hill"
preset = "dab"
erp_w = 4000.0             # what you write goes before what the preset says
place = { east_m = 12000.0, north_m = 0.0, above_site_m = 150.0 }
```
"""
PAGE = Path(__file__).parents[1] / "presets.md"

FILES = "../feeds/scene/presets"
HEAD = f"""# Commercial sensors as presets

Written by `python docs/commands/write_presets.py`.

**These are models of published figures, not measurements of the products.** The figures are those
of section 2 of the paper ("Review and Simulation of Counter-UAS Sensors for Unmanned Traffic
Management"). They leave most of a sensor out, so each key is one of three:

- **stated**: the source says it.
- **derived**: a rule gives it, from stated figures or from other keys. What is such that Pd is 0.8
  at the quoted range is solved when the preset is loaded, so that preset and model always agree.
- **assumed**: the model needs it and the source is silent. Keys that are not listed have the
  defaults of [the scene](scene.md), which are assumptions too.

Why a key has its value, with the source's words, stand in [the preset's file]({FILES}) and in what
`plotfeed sensors NAME` prints, with Pd and errors against range.

A quoted range is taken as the slant range at which one look detects the target with probability
0.8. Only table 6 says so itself (of Doruk); where a table names no target, it is the paper's small
drone, 50 m above the sensor: 0.01 m2, 80 dB of sound power, 0.35 m across.

In a scene, a preset gives all keys that the scene does not. A table such as `scan` is replaced as a
whole. What was solved for stays as it was solved: a worse `noise_figure_db` costs range.

```toml
[[sensor]]
id = "gate-3"
preset = "echodyne"
azimuth_min_deg = 30.0     # what you write goes before what the preset says
azimuth_max_deg = 150.0
```
"""


SYSTEMS_HEAD = """
## Systems of several sensors

A `[[system]]` brings the sensors of a commercial system, each by its preset and named after it:

```toml
[[system]]
id = "gate"
preset = "dronesentry"          # gate-radar, gate-rf, gate-audio and gate-camera
position_enu_m = [120.0, -40.0, 6.0]
facing_deg = 90.0               # what looks one way looks east
without = ["audio"]
every = { report = ["asterix-015", "plots", "sapient"] }

[system.radar]                  # in place of what its preset says
pfa = 1e-6
```

Its radar cues its camera ([cues](cues.md)). A member may have another `preset`.
"""


def page() -> str:
    """All of it."""
    found = [details(preset(name)) for name in names()]
    lines = [HEAD, *_overview(found), "", "## Keys", "", *_keys(found)]
    lines += [SYSTEMS_HEAD, *_systems()]
    lines += [BROADCAST_HEAD, *_broadcasts()]
    return "\n".join(lines) + "\n"


def _overview(found: list[dict[str, Any]]) -> list[str]:
    rows = []
    for each in found:
        reach = f"{shown_reach(each['range_at_pd_80_percent_m'])} for {each['target']}"
        for other in each["other_targets"]:
            reach += f", {shown_reach(other['range_at_pd_80_percent_m'])} for {other['target']}"
            reach += f" (quoted {shown_reach(other['quoted_range_m'])})"
        product = f"{each['maker']} {each['title']}"
        source = each["source"].removesuffix(" of the paper")
        rows.append((f"`{each['name']}`", product, each["type"], reach, source))
    return table(("preset", "product", "type", "Pd 0.8 to", "source"), rows)


def _keys(found: list[dict[str, Any]]) -> list[str]:
    """A row a preset: its keys by where they come from, and what it leaves out."""
    rows = []
    for each in found:
        by_mark: dict[str, list[str]] = {"stated": [], "derived": [], "assumed": []}
        for key in each["keys"]:
            if not why(key).startswith("The default."):
                by_mark[key["mark"]].append(f"`{key['key']}` {shown_value(key['value'])}")
        name = f"[{each['name']}]({FILES}/{each['name']}.toml)"
        rows.append((name, *map(", ".join, by_mark.values()), "; ".join(each["left_out"])))
    return table(("preset", "stated", "derived", "assumed", "stated and not modelled"), rows)


def _systems() -> list[str]:
    rows = [
        (
            f"[{each['name']}]({FILES}/systems/{each['name']}.toml)",
            f"{each['maker']} {each['title']}",
            ", ".join(f"`{name}` {of['preset']}" for name, of in each["sensors"].items()),
            ", ".join(each["left_out"]),
        )
        for each in (system_summary(system(name)) for name in system_names())
    ]
    return table(("system", "product", "sensors", "stated and not modelled"), rows)


def _broadcasts() -> list[str]:
    lines = []
    for name, kind in broadcasts().items():
        lines += ["", f"`{name}`: {kind['title']}", ""]
        for key in OF_A_KIND:
            of = kind[key]
            lines.append(f"- `{key}` {shown_value(of['value'])} ({of['mark']}): {of['note']}")
    return lines


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
