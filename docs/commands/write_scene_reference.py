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
scenes by; `plotfeed schema` prints that schema, for editors that complete and check TOML.

A scene is one TOML file. It names a site, the sensors that look, and the drones that the scene
flies by itself; others may come by telemetry. Only what it names is modelled. A key that does not
exist, a value of the wrong kind or out of bounds is refused before anything starts, each with the
line of the file and the sensor or drone whose key it is:

    here.toml: line 12: sensor[0].powr_w of 'radar': no such key; did you mean power_w?

The unit of a key is the end of its name.

`plotfeed check SCENE` says what the sensors will do; the shipped scenes are in
`feeds/scene/examples/`.
"""
UNITS = {
    "_deg": "degrees",
    "_m2": "m²",
    "_m_s": "m/s",
    "_m": "m",
    "_kbit_s": "kbit/s",
    "_s": "s",
    "_ms": "ms",
    "_hz": "Hz",
    "_w": "W",
    "_dbi": "dBi",
    "_dbm": "dBm",
    "_db": "dB",
    "_h": "h",
    "_utc": "UTC",
    "_pct": "%",
    "_c": "°C",
    "_kpa": "kPa",
}
TYPES = {"number": "number", "integer": "whole number", "boolean": "true or false",
         "string": "text", "array": "list", "object": "table", "null": "none"}  # fmt: skip
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
"""Said here of keys whose own description is empty."""
Schema = dict[str, Any]


class Reference:
    """The page, section by section, each table of the file once."""

    def __init__(self, schema: Schema) -> None:
        self._definitions: dict[str, Schema] = schema.get("$defs", {})
        self._done: set[str] = set()
        self.silent: list[str] = []
        """Keys of which nobody says what they are."""
        self.parts: list[str] = []
        for key, value in schema["properties"].items():
            self._table(key, value)

    def _table(self, place: str, schema: Schema) -> None:
        """A section for each table that may stand at a place, and for those within it."""
        repeated = schema.get("type") == "array"
        for name in self._names(schema):
            if name in self._done or "properties" not in self._definitions[name]:
                continue
            self._done.add(name)
            table = self._definitions[name]
            self.parts.append(self._section(place, table, repeated=repeated))
            for key, value in table["properties"].items():
                if self._names(value):
                    self._table(f"{place}.{key}", value)

    def _section(self, place: str, table: Schema, *, repeated: bool) -> str:
        brackets = f"[[{place}]]" if repeated else f"[{place}]"
        marks = [f'{key} = "{kind}"' for key, kind in _constants(table)]
        title = f"## `{brackets}`" + (f" with `{marks[0]}`" if marks else "")
        lines = [title, "", _line(table.get("description", "")), ""]
        lines += ["| key | what | unit | values | default |", "|---|---|---|---|---|"]
        needed = table.get("required", [])
        for key, value in table["properties"].items():
            default = "**needed**" if key in needed else _default(value)
            what = value.get("description") or NOT_DESCRIBED.get(key, "")
            if not what:
                self.silent.append(f"{place}.{key}")
            cells = (f"`{key}`", _line(what), _unit(key),
                     self._values(value), default)  # fmt: skip
            lines.append("| " + " | ".join(cells) + " |")
        return "\n".join(lines) + "\n"

    def _values(self, schema: Schema) -> str:
        """What may stand there."""
        if words := schema.get("enum", [schema["const"]] if "const" in schema else []):
            return ", ".join(f"`{json.dumps(word)}`" for word in words)
        if "$ref" in schema:
            name = schema["$ref"].rpartition("/")[2]
            inner = self._definitions[name]
            return "table, below" if "properties" in inner else self._values(inner)
        for several in ("anyOf", "oneOf"):
            if several in schema:
                told = [self._values(s) for s in schema[several] if s.get("type") != "null"]
                return " or ".join(dict.fromkeys(told))
        if schema.get("type") == "array":
            return self._list(schema)
        if schema.get("format") == "date-time":
            return "date and time with its zone"
        return " ".join(filter(None, (TYPES[schema.get("type", "object")], _bounds(schema))))

    def _list(self, schema: Schema) -> str:
        if "prefixItems" in schema:
            return f"list of {len(schema['prefixItems'])} numbers"
        inner = self._values(schema.get("items", {}))
        return "list of tables, below" if inner.startswith("table") else f"list of {inner}"

    def _names(self, schema: Schema) -> list[str]:
        """The definitions that a value may be of."""
        found = [schema["$ref"].rpartition("/")[2]] if "$ref" in schema else []
        for inner in (*schema.get("anyOf", ()), *schema.get("oneOf", ()), schema.get("items")):
            if inner:
                found += self._names(inner)
        return found


def _constants(table: Schema) -> list[tuple[str, str]]:
    return [(k, v["const"]) for k, v in table["properties"].items() if "const" in v]


def _bounds(schema: Schema) -> str:
    told = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most",
            "exclusiveMaximum": "below"}  # fmt: skip
    return ", ".join(
        f"{text} {_number(schema[key])}" for key, text in told.items() if key in schema
    )


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
        return "none"
    return f"`{value:g}`" if isinstance(value, float) else f"`{json.dumps(value)}`"


def _unit(key: str) -> str:
    return next((unit for end, unit in UNITS.items() if key.endswith(end)), "")


def _line(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("|", "\\|").strip()


def page() -> str:
    """The whole page."""
    reference = Reference(json.loads(text_of("scene")))
    if reference.silent:
        raise SystemExit(f"keys without a description: {', '.join(reference.silent)}")
    return "\n".join([INTRODUCTION, *reference.parts])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
