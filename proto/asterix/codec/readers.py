"""Items of records read fast: Python compiled from a layout, once an item, that tells no errors.

A reader takes the octets of a block's body and where its item begins, and gives the value and where
the item ends. What is cut off or broken raises `BROKEN`; `codec.decode`, whose slower road is the
rule that readers follow, then says what is wrong.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any, TypeAlias, cast

from plotfeed.proto.asterix.codec.layout import (
    FX,
    Characters,
    Compound,
    Explicit,
    Extended,
    Fixed,
    Group,
    Item,
    Named,
    Quantity,
    Raw,
    Repetitive,
    Spare,
    Undecoded,
)

FURTHER = "FURTHER"
"""The name under which an extended item keeps the octets that follow the groups of its layout."""
BROKEN = (IndexError, struct.error)
"""What readers raise."""
MAX_PLANS = 4096
"""Of one record or item; what has sent more sets of flags than that begins anew."""
TABLE_BITS = 12
"""Of characters that are looked up at once."""

Reader: TypeAlias = Callable[[bytes, int], tuple[Any, int]]
Plan: TypeAlias = tuple[tuple[str, Reader], ...]
"""Names and readers of what a set of flags says is there."""
_CODES = {(8, False): "B", (16, False): "H", (32, False): "I", (64, False): "Q"} | {
    (8, True): "b",
    (16, True): "h",
    (32, True): "i",
    (64, True): "q",
}


class Plans:
    """The plans of a user application profile, or of a compound item, by their octets of flags."""

    __slots__ = ("_plans", "_slots")

    def __init__(self, slots: Sequence[Item | None]) -> None:
        self._slots = slots
        self._plans: dict[bytes, Plan] = {}

    def __len__(self) -> int:
        return len(self._plans)

    def read(self, body: bytes, at: int) -> tuple[dict[str, Any], int]:
        """Flags, and the items that they name; raises one of `BROKEN`."""
        end = at
        while body[end] & FX:
            end += 1
        end += 1
        flags = body[at:end]
        plan = self._plans.get(flags) or self._plan(flags)
        items: dict[str, Any] = {}
        at = end
        for name, reader in plan:
            items[name], at = reader(body, at)
        return items, at

    def _plan(self, flags: bytes) -> Plan:
        chosen: list[tuple[str, Reader]] = []
        for place, octet in enumerate(flags):
            for bit in range(7):
                if octet >> 7 - bit & 1:
                    item = self._slots[7 * place + bit]
                    if item is None:
                        raise IndexError(bit)
                    chosen.append((item.name, reader_of(item)))
        if len(self._plans) >= MAX_PLANS:
            self._plans.clear()
        plan = self._plans[flags] = tuple(chosen)
        return plan


@cache
def reader_of(item: Item) -> Reader:
    """The reader of an item or subfield."""
    match item:
        case Fixed(_, group):
            return _compiled(_fixed(group), [group])
        case Extended(_, groups):
            return _compiled(_extended(groups), groups)
        case Repetitive(_, group):
            one = _compiled(_fixed(group), [group])
            return _until_fx(one) if group.fx else _counted(one, group.octets)
        case Explicit():
            return _explicit
        case Compound(_, subfields):
            return Plans(subfields).read
        case Undecoded(_, of):
            return _octets(reader_of(of))


def _explicit(body: bytes, at: int) -> tuple[bytes, int]:
    octets = body[at]
    end = at + octets
    if not octets or end > len(body):
        raise IndexError(end)
    return body[at + 1 : end], end


def _octets(one: Reader) -> Reader:
    def read(body: bytes, at: int) -> tuple[bytes, int]:
        _, end = one(body, at)
        if end > len(body):
            raise IndexError(end)
        return body[at:end], end

    return read


def _counted(one: Reader, octets: int) -> Reader:
    def read(body: bytes, at: int) -> tuple[list[Any], int]:
        first = at + 1
        end = first + octets * body[at]
        return [one(body, start)[0] for start in range(first, end, octets)], end

    return read


def _until_fx(one: Reader) -> Reader:
    def read(body: bytes, at: int) -> tuple[list[Any], int]:
        values = []
        more = FX
        while more:
            value, at = one(body, at)
            values.append(value)
            more = body[at - 1] & FX
        return values, at

    return read


def _further(body: bytes, at: int) -> tuple[bytes, int]:
    """The octets of groups that a layout does not have."""
    end = at
    while body[end] & FX:
        end += 1
    return body[at : end + 1], end + 1


def _compiled(lines: Iterator[str], groups: Sequence[Group]) -> Reader:
    """The function of those lines; what they call is made from the groups."""
    names: dict[str, Any] = {"from_bytes": int.from_bytes, "further": _further}
    for number, group in enumerate(groups):
        if packed := _packed(group):
            names[f"unpack{number}"] = struct.Struct(packed).unpack_from
    for part in (part for group in groups for part, _ in group.fields):
        if isinstance(part, Characters):
            names[_table_name(part, _at_once(part))] = _table(part, _at_once(part))
            if rest := part.count % _at_once(part):
                names[_table_name(part, rest)] = _table(part, rest)
    # The text holds numbers and names of our own layouts only: nothing of a sender's gets in.
    exec("\n".join(["def read(body, at):", *("    " + line for line in lines), ""]), names)  # noqa: S102  # nosec B102
    return cast(Reader, names["read"])


def _fixed(group: Group) -> Iterator[str]:
    load, values = _group(group, 0)
    yield load
    single = len(group.fields) == 1
    told = values[0][1] if single else _literal(values)
    yield f"return {told}, at + {group.octets}"


def _extended(groups: Sequence[Group]) -> Iterator[str]:
    for number, group in enumerate(groups):
        load, values = _group(group, number)
        yield load
        if number:
            yield from (f"found[{name!r}] = {value}" for name, value in values)
        else:
            yield f"found = {_literal(values)}"
        yield f"at += {group.octets}"
        yield f"if not body[at - 1] & {FX}: return found, at"
    yield f"found[{FURTHER!r}], at = further(body, at)"
    yield "return found, at"


def _literal(values: Sequence[tuple[str, str]]) -> str:
    return "{" + ", ".join(f"{name!r}: {value}" for name, value in values) + "}"


def _group(group: Group, number: int) -> tuple[str, list[tuple[str, str]]]:
    """The line that loads a group at `at`, and its parts' names and expressions."""
    if _packed(group):
        places = [f"p{place}" for place in range(len(group.fields))]
        load = f"{', '.join(places)}, = unpack{number}(body, at)"
        fields = zip(group.fields, places, strict=True)
        return load, [(part.name, _scaled(part, place)) for (part, _), place in fields]
    octets = group.octets
    if octets <= 3:
        shifts = range(8 * octets - 8, -1, -8)
        terms = (f"body[at + {n}] << {shift}" for n, shift in enumerate(shifts))
        load = f"raw = {' | '.join(terms)}"
    else:  # the last octet is looked at, as slices end where the block does
        load = f"body[at + {octets - 1}]; raw = from_bytes(body[at:at + {octets}], 'big')"
    return load, [(part.name, _value(part, right)) for part, right in group.fields]


def _packed(group: Group) -> str:
    """The format of a group whose parts are machine words, for `struct`; empty if some are not."""
    codes = [">"]
    for part in group.parts:
        if isinstance(part, Spare) and part.bits % 8 == 0:
            codes.append("x" * (part.bits // 8))
        elif isinstance(part, Raw | Quantity):
            codes.append(_CODES.get((part.bits, isinstance(part, Quantity) and part.signed), ""))
        else:
            return ""
        if not codes[-1]:
            return ""
    return "" if group.fx else "".join(codes)


def _value(part: Named, right: int) -> str:
    raw = f"raw >> {right}" if right else "raw"
    if isinstance(part, Characters):
        return _text(part, right)
    masked = f"{raw} & {(1 << part.bits) - 1}"
    if isinstance(part, Quantity) and part.signed:
        sign = 1 << part.bits - 1
        masked = f"({masked} ^ {sign}) - {sign}"
    return _scaled(part, f"({masked})")


def _scaled(part: Named, raw: str) -> str:
    if not isinstance(part, Quantity):
        return raw
    return f"{raw} / {part.divisor}" if part.divisor else f"{raw} * {float(part.lsb)!r}"


def _text(part: Characters, right: int) -> str:
    """Text looked up some characters at once."""
    terms = []
    left = part.count
    while left:
        some = min(left, _at_once(part))
        left -= some
        bits = some * part.bits_each
        place = right + left * part.bits_each
        terms.append(f"{_table_name(part, some)}[raw >> {place} & {(1 << bits) - 1}]")
    return " + ".join(terms)


def _at_once(part: Characters) -> int:
    return min(part.count, TABLE_BITS // part.bits_each)


def _table_name(part: Characters, count: int) -> str:
    return f"text{part.bits_each}_{count}"


def _table(part: Characters, count: int) -> Sequence[str]:
    return _texts(part.alphabet, part.bits_each, count)


@cache
def _texts(alphabet: str, bits_each: int, count: int) -> Sequence[str]:
    """What each integer of so many characters says."""
    if count == 1:
        return alphabet
    return [
        alphabet[raw >> (count - 1) * bits_each] + rest
        for raw in range(1 << bits_each * count)
        for rest in [
            _texts(alphabet, bits_each, count - 1)[raw & (1 << (count - 1) * bits_each) - 1]
        ]
    ]
