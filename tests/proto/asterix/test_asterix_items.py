"""Every item of every category as libasterix reads it; vectors/make_items.py made the records.

Category 129 is in no library: its records are worked by hand, octet by octet.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from support.asterix_rule import record_by_rule

from plotfeed.proto.asterix.cat025 import CAT025_HALF_TURN
from plotfeed.proto.asterix.cat062 import CAT062, CAT062_1_18
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import FURTHER, OFTEN, Block, Value, decode, records_in
from plotfeed.proto.asterix.codec.layout import (
    Category,
    Extended,
    Fixed,
    Group,
    Item,
    Raw,
    Repetitive,
    Spare,
    category,
)
from plotfeed.proto.errors import DecodeError

VECTORS = json.loads((Path(__file__).parent / "vectors" / "items.json").read_text())

AS_LIBASTERIX = {**CATEGORIES, 25: CAT025_HALF_TURN}


def flat(value: Value) -> Iterator[Any]:
    """The values of an item from left to right."""
    match value:
        case dict():
            assert FURTHER not in value
            for member in value.values():
                yield from flat(member)
        case list():
            for member in value:
                yield from flat(member)
        case bytes():
            yield value.hex()
        case _:
            yield value


def whole(item: str, value: Value) -> Value:
    """An item whose parts are put together where libasterix does not cut them."""
    match value:
        case {"MBDATA": int(data), "BDS1": int(one), "BDS2": int(two)} if item == "I062/380":
            return data << 8 | one << 4 | two
        case {"PID": int(pair), "ON": int(number)} if item == "I015/480":
            return pair << 24 | number
        case dict():
            return {name: whole(item, member) for name, member in value.items()}
        case list():
            return [whole(item, member) for member in value]
        case _:
            return value


def agree(mine: Any, theirs: Any) -> bool:
    """Whether two values are the same; libasterix drops what is no character."""
    if isinstance(theirs, str):
        return bool(mine in (theirs,) or mine.replace("?", "") == theirs)
    return bool(mine == pytest.approx(theirs, rel=1e-12))


@pytest.mark.parametrize("vector", VECTORS, ids=lambda v: f"{int(v['block'][:2], 16):03}")
def test_every_value_is_as_libasterix_reads_it(vector: dict[str, Any]) -> None:
    (record,) = decode(bytes.fromhex(vector["block"]), AS_LIBASTERIX)
    assert list(record.items) == list(vector["items"])
    for item, expected in vector["items"].items():
        mine = list(flat(whole(item, record.items[item])))
        assert len(mine) == len(expected), item
        assert all(map(agree, mine, expected)), (item, mine, expected)


def test_there_are_vectors_of_every_item_but_those_of_category_129() -> None:
    seen = {item for vector in VECTORS for item in vector["items"]}
    assert seen == {
        item.name
        for category in CATEGORIES.values()
        if category.number != 129
        for item in category.uap
        if item
    }


EVERYTHING_129 = bytes.fromhex(
    "81 003c"  # category, 60 octets
    "ff fb 80"  # items 1 to 7; 8 to 12 and 14; 15
    "0000"  # source 0/0
    "0a0b"  # destination 10/11
    "414243"  # ABC
    "583132"  # X12
    "534e2d303030303030303031"  # SN-000000001
    "4553"  # ES
    "546000"  # 12 h: 5529600 / 128 s
    "0e666666 ff555555"  # 241591910 and -11184811 in 180/2^30 deg
    "001a0b"  # 6667: 666.7 m
    "fffff6"  # -10: -1.0 m
    "000c"  # 12 m
    "9f0000"  # 10 01 1111
    "003e8ffc18"  # 1000 and -1000: 10 and -10 m/s
    "0fff9c"  # -100: -1 m/s
)


def test_a_record_of_everything_of_category_129() -> None:
    (record,) = decode(EVERYTHING_129)
    assert record.items == {
        "I129/010": {"SAC": 0, "SIC": 0},
        "I129/015": {"DAC": 10, "DIC": 11},
        "I129/020": "ABC",
        "I129/030": "X12",
        "I129/040": "SN-000000001",
        "I129/050": "ES",
        "I129/070": 43_200.0,
        "I129/080": {"LAT": 241_591_910 * 180 / 2**30, "LON": -11_184_811 * 180 / 2**30},
        "I129/090": pytest.approx(666.7),
        "I129/100": pytest.approx(-1.0),
        "I129/110": 12.0,
        "I129/120": {"UCC": 2, "ARC": 1, "AEC": 15},
        "I129/185": {"VX": pytest.approx(10.0), "VY": pytest.approx(-10.0)},
        "I129/220": pytest.approx(-1.0),
    }


@pytest.mark.parametrize(("category", "feet"), [(CAT062, -25.0), (CAT062_1_18, 65535 * 25.0)])
def test_a_height_below_0_is_one_from_edition_1_19_on(category: Category, feet: float) -> None:
    block = bytes.fromhex("3e 000a 01010102 20 ffff")
    (record,) = decode(block, {62: category})
    assert record.get("I062/340/HEIGHT") == feet


def test_longitudes_reach_round_the_globe_but_in_libasterix() -> None:
    block = bytes.fromhex("19 000d 0108 20000000 f0000000")
    assert decode(block)[0].get("I025/600") == {"LAT": 22.5, "LON": -22.5}
    assert decode(block, AS_LIBASTERIX)[0].get("I025/600") == {"LAT": 22.5, "LON": -11.25}


@pytest.mark.parametrize("vector", VECTORS, ids=lambda v: f"{int(v['block'][:2], 16):03}")
def test_what_comes_often_is_read_as_what_comes_once(vector: dict[str, Any]) -> None:
    block = bytes.fromhex(vector["block"])
    first, *others = decode(block * (2 * OFTEN + 1), AS_LIBASTERIX)
    for other in others[::OFTEN]:
        assert (other.items, list(other.items)) == (first.items, list(first.items))
        assert other.octets == first.octets


@pytest.mark.parametrize("vector", VECTORS, ids=lambda v: f"{int(v['block'][:2], 16):03}")
def test_what_comes_often_and_is_cut_off_says_the_same(vector: dict[str, Any]) -> None:
    block = bytes.fromhex(vector["block"])
    category, body = AS_LIBASTERIX[block[0]], block[3:]
    decode(block * (OFTEN + 1), AS_LIBASTERIX)
    for length in range(1, len(body), 7):
        with pytest.raises(DecodeError) as expected:
            record_by_rule(category, body[:length])
        with pytest.raises(DecodeError, match=re.escape(str(expected.value))):
            list(records_in(Block(block[0], body[:length], 0), AS_LIBASTERIX))


def octets(item: Item) -> str:
    """How long an item is, as tables say it."""
    match item:
        case Fixed(_, group):
            return f"{group.octets}"
        case Extended(_, groups):
            return f"{groups[0].octets}+FX"
        case Repetitive(_, group):
            return f"{group.octets}+FX" if group.fx else f"1+{group.octets}n"
        case _:
            return "1+n"


@pytest.mark.parametrize("layout", CATEGORIES.values(), ids=lambda layout: f"{layout.number:03d}")
def test_items_are_as_long_as_their_table_states(layout: Category) -> None:
    """Whose parts alone are read; a radar's two categories are one file, and those of tracks."""
    place = {34: 48, 63: 62}.get(layout.number, layout.number)
    source = inspect.getsource(import_module(f"plotfeed.proto.asterix.cat{place:03d}"))
    stated = re.findall(rf"^(\d+) +(I{layout.number:03d}/\w+) +(\S+)", source, re.MULTILINE)
    found = [(f"{n}", item.name, octets(item)) for n, item in enumerate(layout.uap, 1) if item]
    assert set(stated) >= set(found)


def test_a_row_stands_in_for_that_of_another_edition() -> None:
    first = category(1, "1 I001/010 1 A 8\n2 I001/020 1 B 8")
    second = category(1, "2 I001/020 1 B ±8: 1/4 m", base=first)
    assert second.uap[0] == first.uap[0]
    (part,) = second.uap[1].group.parts  # type: ignore[union-attr]
    assert (part.bits, part.signed, part.lsb, part.unit) == (8, True, 0.25, "m")  # type: ignore[union-attr]


@pytest.mark.parametrize("parts", ["A 8 9", "A ±8: 1 m often", "A 8;B 8", ""])
def test_what_is_not_in_the_notation_is_refused(parts: str) -> None:
    with pytest.raises(ValueError, match="no part"):
        category(1, f"1    I001/010  1       {parts}.")


@pytest.mark.parametrize("row", ["I001/020 1 B 8", "2 I001/020 B", "2 I001 1 B 8"])
def test_a_row_that_is_none_is_refused(row: str) -> None:
    with pytest.raises(ValueError, match="no row"):
        category(1, f"1 I001/010 1 A 8\n{row}")


def test_parts_must_fill_octets() -> None:
    with pytest.raises(ValueError, match="9 bits"):
        Group((Raw("A", 8), Spare(1)))


def test_a_part_knows_its_place() -> None:
    group = Group((Spare(2), Raw("A", 3), Raw("B", 2)), fx=True)
    assert [(part.name, right) for part, right in group.fields] == [("A", 3), ("B", 1)]
