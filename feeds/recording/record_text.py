"""A record of ASTERIX as text: a line, a tree with names, units and words, or JSON."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from enum import Enum
from functools import cache
from typing import Any

from plotfeed.feeds.console.printed import printable
from plotfeed.proto.asterix.cat025 import CAT025_HALF_TURN
from plotfeed.proto.asterix.cat062 import CAT062_1_18
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import Record
from plotfeed.proto.asterix.codec.layout import (
    Category,
    Compound,
    Explicit,
    Extended,
    Item,
    Quantity,
    Undecoded,
    is_time_of_day,
)
from plotfeed.proto.asterix.other_categories import OTHER_CATEGORIES
from plotfeed.proto.asterix.standard import Meaning, StandardCategories, standard

# Digits of items, and parts of items, that everybody writes so: addresses, Mode S registers.
HEXADECIMAL = {
    "I048/220": 6,
    "ADR": 6,
    "I020/220": 6,
    "I021/080": 6,
    "I048/260": 14,
    "I020/260": 14,
    "MBDATA": 14,
    "ACS": 14,
}
# Of categories that not all senders write alike.
EDITIONS: Mapping[str, Category] = {"025-half-turn": CAT025_HALF_TURN, "062-1.18": CAT062_1_18}
EXTRA = "pip install 'plotfeed[asterix]'"
# Said of records that are cut alone.
NOT_DECODED = f"octets are not decoded; for names and values: {EXTRA}"
NO_TIME = " " * 12
INDENT = "  "
UNNAMED = Meaning("")
Categories = Mapping[int, Category]


def categories_of(editions: Iterable[str], *, verbose: bool = False) -> Categories:
    """The layouts to read ASTERIX by, with those editions in place of the usual ones.

    For trees they are those of libasterix, whose names these have, where it is installed.
    """
    chosen = {EDITIONS[name].number: EDITIONS[name] for name in editions}
    ours = {**CATEGORIES, **chosen}
    for number in CATEGORIES if verbose else ():
        if number not in chosen and (theirs := standard(number)):
            ours[number] = theirs.category
    return StandardCategories(ours)


class Style(Enum):
    """How what is in a message is written: each thing in it a line, a tree or a JSON object."""

    LINE = "line"
    TREE = "tree"
    JSON = "json"


def record_told(record: Record, categories: Categories, style: Style) -> Any:
    """A record in that style: text, or a value for JSON."""
    if style is not Style.JSON:
        return (record_line if style is Style.LINE else record_tree)(record, categories)
    # The octets of what is not decoded.
    octets = {} if record.items else {"octets": record.octets.hex()}
    return {"category": record.category, "items": _plain(_expanded(record)), **octets}


def problem(what: object, style: Style) -> Any:
    """Something that is wrong, in place of what cannot be told."""
    return {"error": str(what)} if style is Style.JSON else what


def record_line(record: Record, categories: Categories = CATEGORIES) -> str:
    """Time of day, then every item but the source's own name for the category."""
    if not record.items:
        return _unknown(record)
    items, category = _expanded(record), categories[record.category]
    when = _time(items, category)
    if category is OTHER_CATEGORIES.get(record.category):
        # Of most items only the ends are known: their octets, but for sources and times.
        parts = "  ".join(
            f"{_number(name)} {f'0x{value.hex()}' if type(value) is bytes else short(value)}"
            for name, value in items.items()
        )
        return f"CAT{record.category:03d}  {when}  {parts}  ({NOT_DECODED})"
    parts = "  ".join([f"{_number(name)} {_part(name, value)}" for name, value in items.items()])
    return f"CAT{record.category:03d}  {when}  {parts}"


def record_tree(record: Record, categories: Categories) -> str:
    """Lines of every item and part: what it is called, its value, unit, and what that says."""
    if not record.items:
        return _unknown(record)
    category, theirs = categories[record.category], standard(record.category)
    is_theirs = theirs is not None and category is theirs.category
    meanings = theirs.meanings if theirs and is_theirs else _own_meanings(category)
    edition = f", edition {theirs.edition}" if theirs and is_theirs else ""
    head = f"CAT{record.category:03d}  record of {len(record.octets)} octets{edition}"
    if category is OTHER_CATEGORIES.get(record.category):
        head = f"{head}; {NOT_DECODED}"
    found = _expanded(record).items()
    lines = (line for name, value in found for line in _branch(name, value, name, meanings, INDENT))
    return "\n".join([head, *lines])


def _branch(
    label: str, value: Any, path: str, meanings: Mapping[str, Meaning], indent: str
) -> Iterator[str]:
    meaning = meanings.get(path, UNNAMED)
    named = f"{indent}{label}  {meaning.title}".rstrip()
    if isinstance(value, Mapping):
        yield named
        for name, part in value.items():
            yield from _branch(name, part, f"{path}/{name}", meanings, indent + INDENT)
    elif isinstance(value, list):
        yield f"{named}, {len(value)} times"
        inner = Meaning("", meaning.unit, meaning.words)
        for number, part in enumerate(value, 1):
            yield from _branch(f"{number}.", part, path, {**meanings, path: inner}, indent + INDENT)
    else:
        text = _part(label, value)
        if meaning.unit:
            text = f"{text} {meaning.unit}"
        if isinstance(value, int) and value in meaning.words:
            text = f"{text}, {meaning.words[value]}"
        is_time = meaning.title.startswith("Time of Day")
        yield f"{named}: {text}, {_clock(value)}" if is_time else f"{named}: {text}"


@cache
def _own_meanings(category: Category) -> Mapping[str, Meaning]:
    """Units, which our own layouts have; they have neither names nor words."""
    units: dict[str, Meaning] = {}
    for item in category.uap:
        if item is not None:
            units.update(_units(item, item.name))
    return units


def _units(item: Item, path: str) -> Iterator[tuple[str, Meaning]]:
    match item:
        case Compound(_, subfields):
            for sub in subfields:
                if sub is not None:
                    yield from _units(sub, f"{path}/{sub.name}")
        case Explicit() | Undecoded():
            pass
        case _:
            groups = item.groups if isinstance(item, Extended) else (item.group,)
            alone = not isinstance(item, Extended) and len(item.group.fields) == 1
            for part, _ in (each for group in groups for each in group.fields):
                if isinstance(part, Quantity):
                    yield path if alone else f"{path}/{part.name}", Meaning("", part.unit)


def _expanded(record: Record) -> dict[str, Any]:
    """The items, with the parts of the RE field where libasterix is there to know them."""
    items: dict[str, Any] = dict(record.items)
    name = f"I{record.category:03d}/RE"
    octets = items.get(name)
    if isinstance(octets, bytes) and octets and (theirs := standard(record.category)):
        items[name] = theirs.read_expansion(octets) or octets
    return items


@cache
def _number(name: str) -> str:
    """The number of an item, which stands behind its category."""
    return name.partition("/")[2]


def _unknown(record: Record) -> str:
    """A block of a category of which nothing is known, not even where its records end."""
    what = f"a block of {len(record.octets)} octets, of which no layout is known"
    return f"CAT{record.category:03d}  {NO_TIME}  {what}: {record.octets.hex()}"


def _time(items: dict[str, Any], category: Category) -> str:
    """The first time of day of a record, which is taken out of its items."""
    for name in _time_items(category):
        if isinstance(items.get(name), float):
            return _clock(items.pop(name))
    return NO_TIME


# By the identity of a category, as its hash is that of all that it holds.
_TIMES: dict[int, tuple[Category, tuple[str, ...]]] = {}


def _time_items(category: Category) -> tuple[str, ...]:
    """The names of a category's times of day."""
    found = _TIMES.get(id(category))
    if found is None:
        slots = (*category.uap, *category.track_uap)
        names = dict.fromkeys(item.name for item in slots if item and is_time_of_day(item))
        found = _TIMES[id(category)] = category, tuple(names)
    return found[1]


def _clock(time_of_day_s: float) -> str:
    minutes, seconds = divmod(time_of_day_s, 60)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours:02d}:{minutes:02d}:{seconds:06.3f}"


def short(value: Any) -> str:
    """A value without a digit lost; parts of a part in brackets."""
    kind = type(value)
    if kind is float:
        return repr(value).removesuffix(".0")
    if kind is int:
        return str(value)
    if kind is dict:
        return " ".join(
            [
                f"{name}=({short(part)})" if type(part) is dict else f"{name}={_part(name, part)}"
                for name, part in value.items()
            ]
        )
    if kind is list:
        return "[" + ", ".join([short(part) for part in value]) + "]"
    if kind is bytes:
        return f"{len(value)} octets {value.hex()}"
    return printable(str(value))


def _part(name: str, value: Any) -> str:
    """A value as what has that name is written."""
    digits = HEXADECIMAL.get(name) if type(value) is int else None
    return f"{value:0{digits}X}" if digits else short(value)


def _plain(value: Any) -> Any:
    """A value with octets as hexadecimal text, as JSON needs them."""
    if isinstance(value, Mapping):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_plain(part) for part in value]
    return value.hex() if isinstance(value, bytes) else value
