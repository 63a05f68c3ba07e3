"""The text of a scene's file with a key or a table less or more; other lines stay as they are."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

SENSOR = "[[sensor]]"


def inline(value: Any) -> str:
    """A value as TOML writes it in a line; keys of tables that have none are left out."""
    if isinstance(value, Mapping):
        stated = ((_key(key), inline(of)) for key, of in value.items() if of is not None)
        return f"{{ {', '.join(f'{key} = {of}' for key, of in stated)} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(inline, value))}]"
    return repr(float(value)) if isinstance(value, float) else json.dumps(value)


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)


def with_table(text: Sequence[str], head: str, keys: Mapping[str, Any], why: str) -> list[str]:
    """The lines, and after them a table below the comment that says why."""
    return [*text, "", why, head, *(f"{key} = {inline(value)}" for key, value in keys.items())]


def with_key(text: Sequence[str], key: str, values: Mapping[int, Any], why: str) -> list[str]:
    """The lines with a key of sensors, by their numbers, below the comment that says why."""
    lines, number = [], -1
    for line in text:
        lines.append(line)
        if line.strip().startswith(SENSOR):
            number += 1
            if number in values:
                lines += [why, f"{key} = {inline(values[number])}"]
    return lines


def without(text: Sequence[str], key: str, owners: Collection[int] | None, why: str) -> list[str]:
    """The lines with a key or table as comments, below one that says why.

    It is that of sensors by their numbers, or a table of the whole scene where there are no
    `owners`. What stands in a line with other keys stays.
    """
    lines, number, table, depth, inside = [], -1, "", 0, False
    name = re.escape(key)
    header = rf"\[+{name}[\].]" if owners is None else rf"\[+sensor\.{name}[\].]"
    for line in text:
        plain = line.strip()
        if depth == 0 and plain.startswith("["):
            table = plain
            number += plain.startswith(SENSOR)
            inside = bool(re.match(header, plain)) and (owners is None or number in owners)
            if inside:
                lines.append(why)
        elif depth == 0 and plain.startswith("#"):
            inside = False
        is_owner = owners is not None and number in owners and table.startswith(SENSOR)
        begins = is_owner and bool(re.match(rf"{name}[\s.=]", plain))
        if begins and depth == 0:
            lines.append(why)
        goes = inside or depth > 0 or begins
        if begins or depth > 0:
            depth += sum(map(plain.count, "[{")) - sum(map(plain.count, "]}"))
        lines.append(f"# {line}" if goes and plain else line)
    return lines
