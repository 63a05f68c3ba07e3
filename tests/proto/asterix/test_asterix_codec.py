"""Octets to records, whatever they are, values to octets and back, and tables that say how."""

from __future__ import annotations

import contextlib
import math
import subprocess
import sys
from collections.abc import Mapping
from fractions import Fraction
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.asterix_input import every_path, numeric_slots, slots_octets, text_constants

from plotfeed.proto.asterix.cat025 import CAT025_HALF_TURN
from plotfeed.proto.asterix.cat048 import CAT048
from plotfeed.proto.asterix.cat062 import CAT062, CAT062_1_18
from plotfeed.proto.asterix.cat205 import CAT205
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec import decode as readers
from plotfeed.proto.asterix.codec.decode import blocks, decode, decode_lenient
from plotfeed.proto.asterix.codec.encode import Encoder, Parts, Reports, blocks_of, profile
from plotfeed.proto.asterix.codec.layout import (
    DAY_LSB,
    Category,
    Fixed,
    Group,
    Named,
    Overflow,
    Quantity,
    Raw,
    Spare,
    category,
)
from plotfeed.proto.errors import DecodeError, EncodeError

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
        ("30000f 0130 01 0000000000000000 01", 14),  # behind counted members, half an item
        ("300009 010160 0f04 01", 8),  # likewise behind members that flags end
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
@given(st.integers(0, 1 << 32))
def test_what_comes_often_is_read_as_what_comes_once(layout: Category, seed: int) -> None:
    """By a reader that is compiled for its flags; what is cut off is no record for it either."""
    body = slots_octets(layout.uap, Random(seed))  # noqa: S311
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(readers, "OFTEN", 2)
        plans = readers.Plans(layout.uap)
        items, end = plans.read(body, 0)
        assert end == len(body)
        for _ in range(3):
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


TIME, HEIGHT, TRACK = "I048/140", "I048/110", "I048/161"


def of_quantity(part: Quantity, sent: int) -> float:
    """The float nearest to what an integer stands for."""
    return sent / part.divisor if part.divisor else sent * float(part.lsb)


def drawn(part: Named, rng: Random) -> tuple[Any, Any]:
    """A value, within its limits or beyond them where it may be, and what must be read of it."""
    assert isinstance(part, Raw | Quantity)
    low, high = part.limits
    number = rng.choice([low, high, 0, rng.randint(low, high)])
    if isinstance(part, Raw):
        return number, number
    modulus = part.modulus or 1 << part.bits
    step = float(part.lsb)
    if part.overflow is Overflow.REFUSE or part.bits > 48:  # which a float just holds
        return of_quantity(part, number), of_quantity(part, number)
    number += rng.choice([0, 0, rng.randint(-3 * modulus, 3 * modulus)])
    value = (number + rng.choice([0.0, 0.3, -0.3, 0.49, -0.49])) * step
    if part.overflow is not Overflow.WRAP:
        return value, of_quantity(part, min(max(number, low), high))
    sent = number % modulus
    return value, of_quantity(part, sent if sent <= high else sent - modulus)


@given(
    st.sampled_from(list(CATEGORIES.values())),
    st.sampled_from([1, 2, 3, 40]),
    st.integers(1, 3),
    st.integers(0, 1 << 32),
)
def test_every_value_comes_back_as_its_part_has_it(
    layout: Category, n: int, sources: int, seed: int
) -> None:
    """Rounded, wrapped or saturated; of several sources in one go as of each by itself."""
    rng = Random(seed)  # noqa: S311
    paths, texts = every_path(layout), text_constants(layout)
    slots = numeric_slots(layout)
    stamped = {slot.path for slot in slots[1:] if rng.random() < 0.3}  # one tells how many rows
    columns, constants, expected = {}, {}, {}
    for slot in slots:
        rows = sources if slot.path in stamped else n
        values, back = zip(*(drawn(slot.part, rng) for _ in range(rows)), strict=True)
        (constants if slot.path in stamped else columns)[slot.path] = list(values)
        expected[slot.path] = back
    of = [rng.randrange(sources) for _ in range(n)]
    encoder = Encoder(layout, paths, constants=texts | constants)
    assert encoder.columns == tuple(columns)
    records = encoder.records(columns, np.array(of))
    assert encoder.records({path: np.array(c) for path, c in columns.items()}, np.array(of)) == (
        records
    )
    each = [
        Encoder(layout, paths, constants=texts | {p: c[i] for p, c in constants.items()})
        for i in range(sources)
    ]
    apart = [
        each[source].records({path: column[row] for path, column in columns.items()})
        for row, source in enumerate(of)
    ]
    assert records == b"".join(apart)
    for row, octets in enumerate(apart):
        (block,) = blocks_of(layout.number, octets, len(octets), 65_535)
        (record,) = decode(block)
        assert {path: record.get(path) for path in (*expected, *texts)} == {
            path: back[of[row] if path in stamped else row] for path, back in expected.items()
        } | texts


POSITION = Encoder(
    CAT048, (TIME, "I048/040", HEIGHT, "I048/120/CAL", TRACK), constants={"I048/120/CAL/D": 0}
)


def read_back(encoder: Encoder, path: str, value: Any) -> Any:
    """One value there and back, the other columns being 0."""
    octets = encoder.records(dict.fromkeys(encoder.columns, 0) | {path: value})
    return decode(blocks_of(encoder.category, octets, len(octets))[0])[0].get(path)


@pytest.mark.parametrize(
    ("path", "value", "expected"),
    [
        ("I048/040/RHO", 1e300, 65535 / 256),
        ("I048/040/THETA", 1e300, 0.0),
        ("I048/040/THETA", -0.0, 0.0),
        (TIME, 86_399.998, 0.0),
        (TIME, -1.0, 86_399.0),
        (HEIGHT, -12.5, 0.0),  # a tie goes to the even multiple
        (HEIGHT, 37.5, 50.0),
        (HEIGHT, 62.5, 50.0),
    ],
)
def test_edges(path: str, value: float, expected: float) -> None:
    assert read_back(POSITION, path, value) == expected


@given(st.sampled_from([1, 3, 1000, 7_812_500]), st.integers(0, 2**62), st.booleans())
def test_time_from_nanoseconds_is_exact(lsb: int, value: int, tie: bool) -> None:
    value = value // lsb * lsb + lsb // 2 if tie else value
    records = Encoder(CAT048, (TIME,), lsb={TIME: lsb}).records({TIME: [value]})
    assert int.from_bytes(records[-3:], "big") == round(Fraction(value, lsb)) % DAY_LSB


NANOSECONDS = Encoder(CAT048, (TIME,), lsb={TIME: 7_812_500})


@pytest.mark.parametrize(
    ("encoder", "path", "value"),
    [
        *((POSITION, path, wrong) for path in ("I048/040/RHO", "I048/040/THETA", TIME, HEIGHT)
          for wrong in (math.nan, math.inf, -math.inf)),
        *((POSITION, TRACK, wrong) for wrong in (-1, 4096, 1.5, "7", None)),
        (NANOSECONDS, TIME, 1e9),
    ],
)  # fmt: skip
def test_what_a_part_cannot_be_is_refused_by_its_path(
    encoder: Encoder, path: str, value: Any
) -> None:
    zeros: dict[str, Any] = dict.fromkeys(encoder.columns, 0)
    last = encoder.columns[-1]
    for columns in (zeros | {path: value}, zeros | {last: [0] * 5} | {path: [0, 0, 0, value, 0]}):
        with pytest.raises(EncodeError) as caught:
            encoder.records(columns)
        assert caught.value.field == path


def test_one_number_of_any_kind_stands_for_all_rows() -> None:
    one: Mapping[str, Any]
    for one in ({TRACK: 7}, {TRACK: np.int64(7)}, {TRACK: np.array(7)}):
        columns = {path: np.ones(3) for path in POSITION.columns}
        spelt_out = columns | {TRACK: np.full(3, 7)}
        assert POSITION.records(columns | dict(one)) == POSITION.records(spelt_out)


def test_columns_must_be_there_and_equally_long() -> None:
    assert POSITION.records({path: [] for path in POSITION.columns}) == b""
    with pytest.raises(EncodeError, match="I048/140: a column is missing"):
        POSITION.records({})
    with pytest.raises(EncodeError, match="different lengths"):
        POSITION.records({path: [1] for path in POSITION.columns} | {TIME: [1, 2]})
    with pytest.raises(EncodeError):
        POSITION.records({path: np.zeros((9, 2)) for path in POSITION.columns})


def test_profiles_refuse_what_they_cannot_hold() -> None:
    for path in ("I048/999", "I048/130/XXX", "I048/030", "I048/120/RDS", "I048/130", "I048/SP"):
        with pytest.raises(EncodeError) as caught:
            Encoder(CAT048, ("I048/010", path))
        assert caught.value.field == path
    for constants, said in (
        ({TRACK: 1}, "no such part"),
        ({"I048/010/SAC": 256}, "I048/010/SAC: 256 is not within 0 to 255"),
        ({"I048/010/SAC": [1, 2, 3], "I048/010/SIC": [3, 4]}, r"constants of \[2, 3\] sources"),
    ):
        with pytest.raises(EncodeError, match=said):
            Encoder(CAT048, ("I048/010",), constants=constants)
    for text in ("SHORT", "lowercas"):
        with pytest.raises(EncodeError, match="I048/240"):
            Encoder(CAT048, ("I048/240",), constants={"I048/240": text})


def test_extended_items_go_as_far_as_the_parts_that_are_chosen() -> None:
    two_groups = Encoder(CAT048, ("I048/020", "I048/020/ME"))
    values = dict.fromkeys(two_groups.columns, 0) | {"I048/020/ME": 1, "I048/020/TYP": 7}
    assert two_groups.records(values) == bytes([0x20, 0xE1, 0x10])
    of_both = Encoder(CAT048, ("I048/020/TYP", "I048/020/ME"))
    assert of_both.records(values) == bytes([0x20, 0xE1, 0x10])
    subfields = Encoder(CAT062, ("I062/380/TIS", "I062/380/ADR"))
    record = subfields.records(dict(zip(subfields.columns, (0xABCDEF, 1, 0), strict=True)))
    assert record == bytes([0x01, 0x10, 0x81, 0x80, 0xAB, 0xCD, 0xEF, 0x80])
    assert subfields.columns == ("I062/380/ADR", "I062/380/TIS/NAV", "I062/380/TIS/NVB")


@pytest.mark.parametrize("bits", range(1, 57))
def test_parts_of_any_width_may_straddle_words(bits: int) -> None:
    before = Raw("BEFORE", 8 + -bits % 8)
    middle = Quantity("MIDDLE", bits, signed=bits > 1, overflow=Overflow.SATURATE)
    layout = Category(1, (Fixed("I001/000", Group((Spare(8), before, middle, Raw("AFTER", 8)))),))
    encoder = Encoder(layout, ("I001/000",))
    low, high = middle.limits
    for value in {low, high, 0, high // 3}:
        if int(float(value)) != value:
            continue
        record = encoder.records(dict(zip(encoder.columns, (5, float(value), 9), strict=True)))
        (back,) = decode(blocks_of(1, record, len(record))[0], {1: layout})
        assert back.get("I001/000") == {"BEFORE": 5, "MIDDLE": value, "AFTER": 9}


@given(st.integers(0, 300), st.integers(1, 60), st.integers(63, 300))
def test_blocks_hold_whole_records_and_keep_their_order(n: int, length: int, most: int) -> None:
    records = bytes(i % 251 for i in range(n * length))
    blocks = blocks_of(48, records, length, most)
    assert b"".join(block[3:] for block in blocks) == records
    for block in blocks:
        assert block[0] == 48
        assert int.from_bytes(block[1:3], "big") == len(block) <= most
        assert (len(block) - 3) % length == 0 < len(block) - 3
    assert all(len(block) + length > most for block in blocks[:-1])


def test_blocks_must_hold_a_record_and_fit_their_length() -> None:
    for most in (22, 65536):
        with pytest.raises(EncodeError, match="max_octets"):
            blocks_of(48, bytes(20), 20, most)
    with pytest.raises(EncodeError, match="max_octets"):
        Reports(CAT048, ("I048/010",), constants={"I048/010/SIC": [1, 2]}, max_octets=[1400, 5])
    assert [len(b) for b in blocks_of(48, bytes(20 * 4000), 20, 65535)] == [65523, 80003 - 65520]


REPEATING = category(
    1,
    """
1    I001/010  1+1n    repeated: A 4, B 4
2    I001/020  1+FX    repeated: C 7
""",
)


def test_members_of_repetitive_items_are_slots() -> None:
    paths = [slot.path for slot in profile(REPEATING, ("I001/010*2", "I001/020*2")).slots]
    assert paths == [
        *("I001/010/0/A", "I001/010/0/B", "I001/010/1/A", "I001/010/1/B"),
        *("I001/020/0", "I001/020/1"),
    ]
    encoder = Encoder(REPEATING, ("I001/010*2", "I001/020*2"))
    record = encoder.records(dict(zip(paths, (1, 2, 3, 4, 5, 6), strict=True)))
    assert record == bytes([0xC0, 2, 0x12, 0x34, 0x0B, 0x0C])
    (back,) = decode(blocks_of(1, record, len(record))[0], {1: REPEATING})
    assert [back.get(path) for path in paths] == [1, 2, 3, 4, 5, 6]
    assert [back.get(path) for path in ("I001/010/2/A", "I001/010/x")] == [None, None]
    assert Encoder(REPEATING, ("I001/010*0",)).records({}) == bytes([0x80, 0])
    for path in ("I001/010", "I001/010*256", "I001/010*x", "I001/020*0"):
        with pytest.raises(EncodeError):
            Encoder(REPEATING, (path,))


CHANNEL = Encoder(CAT205, ("I205/040", "I205/090"))


def test_text_is_a_column_too() -> None:
    names = ["0000001", "0000002", "0000003"]
    for column in (names, np.array(names), np.array(names, np.object_)):
        records = CHANNEL.records({"I205/040": [1, 2, 3], "I205/090": column})
        assert records == b"".join(b"\x0c" + bytes([n]) + b"000000%d" % n for n in (1, 2, 3))
    assert CHANNEL.records({"I205/040": [1, 2], "I205/090": "2437.00"}) == (
        b"\x0c\x012437.00\x0c\x022437.00"
    )
    for name in ("short", "too long", "2437.0\u20ac", 5, None):
        with pytest.raises(EncodeError, match="I205/090"):
            CHANNEL.records({"I205/040": 1, "I205/090": name})


def test_it_must_be_said_which_source_it_is() -> None:
    constants = {"I048/010/SAC": 25, "I048/010/SIC": [3, 4]}
    of_two = Encoder(CAT048, ("I048/010", TIME), constants=constants)
    with pytest.raises(EncodeError, match="which of 2 sources"):
        of_two.records({TIME: [1.0]})
    with pytest.raises(EncodeError, match="different lengths"):
        of_two.records({TIME: [1.0]}, np.array([0, 1]))
    records = of_two.records({TIME: 1.0}, np.array([1, 0, 1]))
    assert [records[i + 2] for i in (0, 6, 12)] == [4, 3, 4]


@given(
    st.lists(st.tuples(st.integers(0, 60), st.integers(0, 2)), min_size=1, max_size=9),
    st.lists(st.sampled_from([64, 200, 1400]), min_size=3, max_size=3),
)
def test_blocks_of_parts_are_those_of_each_by_itself(
    drawn_parts: list[tuple[int, int]], most: list[int]
) -> None:
    lengths, sources = np.array(drawn_parts).T
    by = np.concatenate([[0], np.cumsum(lengths)])
    times, sics = np.arange(by[-1]) * 10**9, [7, 8, 9]

    def reports(sic: Any, max_octets: Any) -> Reports:
        constants = {"I048/010/SAC": 1, "I048/010/SIC": sic}
        return Reports(CAT048, ("I048/010", TIME), constants=constants, max_octets=max_octets)

    together = reports(sics, most).blocks_by({TIME: times}, Parts(by, sources))
    alone = [
        reports(sics[source], most[source]).blocks_by(
            {TIME: times[by[i] : by[i + 1]]}, Parts.whole(int(lengths[i]))
        )[0]
        for i, source in enumerate(sources.tolist())
    ]
    assert together == [blocks if n else [] for blocks, n in zip(alone, lengths, strict=True)]
