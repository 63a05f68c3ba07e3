"""Octets to records, whatever they are, and the tables that say how."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.asterix_input import flags_of, slots_octets
from support.asterix_rule import record_by_rule

from plotfeed.proto.asterix.cat025 import CAT025_HALF_TURN
from plotfeed.proto.asterix.cat062 import CAT062_1_18
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec import decode as readers
from plotfeed.proto.asterix.codec.decode import Block, blocks, decode, decode_lenient, records_in
from plotfeed.proto.asterix.codec.layout import Category, Group, Raw, Spare, category
from plotfeed.proto.errors import DecodeError

# Written by hand from the layout: FSPEC, then the items in the order of their numbers.
PLOT = bytes.fromhex("f30108 1903 000640 30 01800718 1817ba 3fff")
EVERY_CATEGORY = pytest.mark.parametrize("layout", CATEGORIES.values(), ids=lambda c: f"{c.number}")


def block(number: int, body: bytes) -> bytes:
    return bytes([number]) + (len(body) + 3).to_bytes(2, "big") + body


VALID = block(48, PLOT * 2) + block(34, bytes.fromhex("e8 1903 01 0c8000 0080"))
BY_HAND: list[tuple[int, str, dict[str, Any]]] = [
    (48, PLOT.hex(), {
        "I048/010": {"SAC": 25, "SIC": 3},
        "I048/140": 12.5,
        "I048/020": {"TYP": 1, "SIM": 1, "RDP": 0, "SPI": 0, "RAB": 0},
        "I048/040": {"RHO": 1.5, "THETA": 0x0718 * 360 / 65536},
        "I048/130": {"PRL": 23 * 360 / 8192, "PAM": -70.0},
        "I048/110": -25.0,
    }),
    (48, "01 01 40 0f 04", {"I048/030": [7, 2]}),
    (48, "01 20 00", {"I048/250": []}),
    (25, "01 80 ff" + "07" * 255, {"I025/105": [7] * 255}),
    (48, "01 01 04 c0 83ff 01 0001 0002 0003", {"I048/120": {
        "CAL": {"D": 1, "CAL": -1.0}, "RDS": [{"DOP": 1.0, "AMB": 2.0, "FRQ": 3.0}],
    }}),
    (48, "01 01 01 06 03abcd 01", {"I048/SP": b"\xab\xcd", "I048/RE": b""}),
]  # fmt: skip


@pytest.mark.parametrize(("number", "octets", "items"), BY_HAND)
def test_octets_say_what_was_worked_out_by_hand(
    number: int, octets: str, items: dict[str, Any]
) -> None:
    (record,) = decode(block(number, bytes.fromhex(octets)))
    assert record.items == items


def test_an_extended_item_longer_than_its_layout_is_kept() -> None:
    (record,) = decode(block(48, bytes.fromhex("20 21 01 01 01 01 01 ab cc")))
    item = record.items["I048/020"]
    assert isinstance(item, dict)
    assert (item["TYP"], item["IRMACTVAL"], item["FURTHER"]) == (1, 0, b"\xab\xcc")


def test_paths_reach_into_items_and_records_lie_where_they_say() -> None:
    first, second, north = decode(VALID)
    assert first.items == second.items
    assert (first.octets, first.at_octet, second.at_octet) == (PLOT, 3, 3 + len(PLOT))
    found = [first.get(path) for path in ("I048/040/RHO", "I048/140", "I048/161", "I048/140/RHO")]
    assert found == [1.5, 12.5, None, None]
    assert north.items["I034/041"] == 1.0
    assert [(b.category, b.at_octet) for b in blocks(VALID)] == [(48, 3), (34, 6 + 2 * len(PLOT))]


def test_unknown_categories_keep_their_octets() -> None:
    record, plot, _ = decode(block(247, b"\x01\x02") + block(48, PLOT * 2))
    assert (record.category, record.items, record.octets) == (247, {}, b"\x01\x02")
    assert plot.category == 48


def test_editions_differ_where_they_are_said_to() -> None:
    height = bytes.fromhex("3e 000a 01010102 20 ffff")  # below 0 from edition 1.19 on
    assert decode(height)[0].get("I062/340/HEIGHT") == -25.0
    assert decode(height, {62: CAT062_1_18})[0].get("I062/340/HEIGHT") == 65535 * 25.0
    place = bytes.fromhex("19 000d 0108 20000000 f0000000")
    assert decode(place)[0].get("I025/600") == {"LAT": 22.5, "LON": -22.5}
    (half_turn,) = decode(place, {25: CAT025_HALF_TURN})
    assert half_turn.get("I025/600") == {"LAT": 22.5, "LON": -11.25}


@pytest.mark.parametrize(
    ("data", "at_octet"),
    [
        ("30", 0),
        ("300002", 1),
        ("300004", 1),
        ("300004 00", 4),  # no item at all
        ("300004 80", 4),  # the item is missing
        ("300006 8019 03 30 0004 01", 10),
        ("300006 010101", 6),  # flags without end
        ("300008 0101010180", 7),  # a fifth octet of flags, and no item for it
        ("220006 0201 20", 5),  # a flag of I034/050 that is not assigned
        ("300007 01010104", 7),  # SP without its length
        ("300008 0101010400", 7),  # SP of length 0
        ("300008 0101010405", 8),
        ("300006 0120ff", 6),  # a count without its members
        ("300005 2021", 5),  # an extension that does not come
        ("220007 0180 ff 00", 6),  # a count that outnumbers the input
    ],
)
def test_what_is_broken_is_refused_at_its_octet(data: str, at_octet: int) -> None:
    with pytest.raises(DecodeError) as caught:
        decode(bytes.fromhex(data))
    assert caught.value.at_octet == at_octet


def test_a_broken_record_costs_the_rest_of_its_block_alone() -> None:
    broken = block(48, PLOT + PLOT[:-1])
    records, errors = decode_lenient(VALID + broken + VALID + b"\x30\x00")
    assert [record.category for record in records] == [48, 48, 34, 48, 48, 48, 34]
    assert [error.at_octet for error in errors] == [
        len(VALID) + 3 + 2 * len(PLOT) - 2,
        2 * len(VALID) + len(broken),
    ]


@given(st.binary(max_size=400), st.sampled_from(sorted(CATEGORIES)))
def test_any_body_gives_records_that_lie_where_they_say(body: bytes, number: int) -> None:
    data = block(number, body)
    records, errors = decode_lenient(data)
    at = 3
    for record in records:
        assert record.at_octet == at
        assert data[at : at + len(record.octets)] == record.octets
        at += len(record.octets)
    assert errors or at == len(data)


@EVERY_CATEGORY
@given(data=st.data())
def test_compiled_readers_read_what_the_rule_reads(layout: Category, data: st.DataObject) -> None:
    # Flags of items that are there, so that most of what is drawn is read to its end.
    wanted = data.draw(st.sets(st.sampled_from([n for n, i in enumerate(layout.uap) if i])))
    body = flags_of(wanted) + data.draw(st.binary(max_size=400) | st.just(bytes(400)))
    try:
        items, end = record_by_rule(layout, body)
    except DecodeError as error:
        with pytest.raises(DecodeError) as caught:
            next(records_in(Block(layout.number, body, 0)))
        assert (str(caught.value), caught.value.at_octet) == (str(error), error.at_octet)
        return
    record = next(records_in(Block(layout.number, body, 0)))
    assert (record.items, list(record.items)) == (items, list(items))
    assert record.octets == body[:end]


@EVERY_CATEGORY
@given(st.integers(0, 1 << 32))
def test_what_comes_often_is_read_as_what_comes_once(layout: Category, seed: int) -> None:
    """By a reader that is compiled for its flags; what is cut off is no record for it either."""
    body = slots_octets(layout.uap, Random(seed))  # noqa: S311
    items, end = record_by_rule(layout, body)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(readers, "OFTEN", 2)
        plans = readers.Plans(layout.uap)
        for _ in range(4):
            found, at = plans.read(body, 0)
            assert (found, list(found), at) == (items, list(items), end)
        for length in range(1, len(body), 5):
            with contextlib.suppress(*readers.BROKEN):
                assert plans.read(body[:length], 0)[1] > length


@given(st.lists(st.binary(min_size=2, max_size=6), max_size=30))
def test_plans_of_flags_are_bounded(bodies: list[bytes]) -> None:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(readers, "MAX_PLANS", 2)
        patched.setattr(readers, "OFTEN", 2)
        plans = readers.Plans(CATEGORIES[48].uap)
        for body in [*bodies, *[b"\x80\x01\x02"] * 3, *[b"\x40abc"] * 3, *[b"\x08abc"] * 3]:
            with contextlib.suppress(*readers.BROKEN):
                plans.read(body, 0)
            assert len(plans._readers) <= 2
        assert plans.read(b"\x80\x01\x02", 0) == ({"I048/010": {"SAC": 1, "SIC": 2}}, 3)


def test_decoding_loads_no_numpy() -> None:
    # It takes longer to load than fifty thousand records take to read.
    code = "import sys, plotfeed.proto.asterix.codec.decode; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_row_stands_in_for_that_of_another_edition() -> None:
    first = category(1, "1 I001/010 1 A 8\n2 I001/020 1 B 8")
    second = category(1, "2 I001/020 1 B ±8: 1/4 m", base=first)
    assert second.uap[0] == first.uap[0]
    (part,) = second.uap[1].group.parts  # type: ignore[union-attr]
    assert (part.bits, part.signed, part.lsb, part.unit) == (8, True, 0.25, "m")  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("row", "said"),
    [
        *((f"1    I001/010  1       {parts}.", "no part")
          for parts in ("A 8 9", "A ±8: 1 m often", "A 8;B 8", "")),
        *((f"1 I001/010 1 A 8\n{row}", "no row")
          for row in ("I001/020 1 B 8", "2 I001/020 B", "2 I001 1 B 8")),
        ("1 I001/010 1 A 9, _1", "10 bits"),
    ],
)  # fmt: skip
def test_what_is_not_in_the_notation_is_refused(row: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        category(1, row)


def test_a_part_knows_its_place() -> None:
    group = Group((Spare(2), Raw("A", 3), Raw("B", 2)), fx=True)
    assert [(part.name, right) for part, right in group.fields] == [("A", 3), ("B", 1)]
