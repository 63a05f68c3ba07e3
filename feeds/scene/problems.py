"""What is wrong with a scene, in the words of its author: keys, and what was expected of them."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError

from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.scene.fields import SceneTable

MAX_SHOWN = 80


def in_a_line(problems: Iterable[tuple[str, str]]) -> str:
    """Problems, each of a key or of the whole, as one printable line."""
    return printable("; ".join(f"{key}: {text}" if key else text for key, text in problems))


def problems_of(error: ValidationError, tree: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Each problem of a scene as its key and what was expected there; `tree` is what TOML gave."""
    import difflib  # only who mistypes waits for it

    located = error.errors()
    within = {found["loc"][:n] for found in located for n in range(len(found["loc"]))}
    for found in located:
        key, text = _key(found["loc"], tree), found["msg"]
        kind, context = found["type"], found.get("ctx", {})
        if kind == "extra_forbidden":
            known = {name for model in _models() for name in model.model_fields}
            close = difflib.get_close_matches(str(found["loc"][-1]), known, 1)
            hint = f"; did you mean {close[0]}?" if close else ""
            yield key, f"no such key{' here' if found['loc'][-1] in known else hint}"
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
# A key, before a colon at the beginning of what a check says.
_NAMED = re.compile(r"[a-z_]\w*(\[\d+\]|\.\w+)*")
# Where pydantic speaks of Python.
_EXPECTED = {
    "tuple_type": "expected a list",
    "model_type": "expected a table",
    "model_attributes_type": "expected a table",
    "datetime_type": "expected a time without quotes, such as 2026-01-01T12:00:00Z",
}


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


def _models() -> Iterator[type[BaseModel]]:
    from plotfeed.feeds.scene.sensors import SENSORS

    list(SENSORS.values())  # loads them
    waiting = list(SceneTable.__subclasses__())
    while waiting:
        model = waiting.pop()
        yield model
        waiting.extend(model.__subclasses__())


_SPACE = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_TEXT = (
    r'"""(?:[^\\]|\\.)*?"""(?:"{0,2})'
    r"|'''.*?'''(?:'{0,2})"
    r'|"(?:[^"\\\n]|\\.)*"'
    r"|'[^'\n]*'"
)
_KEY = re.compile(rf"\s*({_TEXT}|[A-Za-z0-9_-]+)\s*", re.DOTALL)
_VALUE = re.compile(rf"{_TEXT}|[^,\]}}\n#]+", re.DOTALL)
_OWNER = re.compile(r"(sensor|system|drone|swarm)\[(\d+)\]")


class Problem(NamedTuple):
    """What is wrong with a scene, and where."""

    line: int | None
    """Of the file, from 1 on; None where that is not known."""
    key: str
    """Empty for what is wrong with the whole."""
    of: str | None
    """The id of the sensor, system or drone whose key it is, if it has one."""
    what: str

    def __str__(self) -> str:
        where = f"line {self.line}: " if self.line else ""
        whose = "" if self.of is None else f" of {self.of!r}"
        return f"{where}{self.key}{whose}: {self.what}" if self.key else self.what


def located(problems: Iterable[tuple[str, str]], tree: Any, text: str) -> Iterator[Problem]:
    """Problems with their places in a scene: of what was expected, by keys.

    `tree` is what TOML gave for `text`; of a scene that was no file the text is empty.
    """
    lines = key_lines(text)
    for key, what in problems:
        yield Problem(_line(key, lines), key, _owner(key, tree), what)


def key_lines(text: str) -> dict[str, int]:
    """The line of every key of a TOML text, in the words of problems: `sensor[0].scan.period_s`.

    That of a table is its heading's. The text is one that `tomllib` takes; of what it does not
    take, no more is promised than an end.
    """
    try:
        return _Scan(text).lines
    except RecursionError:
        return {}


def _line(key: str, lines: dict[str, int]) -> int | None:
    """The line of a key, or of the table or list that lacks it."""
    while key not in lines:
        key, cut, _ = key.rpartition("[" if key.endswith("]") else ".")
        if not cut:
            return None
    return lines[key]


def _owner(key: str, tree: Any) -> str | None:
    """The sensor, system or drone whose key it is, if it has a name."""
    found = _OWNER.match(key)
    if found is None or not isinstance(tree, dict):
        return None
    named = tree.get(found[1])
    number = int(found[2])
    entry = named[number] if isinstance(named, list) and number < len(named) else None
    name = entry.get("id") if isinstance(entry, dict) else None
    return name[:64] if isinstance(name, str) and key != f"{found[0]}.id" else None


class _Scan:
    """One pass over a text; `lines` is what it has found."""

    def __init__(self, text: str) -> None:
        self.lines: dict[str, int] = {}
        self._text, self._at = text, 0
        self._line, self._counted = 1, 0
        self._tables: Counter[str] = Counter()  # How many there are by now of each list of tables
        self._document()

    def _document(self) -> None:
        table = ""
        while self._skip():
            before = self._at
            brackets = 2 if self._text.startswith("[[", before) else self._text[before] == "["
            if brackets:
                self._at += brackets
                table = self._heading(self._keys(), is_list=brackets == 2)
                self._at += brackets
            else:
                self._pair(table)
            if self._at == before:
                return  # not TOML

    def _heading(self, keys: list[str], *, is_list: bool) -> str:
        """The name of the table that begins here."""
        name, line = "", self._line_here()
        for n, key in enumerate(keys, 1):
            name = f"{name}.{key}" if name else key
            if n == len(keys) and is_list:
                self._tables[name] += 1
            if self._tables[name]:
                name = f"{name}[{self._tables[name] - 1}]"
            self.lines.setdefault(name, line)
        return name

    def _pair(self, table: str) -> None:
        name, line = table, self._line_here()
        for key in self._keys():
            name = f"{name}.{key}" if name else key
            self.lines.setdefault(name, line)
        self._at += self._text.startswith("=", self._at)
        self._value(name)

    def _value(self, name: str) -> None:
        if not self._skip():
            return
        opened = self._text[self._at]
        if opened not in "{[":
            found = _VALUE.match(self._text, self._at)
            self._at = found.end() if found else self._at
            return
        self._at += 1
        number, closed = 0, "}" if opened == "{" else "]"
        while self._skip() and self._text[self._at] != closed:
            before = self._at
            if opened == "{":
                self._pair(name)
            else:
                self.lines[f"{name}[{number}]"] = self._line_here()
                self._value(f"{name}[{number}]")
                number += 1
            self._at += self._skip() and self._text[self._at] == ","
            if self._at == before:
                return  # not TOML
        self._at += 1

    def _keys(self) -> list[str]:
        """The parts of a dotted key."""
        keys: list[str] = []
        while found := _KEY.match(self._text, self._at):
            self._at = found.end()
            keys.append(_unquoted(found[1]))
            if not self._text.startswith(".", self._at):
                break
            self._at += 1
        return keys

    def _skip(self) -> bool:
        """Pass over spaces, ends of lines and comments; whether anything is left."""
        found = _SPACE.match(self._text, self._at)
        self._at = found.end() if found else self._at
        return self._at < len(self._text)

    def _line_here(self) -> int:
        self._line += self._text.count("\n", self._counted, self._at)
        self._counted = self._at
        return self._line


def _unquoted(key: str) -> str:
    if key[0] not in "\"'":
        return key
    try:
        return next(iter(tomllib.loads(f"{key} = 0")))
    except tomllib.TOMLDecodeError:
        return key
