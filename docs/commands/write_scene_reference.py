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
and time with its zone, and so on. Keys in **bold** are needed; behind a key stands what counts
where a scene does not name it, and in brackets which words it may be; the schema has the bounds of
numbers. A key that several tables have is described once, where it comes first. A table within a
table follows it, under a heading of its own.

`plotfeed check SCENE` says what the sensors will do; scenes to start from are in
[examples](../examples/README.md), the one of the demo in `feeds/scene/examples/`.
"""
WORTH_A_SECTION = 5
# What a key says of its table stands before what the table says if it tells what its absence means,
# or is so short that it only tells whose the table is.
A_FEW_WORDS = 6
# The keys of a place, which are told of once.
PLACE = (
    "east_m",
    "north_m",
    "above_site_m",
    "latitude_deg",
    "longitude_deg",
    "height_m",
    "height_msl_m",
)
PLACES = "From the site in metres, or by latitude, longitude and one of the heights."
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
        for table in self._definitions.values():
            for shared in table.get("allOf", ()):
                keys = self._definitions[_name(shared)]["properties"]
                table["properties"] = {**keys, **table["properties"]}
        self._done: set[str] = set()
        self._first: dict[tuple[str, str, str], tuple[str, str]] = {}
        self.silent: list[str] = []  # Keys of which nobody says what they are
        self.parts: list[str] = []
        self.titles: list[str] = []
        location = self._definitions["Location"]
        self._section("A place", {**location, "description": PLACES}, "place")
        for key, value in schema["properties"].items():
            self._table(key, value)

    def _table(self, place: str, schema: Schema, owner: str = "", told_above: str = "") -> None:
        """A section for each table that may stand at a place of what is of such a kind.

        `told_above` is what the key of the table says, which the first of them begins with.
        """
        brackets = f"`[[{place}]]`" if schema.get("type") == "array" else f"`[{place}]`"
        names = [name for name in self._names(schema) if self._is_table(name)]
        tables = [self._definitions[name] for name in names if name not in self._done]
        self._done.update(names)
        common = _common(tables)
        if common:
            title = f"{brackets} of every {_kind(tables[0])[0]}"
            told = "Keys that all of them have; their own follow."
            of_all = {"description": told, "properties": common, "required": tables[0]["required"]}
            self._section(title, of_all, place)
            told_above = ""
        for table in tables:
            key, kind = _kind(table)
            title = f"{brackets} of {key} `{kind}`" if kind else brackets
            if title in self.titles:
                title += f" of `{owner}`"
            told = table.get("description", "")
            if "ithout" in told_above or len(told_above.split()) < A_FEW_WORDS:
                told = f"{told_above} {told}"
            told_above = ""
            own = {name: v for name, v in table["properties"].items() if name not in common}
            of_one = {**table, "description": told, "properties": own}
            self._section(title, of_one, place, kind or owner)

    def _section(self, title: str, table: Schema, place: str, owner: str = "") -> None:
        """One table's keys, and the sections of what stands within it."""
        lines = [f"## {title}", "", _line(table.get("description", "")), ""]
        needed = table.get("required", [])
        here: dict[str, list[str]] = {}
        elsewhere: dict[str, list[str]] = {}
        has_place = title != "A place" and table["properties"].keys() >= {*PLACE}
        if has_place:
            lines.append("- [A place](#a-place).")
        below = {}
        for key, value in table["properties"].items():
            if "const" in value or (has_place and key in PLACE):
                continue
            what = _line(value.get("description") or NOT_DESCRIBED.get(key, ""))
            if not what:
                self.silent.append(f"{place}.{key}")
            default, values = _default(value), self._values(value)
            name = f"**`{key}`**" if key in needed else f"`{key}`{default and f' {default}'}"
            tables = [name for name in self._names(value) if self._is_table(name)]
            first, named = self._first.setdefault((key, what, values), (title, name))
            if first == title and not self._done.issuperset(tables):
                below[key] = what
            elif first == title:
                here.setdefault(f"{values and f' ({values})'}: {what}", []).append(name)
            else:
                elsewhere.setdefault(first, []).append(f"`{key}`" if name == named else name)
        lines += [f"- {', '.join(keys)}{what}" for what, keys in here.items()]
        for first, keys in elsewhere.items():
            lines.append(f"- As in {_link(first)}: {', '.join(keys)}.")
        if below:
            lines.append(f"- Below: {', '.join(f'`{key}`' for key in below)}.")
        self.titles.append(title)
        self.parts.append("\n".join(lines) + "\n")
        for key, value in table["properties"].items():
            if self._names(value):
                self._table(f"{place}.{key}", value, owner, below.get(key, ""))

    def _values(self, schema: Schema) -> str:
        """What may stand there."""
        if words := schema.get("enum", [schema["const"]] if "const" in schema else []):
            return ", ".join(f"`{json.dumps(word)}`" for word in words)
        if "$ref" in schema:
            name = _name(schema)
            inner = self._definitions[name]
            return "" if "properties" in inner else self._values(inner)
        for several in ("anyOf", "oneOf"):
            if several in schema:
                told = [self._values(s) for s in schema[several] if s.get("type") != "null"]
                return " or ".join(filter(None, dict.fromkeys(told)))
        if schema.get("type") == "array":
            return self._list(schema)
        return ""

    def _list(self, schema: Schema) -> str:
        if "prefixItems" in schema:
            return f"{len(schema['prefixItems'])} numbers"
        inner = schema.get("items", {})
        if "$ref" in inner and self._is_table(_name(inner)):
            return ""
        return " ".join(filter(None, ("list", self._values(inner))))

    def _is_table(self, name: str) -> bool:
        """Whether a definition has keys."""
        return "properties" in self._definitions[name]

    def _names(self, schema: Schema) -> list[str]:
        """The definitions that a value may be of."""
        found = [_name(schema)] if "$ref" in schema else []
        for inner in (*schema.get("anyOf", ()), *schema.get("oneOf", ()), schema.get("items")):
            if inner:
                found += self._names(inner)
        return found


def _name(schema: Schema) -> str:
    """The definition that a schema refers to."""
    return str(schema["$ref"].rpartition("/")[2])


def _common(tables: list[Schema]) -> Schema:
    """Keys that several tables have alike, if those are worth a section of their own."""
    first, *others = [table["properties"] for table in tables] or [{}]
    alike = {k: v for k, v in first.items() if all(other.get(k) == v for other in others)}
    return alike if others and len(alike) >= WORTH_A_SECTION else {}


def _contents(titles: list[str]) -> str:
    """Links to the sections of the file's own tables."""
    return f"{', '.join(_link(title) for title in titles if '.' not in title)}\n"


def _link(title: str) -> str:
    """A link to a section, by the kind of table where there are several."""
    name, _, kind = title.partition(" of every ")[0].rpartition(" of ")
    name = kind.split(" ")[-1] if name else kind
    return f"[{name}](#{_anchor(title)})"


def _kind(table: Schema) -> tuple[str, str]:
    """The key that says which of several tables this is, and its value; both empty of one alone."""
    found = [(key, v["const"]) for key, v in table["properties"].items() if "const" in v]
    return found[0] if found else ("", "")


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
