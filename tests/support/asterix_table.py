"""The table of a category, as it follows from the layout that was read from it."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterator, Sequence

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.layout import (
    Category,
    Characters,
    Compound,
    Explicit,
    Extended,
    Fixed,
    Group,
    Item,
    Overflow,
    Part,
    Quantity,
    Repetitive,
    Spare,
)

COLUMNS = (3, 8, 6)
WIDTH = 99


def rows(category: Category) -> Iterator[tuple[str, str, str, str]]:
    """Reference number, name, octets and parts of every item."""
    for frn, item in enumerate(category.uap, 1):
        if item:
            yield str(frn), item.name, _octets(item), _parts(item)


def table(category: Category) -> str:
    """The table, wrapped."""
    lines = [_line(("FRN", "item", "octets", "parts: bits, LSB and unit"))]
    for frn, name, octets, parts in rows(category):
        indent = sum(COLUMNS) + 6
        first, *others = textwrap.wrap(parts, WIDTH - indent, break_on_hyphens=False) or [""]
        lines.append(_line((frn, name, octets, first)))
        lines.extend(" " * indent + other for other in others)
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    padded = [cell.ljust(width) for cell, width in zip(cells, COLUMNS, strict=False)]
    return "  ".join([*padded, cells[3]]).rstrip()


def _octets(item: Item) -> str:
    match item:
        case Fixed(_, group):
            return f"{group.octets}"
        case Extended(_, groups):
            return f"{groups[0].octets}+FX"
        case Repetitive(_, group):
            return f"{group.octets}+FX" if group.fx else f"1+{group.octets}n"
        case _:
            return "1+n"


def _parts(item: Item) -> str:
    match item:
        case Fixed(_, group):
            return _group(group)
        case Extended(_, groups):
            return " | ".join(_group(group) for group in groups)
        case Repetitive(_, group):
            return f"repeated: {_group(group)}"
        case Explicit():
            return "octets behind their count"
        case Compound(_, subfields):
            return "; ".join(_subfield(sub) for sub in subfields)


def _subfield(sub: Item | None) -> str:
    if sub is None:
        return "-"
    if isinstance(sub, Fixed) and [part.name for part, _ in sub.group.fields] == [sub.name]:
        return _parts(sub)
    return f"{sub.name} ({_parts(sub)})"


def _group(group: Group) -> str:
    return ", ".join(map(_part, group.parts))


def _part(part: Part) -> str:
    match part:
        case Spare(bits):
            return f"_{bits}"
        case Characters():
            return f"{part.name} {part.count}x{part.bits_each}"
        case Quantity():
            sign = "±" if part.signed else ""
            over = {Overflow.WRAP: " wraps", Overflow.REFUSE: " refused"}.get(part.overflow, "")
            over = f" modulo {round(part.modulus * part.lsb)}" if part.modulus else over
            return f"{part.name} {sign}{part.bits}: {_lsb(part)} {part.unit}".rstrip() + over
        case _:
            return part.name if part.bits == 1 else f"{part.name} {part.bits}"


def _lsb(part: Quantity) -> str:
    if part.lsb >= 1 and part.lsb == int(part.lsb):
        return f"{int(part.lsb)}"
    turn = 360 if part.overflow is Overflow.WRAP else 180
    for power in range(1, 33):
        if part.lsb * 2**power == 1:
            return f"1/{2**power}" if power <= 8 else f"2^-{power}"
        for span in (turn, 10_000):
            if part.lsb * 2**power == span:
                return f"{span}/2^{power}"
    return f"{part.lsb:g}"


if __name__ == "__main__":
    for number in sys.argv[1:]:
        print(table(CATEGORIES[int(number)]), "\n")
