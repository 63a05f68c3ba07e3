"""Writes docs/presets.md: every preset with the origin of each of its keys.

python docs/commands/write_presets.py
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pages import table

from plotfeed.feeds.cli.show_sensors import details, shown_reach, shown_value, system_summary, why
from plotfeed.feeds.scene.presets.preset import names, preset, system_names
from plotfeed.feeds.scene.presets.system import system
from plotfeed.feeds.scene.sensors.illuminator_keys import BROADCASTS

BROADCAST_HEAD = """
## Broadcasts as illuminators

A passive radar's transmitters have presets of their own, which give what a scene does not say of
them. They are of kinds, not of anybody's transmitter: powers above all are assumed, for the one
that a scene means has its own. `noise_environment` reaches to 250 MHz: beside a transmitter of
a higher frequency stands `external_noise_db`.

```toml
[[sensor.transmitters]]
id = "hill"
preset = "dab"
erp_w = 4000.0             # what you write goes before what the preset says
place = { east_m = 12000.0, north_m = 0.0, above_site_m = 150.0 }
```
"""
PAGE = Path(__file__).parents[1] / "presets.md"

HEAD = """# Commercial sensors as presets

**These are models of published figures, not measurements of the products.** The figures are those
that section 2 of the paper ("Review and Simulation of Counter-UAS Sensors for Unmanned Traffic
Management") lists of the products, in tables 1 to 13 and beside them. They leave most of a
sensor out, so each key below says where its value comes from:

- **stated**: the source says it; its words are beside it.
- **derived**: a rule gives it, from stated figures or from other keys. Where the rule inverts the
  model ("such that pd = 0.8 at the quoted range"), it is solved when the preset is loaded, so that
  preset and model always agree.
- **assumed**: the model needs it and the source is silent. Keys that are not listed have the
  defaults of [the scene](scene.md), which are assumptions too.

Where no accuracy is published, the errors that no echo removes are the defaults, whose source
[equations](equations.md#errors-that-no-echo-removes) names.

A quoted range is taken as the slant range at which one look detects the target with probability
0.8. Only table 6 says so itself (of Doruk); and where a table names no target, it is taken to be
the paper's small drone, of 0.01 m2 and 80 dB of sound power, 50 m above the sensor; to cameras
it is 0.35 m across.

In a scene, a preset gives all keys that the scene does not:

```toml
[[sensor]]
id = "gate-3"
preset = "echodyne"
azimuth_min_deg = 30.0     # what you write goes before what the preset says
azimuth_max_deg = 150.0
```

A table such as `scan` is replaced as a whole. What was solved for stays as it was solved: a worse
`noise_figure_db` costs range. `plotfeed sensors` prints this list, and `plotfeed sensors NAME` one
preset with its Pd and errors against range.

Written by `python docs/commands/write_presets.py`.
"""


SYSTEMS_HEAD = """
## Systems of several sensors

A table `[[system]]` brings the sensors of a commercial system, each by its preset and named after
the system:

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

Its radar cues its camera ([cues](cues.md)).
A member's `preset` may be another one, such as `ranger-r8ss-3d` for the radar of `dronetracker`.
What is wrong with a sensor of a system is told by the system: `system[0].radar.pfa of 'gate'`.
"""


def page() -> str:
    """All of it."""
    found = [details(preset(name)) for name in names()]
    lines = [HEAD, *_overview(found), *(line for each in found for line in _section(each))]
    lines += [SYSTEMS_HEAD, *_systems()]
    lines += [BROADCAST_HEAD, *_broadcasts()]
    return "\n".join(lines) + "\n"


def _overview(found: list[dict[str, Any]]) -> list[str]:
    rows = [
        (
            f"[{each['name']}](#{each['name']})",
            f"{each['maker']} {each['title']}",
            each["type"],
            shown_reach(each["range_at_pd_80_percent_m"]),
            each["target"],
            each["source"],
        )
        for each in found
    ]
    return table(("preset", "product", "type", "Pd 0.8 to", "for", "source"), rows)


def _section(each: dict[str, Any]) -> list[str]:
    lines = [
        "",
        f"## {each['name']}",
        "",
        f"{each['maker']} {each['title']}, from {each['source']}. Pd is 0.8 to "
        f"{shown_reach(each['range_at_pd_80_percent_m'])} for {each['target']}; "
        f"{each['false_alarms_per_scan']:.2g} false alarms a scan.",
        "",
        f"Target: {each['target_note']}",
        "",
    ]
    lines += _items(
        (k["key"], shown_value(k["value"]), k["mark"], why(k))
        for k in each["keys"]
        if not why(k).startswith("The default.")
    )
    lines += [
        f"\nFor {other['target']}, Pd is 0.8 to {shown_reach(other['range_at_pd_80_percent_m'])}; "
        f"{shown_reach(other['quoted_range_m'])} are quoted. {other['note']}"
        for other in each["other_targets"]
    ]
    if each["left_out"]:
        lines += ["", "Stated and not modelled:", "", *(f"- {text}" for text in each["left_out"])]
    return lines


def _items(keys: Iterable[tuple[str, str, str, str]]) -> list[str]:
    """A line for each reason: of keys that have the same one, or are as another key, together."""
    found: list[tuple[list[str], list[str], str, str]] = []
    for key, value, mark, reason in keys:
        shown, same = f"`{key}` {value}", reason.removeprefix("As ").removesuffix(".")
        for names_, told, its_mark, its_reason in found:
            if mark == its_mark and (reason == its_reason or same in names_):
                names_.append(key)
                told.append(shown)
                break
        else:
            found.append(([key], [shown], mark, reason))
    return [f"- {', '.join(told)} ({mark}): {reason}" for _, told, mark, reason in found]


def _systems() -> list[str]:
    found = [system_summary(system(name)) for name in system_names()]
    rows = [
        (f"`{each['name']}`", f"{each['maker']} {each['title']}", f"`id-{name}`",
         f"[{of['preset']}](#{of['preset']})", of["note"])
        for each in found for name, of in each["sensors"].items()
    ]  # fmt: skip
    lines = table(("system", "product", "sensor", "preset", "why"), rows)
    lines += ["", "Stated and not modelled:", ""]
    return [*lines, *(f"- {e['title']}: {', '.join(e['left_out']).lower()}" for e in found)]


def _broadcasts() -> list[str]:
    lines = []
    for name, kind in BROADCASTS.items():
        keys = ((key, shown_value(value), *kind.notes[key]) for key, value in kind.keys.items())
        lines += ["", f"`{name}`: {kind.title}", "", *_items(keys)]
    return lines


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
