"""libasterix reads what we read: recordings, and any records of every category."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random
from typing import Any

from asterix import base  # type: ignore[import-not-found]
from support.asterix_input import slots_octets
from support.given_recordings import recorded_payloads

from plotfeed.proto.asterix.cat025 import CAT025_HALF_TURN
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import FURTHER, Block, Record, Value, blocks, records_in
from plotfeed.proto.asterix.other_categories import OTHER_CATEGORIES
from plotfeed.proto.asterix.standard import standard, tables


def values(value: Value) -> Iterator[Any]:
    """From left to right."""
    if isinstance(value, dict):
        assert FURTHER not in value
    members = value.values() if isinstance(value, dict) else value
    if isinstance(members, (int, float, str, bytes)):
        yield members
        return
    for member in members:
        yield from values(member)


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
    match content:
        case base.ContentQuantity():
            return content._as_quantity()
        case base.ContentInteger():
            return content.as_integer()
        case base.ContentString():
            return content.as_string()
        case _:
            return element.as_uint()


def inside(of: Any) -> Any:
    rule = of.arg
    return rule.arg if isinstance(rule, base.RuleVariationContextFree) else rule


def of_item(item: Any) -> Iterator[Any]:
    if isinstance(item, base.Item):
        yield from leaves(inside(item.arg))


def of_libasterix(record: Any, name: str) -> list[Any]:
    """What libasterix has read in an item, such as I048/040, from left to right."""
    return list(leaves(inside(record.get_item(name.partition("/")[2]))))


def in_its_parts(name: str, value: Value) -> Value:
    """An item whose parts are put together where libasterix does not cut them."""
    match value:
        case {"MBDATA": int(data), "BDS1": int(one), "BDS2": int(two)} if name == "I062/380":
            return data << 8 | one << 4 | two
        case {"PID": int(pair), "ON": int(number)} if name == "I015/480":
            return pair << 24 | number
        case dict():
            return {key: in_its_parts(name, member) for key, member in value.items()}
        case list():
            return [in_its_parts(name, member) for member in value]
        case _:
            return value


def is_same(mine: Any, theirs: Any) -> bool:
    """Whether two values are one; libasterix drops what is no character."""
    if isinstance(theirs, str):
        is_text = isinstance(mine, str)
        return not is_text or mine in (theirs,) or mine.replace("?", "") == theirs
    if isinstance(mine, float):
        return abs(mine - theirs) <= 1e-9 * max(1.0, abs(theirs))
    return bool(mine == theirs)


def agree_with_libasterix(record: Record, theirs: Any) -> int:
    """Both have the same values in each item; how many."""
    count = 0
    for name, value in record.items.items():
        mine = [v for v in values(in_its_parts(name, value)) if not isinstance(v, bytes)]
        its = of_libasterix(theirs, name)
        assert len(mine) == len(its), name
        assert all(map(is_same, mine, its)), (name, mine, its)
        count += len(mine)
    return count


def assert_cut_alike(number: int, body: bytes, theirs: Any) -> None:
    """Our cutting without libasterix finds the record, twice in a block, and its items' ends."""
    cut = list(records_in(Block(number, 2 * body, 0), OTHER_CATEGORIES))
    assert [record.octets for record in cut] == [body, body]
    for name, value in cut[1].items.items():
        octets = inside(theirs.get_item(name.partition("/")[2])).unparse().to_bytes()
        if isinstance(value, bytes):  # RE without its length
            assert value in (octets, octets[1:])
        elif isinstance(value, float):
            assert value * 128 == int.from_bytes(octets, "big")
        else:
            assert isinstance(value, dict)
            assert bytes(value.values()) == octets  # type: ignore[arg-type]


def newest(number: int) -> Any:
    """The newest edition of a category that libasterix knows."""
    known = tables()
    assert known
    return max(known[0].manifest["CATS"][number], key=lambda each: each.cv_edition)


NAMED = {1, 2, 19, 20, 21, 23, 65, 240, 247}
OURS = {number: layout for number, layout in CATEGORIES.items() if number != 129}
OURS[25] = CAT025_HALF_TURN  # as libasterix has it


def test_libasterix_reads_random_records_of_every_category_as_we_do() -> None:
    """By our own layouts, by those that are made of its tables, and cut without it."""
    rng, known = Random(1), tables()  # noqa: S311
    assert known
    made = {n: found.category for n in known[0].manifest["CATS"] if (found := standard(n))}
    assert made.keys() >= NAMED | OURS.keys()
    for number, layout in [*OURS.items(), *made.items()]:
        uap, always, seen = layout.uap, (), set[str]()
        if number == 1:  # a plot, whose profile that is
            uap, always = (None, None, *layout.uap[2:]), (2,)
        profile = newest(number).cv_uap
        kind = profile.cv_uaps["plot"] if hasattr(profile, "cv_uaps") else profile.cv_record
        for _ in range(25):
            body = slots_octets(uap, rng, *always)
            (record,) = records_in(Block(number, body, 0), {number: layout})
            read = kind.parse(base.ParsingMode.StrictParsing, base.Bits.from_bytes(body))
            assert not isinstance(read, ValueError), (number, body.hex(), read)
            theirs, rest = read
            assert not len(rest), (number, body.hex())
            agree_with_libasterix(record, theirs)
            if number in OTHER_CATEGORIES:
                assert_cut_alike(number, body, theirs)
            seen |= record.items.keys()
        assert seen == {item.name for item in uap if item}


def test_libasterix_reads_the_same_in_recordings() -> None:
    count = 0
    for block in (block for payload in recorded_payloads() for block in blocks(payload)):
        read = newest(block.category).cv_uap.parse(base.Bits.from_bytes(block.body))
        assert not isinstance(read, ValueError), read
        for mine, theirs in zip(records_in(block), read, strict=True):
            count += agree_with_libasterix(mine, theirs)
    assert count > 4000
