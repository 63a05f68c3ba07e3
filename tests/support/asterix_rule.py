"""Values of items from their octets, one part after the other: the rule that readers follow."""

from __future__ import annotations

from collections.abc import Sequence

from plotfeed.proto.asterix.codec.decode import FURTHER, ItemPlaces, Value
from plotfeed.proto.asterix.codec.layout import (
    Category,
    Characters,
    Compound,
    Explicit,
    Extended,
    Fixed,
    Group,
    Item,
    Named,
    Quantity,
    Repetitive,
    Undecoded,
)


def record_by_rule(category: Category, body: bytes) -> tuple[dict[str, Value], int]:
    """The items of the record at the start of a block's body, and the octet after it.

    Raises `DecodeError`.
    """
    items, end = {}, 0
    for item, at, end in ItemPlaces(body).of_record(category, 0):
        items[item.name] = item_by_rule(item, body[at:end])
    return items, end


def item_by_rule(item: Item, octets: bytes) -> Value:
    match item:
        case Fixed(_, group):
            return _values(group, octets)
        case Extended(_, groups):
            return _extended(groups, octets)
        case Repetitive(_, group):
            rest = octets if group.fx else octets[1:]
            cuts = range(0, len(rest), group.octets)
            return [_values(group, rest[cut : cut + group.octets]) for cut in cuts]
        case Explicit() | Undecoded():
            return octets[isinstance(item, Explicit) :]
        case Compound():
            places = ItemPlaces(octets)
            subfields = places._each(*places._present(item.subfields, item.name, 0))
            return {each.name: item_by_rule(each, octets[at:end]) for each, at, end in subfields}


def _extended(groups: Sequence[Group], octets: bytes) -> dict[str, Value]:
    found: dict[str, Value] = {}
    for group in groups:
        if octets:
            integer = int.from_bytes(octets[: group.octets], "big")
            found |= {part.name: _value(part, integer >> right) for part, right in group.fields}
            octets = octets[group.octets :]
    return found | {FURTHER: octets} if octets else found


def _values(group: Group, octets: bytes) -> Value:
    raw = int.from_bytes(octets, "big")
    if len(group.fields) == 1:
        part, right = group.fields[0]
        return _value(part, raw >> right)
    return {part.name: _value(part, raw >> right) for part, right in group.fields}


def _value(part: Named, raw: int) -> Value:
    """The value of a part whose last bit is the last of `raw`."""
    raw &= (1 << part.bits) - 1
    match part:
        case Quantity():
            if part.signed and raw >> part.bits - 1:
                raw -= 1 << part.bits
            return of_quantity(part, raw)
        case Characters():
            each = part.bits_each
            mask = (1 << each) - 1
            places = range(part.bits - each, -1, -each)
            return "".join(part.alphabet[raw >> place & mask] for place in places)
        case _:
            return raw


def of_quantity(part: Quantity, raw: int) -> float:
    """The float nearest to an integer that was sent."""
    return raw / part.divisor if part.divisor else raw * float(part.lsb)
