from __future__ import annotations

import numpy as np
import pytest

from plotfeed.proto.asterix.cat062 import CAT062
from plotfeed.proto.asterix.cat205 import CAT205
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.asterix.codec.encode import Encoder, blocks_of, profile
from plotfeed.proto.asterix.codec.layout import category
from plotfeed.proto.errors import EncodeError

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
