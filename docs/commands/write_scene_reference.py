"""Writes docs/scene.md: every key of the scene file, from the JSON schema that checks it.

python docs/commands/write_scene_reference.py
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from plotfeed.feeds.schema import text_of

PAGE = Path(__file__).parents[1] / "scene.md"
INTRODUCTION = """# The scene file

Written by `python docs/commands/write_scene_reference.py` from the schema that plotfeed checks
scenes by; `plotfeed schema >scene.schema.json` beside a scene lets editors complete and check it.

A scene is one TOML file. It names a site, the sensors that look, and the drones that the scene
flies by itself; others may come by telemetry. Only what it names is modelled. A key that does not
exist, a value of the wrong kind or out of bounds is refused before anything starts, each with the
line of the file and the sensor or drone whose key it is:

    here.toml: line 12: sensor[0].powr_w of 'radar': no such key; did you mean power_w?

The unit of a key is the end of its name: `_m` metres, `_deg` degrees, `_db` decibels, `_utc` a date
and time with its zone, and so on. Keys in **bold** are needed; `key = value` is what counts where a
scene does not name the key; in brackets is what it may be. A key that several tables have is
described once, where it comes first.

`plotfeed check SCENE` says what the sensors will do; scenes to start from are in
[examples](../examples/README.md), the one of the demo in `feeds/scene/examples/`.
"""
WORTH_A_SECTION = 5
TYPES = {"number": "", "integer": "whole", "boolean": "true or false",
         "string": "text", "array": "list", "object": "table", "null": "none"}  # fmt: skip
# Said here of keys whose own description is empty.
NOT_DESCRIBED = {
    "name": "Of the scene, for people.",
    "site": "The point from which the scene counts.",
    "max_drones": "More drones than this are refused.",
    "id": "A level of its topics, so without `/`, `+`, `#` or space.",
    "sac": "System area code of its ASTERIX.",
    "rcs_m2": "Radar cross-section, the mean of a fluctuating one.",
    "path": "Where it flies; or else `flight`.",
    "flight": "A file that it flies by; or else `path`.",
    "speed_m_s": "Along the path.",
    "client_certificate_file": "PEM; shown to a broker that asks for one.",
    "client_key_file": "PEM; of that certificate.",
    "bandwidth_hz": "Of the emission; 0 is a carrier.",
    "eirp_dbm": "What it radiates, over an isotropic antenna.",
    "takeoff_height_m": "As under [telemetry], for this flight alone.",
}
Schema = dict[str, Any]


class Reference:
    """The page, section by section, each table of the file once."""

    def __init__(self, schema: Schema) -> None:
        self._definitions: dict[str, Schema] = schema.get("$defs", {})
        self._done: set[str] = set()
        self._first: dict[tuple[str, str, str], tuple[str, str]] = {}
        self.silent: list[str] = []  # Keys of which nobody says what they are
        self.parts: list[str] = []
        self.titles: list[str] = []
        for key, value in schema["properties"].items():
            self._table(key, value)

    def _table(self, place: str, schema: Schema, owner: str = "") -> None:
        """A section for each table that may stand at a place of what is of such a kind."""
        brackets = f"`[[{place}]]`" if schema.get("type") == "array" else f"`[{place}]`"
        names = [name for name in self._names(schema) if "properties" in self._definitions[name]]
        tables = [self._definitions[name] for name in names if name not in self._done]
        self._done.update(names)
        common = _common(tables)
        if common:
            title = f"{brackets} of every {_kind(tables[0])[0]}"
            told = f"Keys that all of them have, {_listed(tables)}; their own follow."
            of_all = {"description": told, "properties": common, "required": tables[0]["required"]}
            self._section(title, of_all, place)
        for table in tables:
            key, kind = _kind(table)
            title = f"{brackets} of {key} `{kind}`" if kind else brackets
            if title in self.titles:
                title += f" of `{owner}`"
            told = table.get("description", "")
            if common:
                told += f" It has the keys [of every {key}](#sensor-of-every-{key}), and these."
            own = {name: v for name, v in table["properties"].items() if name not in common}
            of_one = {**table, "description": told, "properties": own}
            self._section(title, of_one, place, kind or owner)

    def _section(self, title: str, table: Schema, place: str, owner: str = "") -> None:
        """One table's keys, and the sections of what stands within it."""
        lines = [f"## {title}", "", _line(table.get("description", "")), ""]
        needed = table.get("required", [])
        elsewhere: dict[str, list[str]] = {}
        for key, value in table["properties"].items():
            what = _line(value.get("description") or NOT_DESCRIBED.get(key, ""))
            if not what:
                self.silent.append(f"{place}.{key}")
            default, values = _default(value), self._values(value)
            if default and values in ("true or false", "text"):
                values = ""
            name = f"**`{key}`**" if key in needed else f"`{key}{default and f' = {default}'}`"
            first, named = self._first.setdefault((key, what, values), (title, name))
            if first == title:
                lines.append(f"- {name}{values and f' ({values})'}: {what}")
            else:
                elsewhere.setdefault(first, []).append(f"`{key}`" if name == named else name)
        for first, keys in elsewhere.items():
            lines.append(f"- As in [{first}](#{_anchor(first)}): {', '.join(keys)}.")
        self.titles.append(title)
        self.parts.append("\n".join(lines) + "\n")
        for key, value in table["properties"].items():
            if self._names(value):
                self._table(f"{place}.{key}", value, owner)

    def _values(self, schema: Schema) -> str:
        """What may stand there."""
        if words := schema.get("enum", [schema["const"]] if "const" in schema else []):
            return ", ".join(f"`{json.dumps(word)}`" for word in words)
        if "$ref" in schema:
            name = schema["$ref"].rpartition("/")[2]
            inner = self._definitions[name]
            return "table" if "properties" in inner else self._values(inner)
        for several in ("anyOf", "oneOf"):
            if several in schema:
                told = [self._values(s) for s in schema[several] if s.get("type") != "null"]
                return " or ".join(filter(None, dict.fromkeys(told)))
        if schema.get("type") == "array":
            return self._list(schema)
        if schema.get("format") == "date-time":
            return ""
        return " ".join(filter(None, (TYPES[schema.get("type", "object")], _bounds(schema))))

    def _list(self, schema: Schema) -> str:
        if "prefixItems" in schema:
            return f"list of {len(schema['prefixItems'])} numbers"
        inner = self._values(schema.get("items", {}))
        return "tables" if inner.startswith("table") else f"list of {inner or 'numbers'}"

    def _names(self, schema: Schema) -> list[str]:
        """The definitions that a value may be of."""
        found = [schema["$ref"].rpartition("/")[2]] if "$ref" in schema else []
        for inner in (*schema.get("anyOf", ()), *schema.get("oneOf", ()), schema.get("items")):
            if inner:
                found += self._names(inner)
        return found


def _common(tables: list[Schema]) -> Schema:
    """Keys that several tables have alike, if those are worth a section of their own."""
    first, *others = [table["properties"] for table in tables] or [{}]
    alike = {k: v for k, v in first.items() if all(other.get(k) == v for other in others)}
    return alike if others and len(alike) >= WORTH_A_SECTION else {}


def _listed(tables: list[Schema]) -> str:
    """The tables of a kind, by links to their sections."""
    kinds = [_kind(table) for table in tables]
    return ", ".join(f"[{kind}](#sensor-of-{key}-{kind})" for key, kind in kinds)


def _contents(titles: list[str]) -> str:
    """A list of the sections, those of a table within it further in."""
    lines = ["## Contents", ""]
    for title in titles:
        depth = title.split("`")[1].count(".")
        lines.append(f"{'    ' * depth}- [{title}](#{_anchor(title)})")
    return "\n".join(lines) + "\n"


def _kind(table: Schema) -> tuple[str, str]:
    """The key that says which of several tables this is, and its value; both empty of one alone."""
    found = [(key, v["const"]) for key, v in table["properties"].items() if "const" in v]
    return found[0] if found else ("", "")


def _bounds(schema: Schema) -> str:
    low = _number(schema["minimum"]) if "minimum" in schema else ""
    if "exclusiveMinimum" in schema:
        low = f"above {_number(schema['exclusiveMinimum'])}"
    high = _number(schema["maximum"]) if "maximum" in schema else ""
    if "exclusiveMaximum" in schema:
        high = f"below {_number(schema['exclusiveMaximum'])}"
    if low and high:
        return f"±{high}" if low == f"-{high}" else f"{low} to {high}"
    return low and f"{low} or more" if not low.startswith("above") else low or high


def _number(value: float) -> str:
    if value == 1 << 63:
        return "2^63"
    plain = 1e-4 < abs(value) < 1e7 and value == round(value)
    return f"{value:,.0f}" if plain else f"{value:g}"


def _default(schema: Schema) -> str:
    if "default" not in schema or isinstance(schema["default"], dict):
        return ""
    value = schema["default"]
    if value in (None, [], ""):
        return ""
    return f"{value:g}" if isinstance(value, float) else json.dumps(value)


def _anchor(title: str) -> str:
    return re.sub(r"[^\w\s-]", "", title).lower().replace(" ", "-")


def _line(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("|", "\\|").strip()


def page() -> str:
    """The whole page."""
    reference = Reference(json.loads(text_of("scene")))
    if reference.silent:
        raise SystemExit(f"keys without a description: {', '.join(reference.silent)}")
    return "\n".join([INTRODUCTION, _contents(reference.titles), *reference.parts])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
