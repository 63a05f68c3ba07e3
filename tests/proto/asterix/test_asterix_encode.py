"""Values to octets and back, by the layouts of all categories."""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.asterix_input import every_path, numeric_slots, text_constants
from support.asterix_rule import of_quantity

from plotfeed.proto.asterix.cat048 import CAT048
from plotfeed.proto.asterix.cat062 import CAT062
from plotfeed.proto.asterix.cat205 import CAT205
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import decode
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
from plotfeed.proto.errors import EncodeError

TIME, HEIGHT, TRACK = "I048/140", "I048/110", "I048/161"


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
