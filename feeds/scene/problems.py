"""What is wrong with a scene, in the words of its author: keys, and what was expected of them."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator
from typing import Any

from pydantic import BaseModel, ValidationError

from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.scene.fields import SceneTable

MAX_SHOWN = 80


def in_a_line(problems: Iterable[tuple[str, str]]) -> str:
    """Problems, each of a key or of the whole, as one printable line."""
    return printable("; ".join(f"{key}: {text}" if key else text for key, text in problems))


def problems_of(error: ValidationError, tree: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Each problem of a scene as its key and what was expected there; `tree` is what TOML gave."""
    located = error.errors()
    within = {found["loc"][:n] for found in located for n in range(len(found["loc"]))}
    for found in located:
        key, text = _key(found["loc"], tree), found["msg"]
        kind, context = found["type"], found.get("ctx", {})
        if kind == "extra_forbidden":
            yield key, f"no such key{_suggestion(found['loc'])}"
        elif kind == "missing":
            yield key, "missing"
        elif kind == "union_tag_not_found":
            yield f"{key}.{context['discriminator'].strip(_QUOTE)}", "missing"
        elif kind == "union_tag_invalid":
            here = f"{key}.{context['discriminator'].strip(_QUOTE)}"
            yield here, f"expected one of {context['expected_tags']}, not {_shown(context['tag'])}"
        elif kind == "value_error":
            inner, _, rest = text.removeprefix("Value error, ").partition(": ")
            named = rest and _NAMED.fullmatch(inner)
            yield (f"{key}.{inner}" if key else inner) if named else key, rest if named else inner
        elif kind == "too_short":
            if found["loc"] not in within:  # else it only lacks what was refused itself
                yield key, "at least one is needed"
        else:
            expected = _EXPECTED.get(kind, f"{text[0].lower()}{text[1:]}")
            yield key, f"{expected}, not {_shown(found['input'])}"


_QUOTE = "'"
_NAMED = re.compile(r"[a-z_]\w*(\[\d+\]|\.\w+)*")
"""A key, before a colon at the beginning of what a check says."""
_EXPECTED = {
    "tuple_type": "expected a list",
    "model_type": "expected a table",
    "model_attributes_type": "expected a table",
    "datetime_type": "expected a time without quotes, such as 2026-01-01T12:00:00Z",
}
"""Where pydantic speaks of Python."""


def _shown(value: object) -> str:
    """What stands in the scene, as far as it tells something in a line."""
    if isinstance(value, int) and abs(value) >= 1 << 64:
        return "so large a number"
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else "a list"
    text = repr(value) if isinstance(value, str | int | float) else str(value)
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}..."


def _key(location: tuple[int | str, ...], tree: dict[str, Any]) -> str:
    """sensor[0].scan.period_s; the names of variants that pydantic puts in between are left out."""
    key, here = "", tree
    for i, step in enumerate(location):
        if isinstance(step, int):
            key += f"[{step}]"
            here = here[step] if isinstance(here, list) and step < len(here) else {}
            continue
        is_variant = i and isinstance(here, dict) and step in (here.get("type"), here.get("kind"))
        if is_variant and step not in here:
            continue
        key += f".{step}" if key else str(step)
        here = here.get(step, {}) if isinstance(here, dict) else {}
    return key


def _suggestion(location: tuple[int | str, ...]) -> str:
    known = {name for model in _models() for name in model.model_fields}
    if location[-1] in known:
        return " here"  # but elsewhere
    close = difflib.get_close_matches(str(location[-1]), known, 1)
    return f"; did you mean {close[0]}?" if close else ""


def _models() -> Iterator[type[BaseModel]]:
    from plotfeed.feeds.scene.sensors import SENSORS

    list(SENSORS.values())  # loads them
    waiting = list(SceneTable.__subclasses__())
    while waiting:
        model = waiting.pop()
        yield model
        waiting.extend(model.__subclasses__())
