"""Keys of a scene that are varied: paths that name them, and the values that they shall have."""

from __future__ import annotations

import copy
import json
import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal, DecimalException
from typing import Any, NoReturn, Self

from plotfeed.feeds.scene.presets.preset import with_presets
from plotfeed.feeds.scene.presets.system import with_systems
from plotfeed.feeds.scene.problems import in_a_line
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.proto.errors import PlotfeedError

MAX_VALUES = 1000  # Of a key
EXAMPLE = "such as link.latency_ms=0:2000:250 or sensor.radar.pfa=1e-6,1e-5"
ALL = "*"
MOST_NAMED = 12  # Entries that an error names
_STEPS = re.compile(r"\s*([^:,\s]+):([^:,\s]+):([^:,\s]+)\s*")
_WORD = re.compile(r"[A-Za-z_][\w.-]*")


@dataclass(frozen=True, slots=True)
class VariedKey:
    """A key by its path, and the values that it shall have, as JSON."""

    path: str
    values: tuple[str, ...]

    @classmethod
    def parse(cls, text: str) -> Self:
        """`KEY=VALUE,VALUE` with values as in a scene, or `KEY=START:STOP:STEP`, which holds STOP.

        Words need no quotes. Raises `PlotfeedError`.
        """
        path, equals, values = text.partition("=")
        path = path.strip()
        if not path or not equals or not values.strip():
            raise PlotfeedError(f"--vary {text}: expected KEY=VALUES, {EXAMPLE}")
        steps = _STEPS.fullmatch(values)
        found = _from_to(path, *steps.groups()) if steps else _listed(path, values)
        try:
            told = tuple(json.dumps(value) for value in found)
        except TypeError:
            _refuse(path, "a time cannot be varied")
        if len(set(told)) < len(told):
            _refuse(path, "a value is there twice")
        if len(told) > MAX_VALUES:
            _refuse(path, f"at most {MAX_VALUES} values are taken")
        return cls(path, told)


def _from_to(path: str, start: str, stop: str, step: str) -> list[float]:
    """Decimals, so that the steps of 0:1:0.1 are the tenths that one would write."""
    try:
        first, last, by = (Decimal(number) for number in (start, stop, step))
        count = int((last - first) / by) + 1 if (last - first) * by >= 0 else 0
    except (DecimalException, OverflowError, ValueError):
        _refuse(path, f"expected three numbers as START:STOP:STEP, not {start}:{stop}:{step}")
    if not 0 < count <= MAX_VALUES:
        _refuse(path, f"{start}:{stop}:{step} has no values, or more than {MAX_VALUES}")
    is_whole = all(re.fullmatch(r"[+-]?\d+", number) for number in (start, stop, step))
    return [(int if is_whole else float)(first + n * by) for n in range(count)]


def _listed(path: str, text: str) -> list[Any]:
    """Values as TOML has them in a list, or else each of them, or a word without quotes."""
    values = _toml(text)
    if values is not None:
        return values
    values = []
    for part in map(str.strip, text.split(",")):
        found = _toml(part) or ([part] if _WORD.fullmatch(part) else [])
        if not found:
            _refuse(path, f"{part!r} is no value: expected numbers, words, or as in a scene")
        values += found
    return values


def _toml(text: str) -> list[Any] | None:
    try:
        values: list[Any] = tomllib.loads(f"values = [{text}]")["values"]
    except (ValueError, RecursionError):
        return None
    return values


def varied_tree(text: str, changes: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """What a scene's text gives, systems and presets written out, with other values of some keys.

    Raises `PlotfeedError` for a path that leads nowhere; whether there is such a key and may have
    the value, the scene itself says.
    """
    tree = tomllib.loads(text)
    for path, value in changes:
        if path.partition(".")[0] == "system":
            _set(tree, path, value)
    tree, problems, _ = with_systems(tree)
    if problems:
        raise PlotfeedError(f"--vary {changes[0][0]}: {in_a_line(problems)}")
    tree, _ = with_presets({key: tables for key, tables in tree.items() if key != "system"})
    tree = copy.deepcopy(tree)
    for path, value in changes:
        if path.partition(".")[0] != "system":
            _set(tree, path, value)
    return tree


def _set(tree: dict[str, Any], path: str, value: Any) -> None:
    for table, key in _places(path, tree):
        table[key] = value


def _places(path: str, tree: dict[str, Any]) -> Iterator[tuple[Any, Any]]:
    """The tables, with the key in each, that a path names in a tree, where missing ones are made.

    Entries of lists go by their id, type, kind or number from 0 on; `*` is all of them. A path that
    begins with a key of sensors is of all sensors. Raises `PlotfeedError`.
    """
    head, dot, rest = path.partition(".")
    if head == "sensor" and dot:
        yield from _of_sensors(path, tree["sensor"], rest)
    elif head in Scene.model_fields:
        if not dot:
            _refuse(path, f"a whole table; expected {head}.KEY")
        if Scene.model_fields[head].default == () and not tree.get(head):
            _refuse(path, f"there is no {head}")
        yield from _in_table(path, tree, path, "")
    elif any(head in keys.model_fields for keys in SENSORS.values()):
        yield from _of_sensors(path, tree["sensor"], f"{ALL}.{path}")
    else:
        there = ", ".join(Scene.model_fields)
        _refuse(path, f"no such key: expected one of {there}, or a key of sensors")


def _of_sensors(path: str, sensors: list[dict[str, Any]], rest: str) -> Iterator[tuple[Any, Any]]:
    chosen, key = _chosen(path, sensors, rest, "sensor")
    head = key.partition(".")[0]
    if len(chosen) > 1:  # of several kinds, of which some may have no such key
        has = [i for i in chosen if head in SENSORS[sensors[i]["type"]].model_fields]
        chosen = has or chosen
    for i in chosen:
        yield from _in_table(path, sensors[i], key, f"sensor.{sensors[i]['id']}.")


def _in_table(path: str, here: dict[str, Any], rest: str, before: str) -> Iterator[tuple[Any, Any]]:
    """Each table or list, and the key or number in it, that the rest of a path names."""
    key, dot, rest = rest.partition(".")
    if not dot:
        yield here, key
        return
    below, at = here.setdefault(key, {}), f"{before}{key}"
    if isinstance(below, dict):
        yield from _in_table(path, below, rest, f"{at}.")
    elif not isinstance(below, list):
        _refuse(path, f"{at} is no table")
    elif all(isinstance(entry, dict) for entry in below):
        chosen, key = _chosen(path, below, rest, at)
        for i in chosen:
            yield from _in_table(path, below[i], key, f"{at}.{i}.")
    elif rest.isascii() and rest.isdigit() and int(rest) < len(below):
        yield below, int(rest)
    else:
        _refuse(path, f"{at} has the numbers 0 to {len(below) - 1}")


def _chosen(
    path: str, entries: Sequence[dict[str, Any]], rest: str, before: str
) -> tuple[list[int], str]:
    """Numbers of the entries that the rest of a path names, and what is left of it."""
    names = [[str(e[k]) for k in ("id", "type", "kind") if k in e] for e in entries]
    first, _, key = rest.partition(".")
    known = dict.fromkeys(name for each in names for name in each)
    for name in sorted(known, key=len, reverse=True):  # an id may have a dot in it
        if rest == name or rest.startswith(f"{name}."):
            first, key = name, rest[len(name) + 1 :]
            break
    if first == ALL:
        chosen = list(range(len(names)))
    elif first in known:
        chosen = [i for i, each in enumerate(names) if first in each]
    elif first.isascii() and first.isdigit() and int(first) < len(names):
        chosen = [int(first)]
    else:
        told = [*list(known)[:MOST_NAMED], *(["and others"] if len(known) > MOST_NAMED else [])]
        there = f"expected one of {', '.join(told)}" if told else "there are none"
        _refuse(path, f"no {before} {first!r}: {there}")
    if not key:
        _refuse(path, f"a whole {before}; expected {before}.{first}.KEY")
    return chosen, key


def _refuse(path: str, what: str) -> NoReturn:
    raise PlotfeedError(f"--vary {path}: {what}")
