"""Random records of every category, as libasterix and as our readers read them."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

from asterix import base  # type: ignore[import-not-found]
from support.asterix_input import slots_octets

from plotfeed.proto.asterix.codec.decode import Block, records_in
from plotfeed.proto.asterix.other_categories import OTHER_CATEGORIES
from plotfeed.proto.asterix.standard import standard, tables

RECORDS = 40


def leaves(variation: Any) -> Iterator[Any]:
    """What libasterix has read, part by part."""
    match variation:
        case base.Element():
            yield value_of(variation)
        case base.RuleVariationDependent():
            yield variation.bs.to_uinteger()
        case base.Explicit():
            return
        case base.Compound():
            for each in variation.cv_items_list:
                if each and (found := variation.arg.get(each.cv_name)) is not None:
                    yield from leaves(inside(found))
        case base.Extended():
            for group in variation.arg:
                yield from (leaf for each in group if each for leaf in of_item(each))
        case base.Group():
            yield from (leaf for each in variation.arg for leaf in of_item(each))
        case base.Repetitive():
            yield from (leaf for each in variation.arg for leaf in leaves(each))


def value_of(element: Any) -> Any:
    rule = element._get_rule()
    content = rule._get_content() if isinstance(rule, base.RuleContentContextFree) else None
    if isinstance(content, base.ContentQuantity):
        return content._as_quantity()
    return content.as_integer() if isinstance(content, base.ContentInteger) else element.as_uint()


def inside(of: Any) -> Any:
    rule = of.arg
    return rule.arg if isinstance(rule, base.RuleVariationContextFree) else rule


def of_item(item: Any) -> Iterator[Any]:
    if isinstance(item, base.Item):
        yield from leaves(inside(item.arg))


def ours(value: Any) -> Iterator[Any]:
    if isinstance(value, dict):
        for each in value.values():
            yield from ours(each)
    elif isinstance(value, list):
        for each in value:
            yield from ours(each)
    elif not isinstance(value, bytes):
        yield value


def same(mine: Any, theirs: Any) -> bool:
    # Text is compared by the oracles of our own categories: here its integer stands for it.
    if isinstance(mine, float):
        return abs(mine - theirs) <= 1e-9 * max(1.0, abs(theirs))
    return isinstance(mine, str) or bool(mine == theirs)


def cut_otherwise(number: int, body: bytes, theirs: Any) -> str:
    """What our cutting without libasterix makes otherwise of the record, twice in a block."""
    cut = list(records_in(Block(number, 2 * body, 0), OTHER_CATEGORIES))
    if [record.octets for record in cut] != [body, body]:
        return f"{body.hex()}: cut into {[record.octets.hex() for record in cut]}"
    for name, value in cut[1].items.items():
        octets = inside(theirs.get_item(name.partition("/")[2])).unparse().to_bytes()
        if isinstance(value, bytes) and value not in (octets, octets[1:]):  # RE without its length
            return f"{name}: {value.hex()} is not {octets.hex()}"
        if isinstance(value, float) and value * 128 != int.from_bytes(octets, "big"):
            return f"{name}: {value} is not {octets.hex()}"
        if isinstance(value, dict) and bytes(value.values()) != octets:
            return f"{name}: {value} is not {octets.hex()}"
    return ""


def newest(block: Block) -> list[Any]:
    """The records of a block as the newest edition that libasterix knows reads them."""
    known = tables()
    assert known
    edition = max(known[0].manifest["CATS"][block.category], key=lambda each: each.cv_edition)
    read = edition.cv_uap.parse(base.Bits.from_bytes(block.body))
    assert not isinstance(read, ValueError), read
    return list(read)


def values_of_item(record: Any, name: str) -> list[Any]:
    """What libasterix has read in an item, such as I048/040, from left to right."""
    return list(leaves(inside(record.get_item(name.partition("/")[2]))))


def compared(number: int, draw: random.Random) -> tuple[int, str]:
    found, known = standard(number), tables()
    assert found
    assert known
    newest = max(known[0].manifest["CATS"][number], key=lambda each: each.cv_edition)
    count = 0
    for _ in range(RECORDS):
        body = slots_octets(found.category.uap, draw)
        if number == 1:  # a plot, whose profile that is
            body = slots_octets([None, None, *found.category.uap[2:]], draw, 2)
        (record,) = records_in(Block(number, body, 0), {number: found.category})
        profile = newest.cv_uap
        kind = profile.cv_uaps["plot"] if hasattr(profile, "cv_uaps") else profile.cv_record
        read = kind.parse(base.ParsingMode.StrictParsing, base.Bits.from_bytes(body))
        if isinstance(read, ValueError):
            return count, f"{body.hex()}: {read}"
        theirs, rest = read
        if len(rest):
            return count, f"{body.hex()}: {len(rest)} bits are left"
        if number in OTHER_CATEGORIES and (otherwise := cut_otherwise(number, body, theirs)):
            return count, otherwise
        for name, value in record.items.items():
            mine = list(ours(value))
            other = list(leaves(inside(theirs.get_item(name.partition("/")[2]))))
            if len(mine) != len(other) or not all(map(same, mine, other)):
                return count, f"{name}: {mine} is not {other}"
            count += len(mine)
    return count, ""


def all_compared(seed: int) -> dict[int, tuple[int, str]]:
    """By category how many values were the same, and the first that were not."""
    generator = random.Random(seed)  # noqa: S311 - not for secrets
    known = tables()
    assert known
    numbers = [n for n in known[0].manifest["CATS"] if standard(n)]
    return {n: compared(n, generator) for n in numbers}
