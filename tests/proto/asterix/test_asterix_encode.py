from __future__ import annotations

import math
import random
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.asterix_input import every_path, numeric_slots, text_constants
from support.asterix_rule import of_quantity

from plotfeed.proto.asterix.cat048 import CAT048
from plotfeed.proto.asterix.cat062 import CAT062
from plotfeed.proto.asterix.cat205 import CAT205
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.asterix.codec.encode import Encoder, blocks_of, profile
from plotfeed.proto.asterix.codec.layout import (
    DAY_LSB,
    Category,
    Fixed,
    Group,
    Overflow,
    Quantity,
    Raw,
    Spare,
    category,
)
from plotfeed.proto.errors import EncodeError

MANY = 45
RHO, THETA, TIME, HEIGHT = "I048/040/RHO", "I048/040/THETA", "I048/140", "I048/110"
EVERYTHING = {
    c.number: Encoder(c, every_path(c), constants=text_constants(c)) for c in CATEGORIES.values()
}


def row_by_row(encoder: Encoder, columns: Mapping[str, Any]) -> bytes:
    """The records, each encoded by itself, of values that are no arrays."""
    rows = zip(*(columns[path] for path in encoder.columns), strict=True)
    return b"".join(encoder.records(dict(zip(encoder.columns, row, strict=True))) for row in rows)


def encoded(encoder: Encoder, columns: Mapping[str, list[Any]]) -> bytes:
    """The records, which are the same one by one, often, and from arrays."""
    few = encoder.records(columns)
    repeats = -(-MANY // (len(few) // encoder.record_length))
    many = encoder.records({path: list(c) * repeats for path, c in columns.items()})
    assert many == few * repeats
    arrays = {path: np.array(list(c) * repeats) for path, c in columns.items()}
    assert encoder.records(arrays) == many
    assert row_by_row(encoder, columns) == few
    return few


def decoded(encoder: Encoder, path: str, value: Any) -> Any:
    """One value there and back, the other columns being 0."""
    columns: dict[str, list[Any]] = {column: [0] for column in encoder.columns}
    records = encoded(encoder, columns | {path: [value]})
    blocks = blocks_of(encoder.category, records, encoder.record_length)
    return decode(blocks[0])[0].get(path)


def refused(encoder: Encoder, path: str, value: Any) -> None:
    columns: dict[str, Any] = dict.fromkeys(encoder.columns, 0) | {path: value}
    last = encoder.columns[-1]
    for more in ({}, {last: [columns[last]]}, {last: [columns[last]] * MANY}):
        with pytest.raises(EncodeError) as caught:
            encoder.records(columns | more)
        assert caught.value.field == path


@pytest.mark.parametrize("category", CATEGORIES.values(), ids=lambda c: f"{c.number:03}")
@pytest.mark.parametrize("seed", range(12))
def test_every_item_comes_back_as_it_went(category: Category, seed: int) -> None:
    encoder = EVERYTHING[category.number]
    draw = random.Random(seed)  # noqa: S311 - not for secrets
    columns: dict[str, list[Any]] = {}
    for slot in numeric_slots(category):
        part = slot.part
        assert isinstance(part, Raw | Quantity)
        low, high = part.limits
        if isinstance(part, Quantity) and part.modulus:
            high = part.modulus - 1
        drawn = [draw.choice([low, high, 0, draw.randint(low, high)]) for _ in range(2)]
        columns[slot.path] = [
            of_quantity(part, n) if isinstance(part, Quantity) else n for n in drawn
        ]
    assert tuple(columns) == encoder.columns
    records = encoded(encoder, columns)
    texts = text_constants(category)
    for row, record in enumerate(
        decode(blocks_of(encoder.category, records, len(records) // 2)[0])
    ):
        assert {path: record.get(path) for path in encoder.columns} == {
            path: values[row] for path, values in columns.items()
        }
        assert {path: record.get(path) for path in texts} == texts


POSITION = Encoder(
    CAT048, (TIME, "I048/040", HEIGHT, "I048/120/CAL", "I048/161"), constants={"I048/120/CAL/D": 0}
)


@given(st.floats(0, 256, exclude_max=True))
@example(65535.5 / 256)
def test_ranges_come_back_to_half_an_lsb(rho: float) -> None:
    if rho < 65535.5 / 256:
        assert abs(decoded(POSITION, RHO, rho) - rho) <= 0.5 / 256
    else:
        assert decoded(POSITION, RHO, rho) == 65535 / 256


@given(st.floats(-1e4, 1e4))
@example(359.999)
@example(360.0)
@example(-0.0)
def test_angles_come_back_round_the_circle_to_half_an_lsb(theta: float) -> None:
    back = decoded(POSITION, THETA, theta)
    assert 0 <= back < 360
    assert abs(math.remainder(back - theta, 360)) <= 180 / 65536 + 1e-9


@given(st.floats(-1e6, 1e6))
@example(-8192 * 25.0)
@example(8191 * 25.0)
def test_heights_come_back_to_half_an_lsb_or_saturate(height_ft: float) -> None:
    back = decoded(POSITION, HEIGHT, height_ft)
    clipped = min(max(height_ft, -8192 * 25), 8191 * 25)
    assert abs(back - clipped) <= 12.5


@pytest.mark.parametrize(
    ("path", "value", "expected"),
    [
        (RHO, 300.0, 65535 / 256),
        (RHO, 1e300, 65535 / 256),
        (RHO, -1.0, 0.0),
        (THETA, 359.999, 0.0),
        (THETA, 360.0, 0.0),
        (THETA, -90.0, 270.0),
        (THETA, 1e300, 0.0),
        (TIME, 86_399.998, 0.0),
        (TIME, 86_399.99, 86_399.9921875),
        (TIME, 86_400.0, 0.0),
        (TIME, -1.0, 86_399.0),
        ("I048/120/CAL/CAL", -600.0, -512.0),
        ("I048/120/CAL/CAL", 600.0, 511.0),
        ("I048/120/CAL/CAL", -1.0, -1.0),
        (HEIGHT, -12.5, 0.0),  # a tie goes to the even multiple
        (HEIGHT, 37.5, 50.0),
        (HEIGHT, 62.5, 50.0),
        (HEIGHT, -25.0, -25.0),
    ],
)
def test_edges(path: str, value: float, expected: float) -> None:
    assert decoded(POSITION, path, value) == expected


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("path", [RHO, THETA, TIME, HEIGHT])
def test_what_is_not_finite_is_refused(path: str, value: float) -> None:
    refused(POSITION, path, value)


@pytest.mark.parametrize("value", [-1, 4096, 1.5, "7", None])
def test_what_a_number_cannot_be_is_refused(value: Any) -> None:
    refused(POSITION, "I048/161", value)


def test_one_bad_row_of_many_is_found() -> None:
    for rows in (5, MANY):
        height = np.zeros(rows)
        height[3] = np.nan
        columns = dict.fromkeys(POSITION.columns, 0) | {HEIGHT: height}
        with pytest.raises(EncodeError) as caught:
            POSITION.records(columns)
        assert caught.value.field == HEIGHT


NANOSECONDS = Encoder(CAT048, (TIME,), lsb={TIME: 7_812_500})


@given(st.integers(0, 2**62), st.sampled_from([0, 3_906_249, 3_906_250, 3_906_251]))
def test_time_from_nanoseconds_is_exact(start: int, rest: int) -> None:
    t_ns = start // 7_812_500 * 7_812_500 + rest
    records = encoded(NANOSECONDS, {TIME: [t_ns]})
    expected = round(Fraction(t_ns, 7_812_500)) % DAY_LSB
    assert int.from_bytes(records[-3:], "big") == expected


@given(st.integers(1, 2000), st.integers(0, 10**9))
def test_integer_columns_of_any_lsb_round_half_to_even(lsb: int, value: int) -> None:
    encoder = Encoder(CAT048, (TIME,), lsb={TIME: lsb})
    records = encoded(encoder, {TIME: [value]})
    assert int.from_bytes(records[-3:], "big") == round(Fraction(value, lsb)) % DAY_LSB


def test_integer_columns_refuse_floats() -> None:
    refused(NANOSECONDS, TIME, 1e9)


@given(n=st.sampled_from([1, 2, 39, 200]), seed=st.integers(0, 2**32 - 1))
def test_arrays_lists_and_single_values_give_the_same_octets(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns: dict[str, Any] = {
        TIME: rng.uniform(-1e5, 1e6, n),
        RHO: rng.uniform(-10, 300, n),
        THETA: rng.uniform(-720, 720, n),
        HEIGHT: rng.uniform(-3e5, 3e5, n),
        "I048/120/CAL/CAL": rng.uniform(-700, 700, n),
        "I048/161": rng.integers(0, 4096, n),
    }
    records = POSITION.records(columns)
    assert records == POSITION.records({path: c.tolist() for path, c in columns.items()})
    assert records == row_by_row(POSITION, {path: c.tolist() for path, c in columns.items()})


def test_one_number_stands_for_all_rows() -> None:
    for rows in (3, MANY):
        given_once = dict.fromkeys(POSITION.columns, 1) | {RHO: np.full(rows, 2.0)}
        spelt_out = {path: np.full(rows, v) for path, v in given_once.items() if path != RHO}
        assert POSITION.records(given_once) == POSITION.records(spelt_out | {RHO: given_once[RHO]})


def test_no_rows_make_no_octets() -> None:
    assert POSITION.records({path: [] for path in POSITION.columns}) == b""


def test_columns_must_be_there_and_equally_long() -> None:
    with pytest.raises(EncodeError, match="I048/140: a column is missing"):
        POSITION.records({})
    with pytest.raises(EncodeError, match="different lengths"):
        POSITION.records({path: [1] for path in POSITION.columns} | {RHO: [1, 2]})
    with pytest.raises(EncodeError):
        POSITION.records({path: np.zeros((MANY, 2)) for path in POSITION.columns})


def test_profiles_refuse_what_they_cannot_hold() -> None:
    for path in ("I048/999", "I048/130/XXX", "I048/030", "I048/120/RDS", "I048/130", "I048/SP"):
        with pytest.raises(EncodeError) as caught:
            Encoder(CAT048, ("I048/010", path))
        assert caught.value.field == path
    with pytest.raises(EncodeError, match="no such part"):
        Encoder(CAT048, ("I048/010",), constants={"I048/161": 1})
    with pytest.raises(EncodeError, match="I048/010/SAC: 256 is not within 0 to 255"):
        Encoder(CAT048, ("I048/010",), constants={"I048/010/SAC": 256})
    for text in ("SHORT", "lowercas"):
        with pytest.raises(EncodeError, match="I048/240"):
            Encoder(CAT048, ("I048/240",), constants={"I048/240": text})


def test_a_profile_of_constants_alone_is_one_record() -> None:
    source = Encoder(CAT048, ("I048/010",), constants={"I048/010/SAC": 1, "I048/010/SIC": 2})
    assert source.records({}) == bytes([0x80, 1, 2])


def test_extended_items_go_as_far_as_the_parts_that_are_chosen() -> None:
    two_groups = Encoder(CAT048, ("I048/020", "I048/020/ME"))
    values = dict.fromkeys(two_groups.columns, 0) | {"I048/020/ME": 1, "I048/020/TYP": 7}
    assert two_groups.records(values) == bytes([0x20, 0xE1, 0x10])


@pytest.mark.parametrize("bits", range(1, 57))
def test_parts_of_any_width_may_straddle_words(bits: int) -> None:
    before = Raw("BEFORE", 8 + -bits % 8)
    middle = Quantity("MIDDLE", bits, signed=bits > 1, overflow=Overflow.SATURATE)
    category = Category(1, (Fixed("I001/000", Group((Spare(8), before, middle, Raw("AFTER", 8)))),))
    encoder = Encoder(category, ("I001/000",))
    low, high = middle.limits
    for value in {low, high, 0, high // 3}:
        exact = float(value) if abs(value) < 2**53 else value
        if float(exact) != value:
            continue
        records = encoded(
            encoder,
            {"I001/000/BEFORE": [5], "I001/000/MIDDLE": [float(value)], "I001/000/AFTER": [9]},
        )
        (record,) = decode(blocks_of(1, records, len(records))[0], {1: category})
        assert record.get("I001/000") == {"BEFORE": 5, "MIDDLE": value, "AFTER": 9}


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
        "I001/010/0/A",
        "I001/010/0/B",
        "I001/010/1/A",
        "I001/010/1/B",
        "I001/020/0",
        "I001/020/1",
    ]
    encoder = Encoder(REPEATING, ("I001/010*2", "I001/020*2"))
    record = encoder.records(dict(zip(paths, (1, 2, 3, 4, 5, 6), strict=True)))
    assert record == bytes([0xC0, 2, 0x12, 0x34, 0x0B, 0x0C])
    (back,) = decode(blocks_of(1, record, len(record))[0], {1: REPEATING})
    assert [back.get(path) for path in paths] == [1, 2, 3, 4, 5, 6]
    assert back.get("I001/010/2/A") is None
    assert back.get("I001/010/x") is None


def test_no_members_are_a_count_of_0() -> None:
    assert Encoder(REPEATING, ("I001/010*0",)).records({}) == bytes([0x80, 0])


@pytest.mark.parametrize("path", ["I001/010", "I001/010*256", "I001/010*x", "I001/020*0"])
def test_a_repetition_says_how_often(path: str) -> None:
    with pytest.raises(EncodeError):
        Encoder(REPEATING, (path,))


def test_extended_subfields_of_compound_items_go_as_far_as_asked() -> None:
    encoder = Encoder(CAT062, ("I062/380/TIS", "I062/380/ADR"))
    record = encoder.records(dict(zip(encoder.columns, (0xABCDEF, 1, 0), strict=True)))
    assert record == bytes([0x01, 0x10, 0x81, 0x80, 0xAB, 0xCD, 0xEF, 0x80])
    assert encoder.columns == ("I062/380/ADR", "I062/380/TIS/NAV", "I062/380/TIS/NVB")


CHANNEL = Encoder(CAT205, ("I205/040", "I205/090"))


@pytest.mark.parametrize("n", [1, 200])
def test_text_is_a_column_too(n: int) -> None:
    names = [f"{row:07}" for row in range(n)]
    numbers = [row % 256 for row in range(n)]
    for column in (names, np.array(names), np.array(names, np.object_)):
        records = CHANNEL.records({"I205/040": numbers, "I205/090": column})
        assert records == b"".join(
            bytes([0x0C, number]) + name.encode()
            for number, name in zip(numbers, names, strict=True)
        )
    one_name = CHANNEL.records({"I205/040": numbers, "I205/090": "2437.00"})
    assert one_name == b"".join(bytes([0x0C, number]) + b"2437.00" for number in numbers)


@pytest.mark.parametrize("name", ["short", "too long", "2437.0\u20ac", 5, None])
def test_text_that_does_not_fit_is_refused(name: object) -> None:
    with pytest.raises(EncodeError, match="I205/090"):
        CHANNEL.records({"I205/040": 1, "I205/090": name})


def test_a_number_of_any_kind_stands_for_all_records() -> None:
    expected = CHANNEL.records({"I205/040": [7, 7], "I205/090": ["2437.00"] * 2})
    for one in (7, np.int64(7), np.array(7)):
        assert CHANNEL.records({"I205/040": one, "I205/090": ["2437.00"] * 2}) == expected
