from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.mcap.channels import properties_of_json, properties_to_json

PAIRS = st.lists(st.tuples(st.text(), st.text())).map(tuple)


@given(PAIRS)
def test_properties_come_back_in_their_order(pairs: tuple[tuple[str, str], ...]) -> None:
    assert properties_of_json(properties_to_json(pairs)) == pairs


@given(st.dictionaries(st.text(), st.text()))
def test_without_a_name_twice_it_is_the_object_that_anybody_would_write(
    names: dict[str, str],
) -> None:
    data = properties_to_json(tuple(names.items()))
    assert json.loads(data) == names
    assert data == json.dumps(names, ensure_ascii=False, separators=(",", ":")).encode()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{",
        b"\xff",
        b"7",
        b'"a"',
        b"{} ",
        b'{"a": 1}',
        b'[["a", "b", "c"]]',
        b'[["a", 1]]',
        b'["ab"]',
        b"[" * 100_000,
        b"9" * 10_000,
    ],
)
def test_anything_else_is_an_error(data: bytes) -> None:
    with pytest.raises(DecodeError, match="user properties: expected"):
        properties_of_json(data)
