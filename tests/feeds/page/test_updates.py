from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.page_updates import read_frame

from plotfeed.feeds.page.updates import (
    COUNT_MASK,
    LAYOUTS,
    SectionKind,
    UpdateFlag,
    header,
    news,
    section,
)


def table(kind: SectionKind, rows: int, seed: int) -> dict[str, Any]:
    """Any octets at all, as the columns of a layout."""
    rng = np.random.default_rng(seed)
    return {
        name: np.frombuffer(rng.bytes(rows * np.dtype(dtype).itemsize), dtype)
        for name, dtype in LAYOUTS[kind]
    }


@given(
    st.sampled_from(list(LAYOUTS)),
    st.integers(1, 40),
    st.integers(0, 1 << 32),
    st.integers(0, 1 << 40),
)
def test_what_is_written_is_read(kind: SectionKind, rows: int, seed: int, first: int) -> None:
    columns = table(kind, rows, seed)
    (read,) = read_frame(header(7, 0) + section(kind, columns, first)).sections
    assert (read.kind, read.first) == (kind, first & COUNT_MASK)
    assert read.columns.keys() == columns.keys()
    for name, column in columns.items():
        np.testing.assert_array_equal(read.columns[name], column)


@given(st.lists(st.tuples(st.sampled_from(list(LAYOUTS)), st.integers(1, 5)), max_size=6))
def test_sections_follow_each_other_and_columns_lie_where_typed_arrays_may(
    kinds: list[tuple[SectionKind, int]],
) -> None:
    data = header(1, 0)
    for kind, rows in kinds:
        data += news(b'{"a":1}')
        data += section(kind, {name: np.ones(rows) for name, _ in LAYOUTS[kind]})
    assert len(data) % 8 == 0
    frame = read_frame(data)
    assert [s.kind for s in frame.sections[1::2]] == [kind for kind, _ in kinds]
    assert [s.rows for s in frame.sections[1::2]] == [rows for _, rows in kinds]
    assert all(s.news == {"a": 1} for s in frame.sections[::2])


def test_the_header_says_when_it_is_to_the_microsecond_and_what_the_frame_is() -> None:
    frame = read_frame(header(1 << 60, 1_700_000_000_123_456_789, UpdateFlag.SNAPSHOT))
    assert frame.is_snapshot
    assert frame.number == 1 << 60
    assert abs(frame.now_ms - 1_700_000_000_123.4568) < 1e-3
    assert not read_frame(header(1, 0)).is_snapshot


@pytest.mark.parametrize("kind", list(LAYOUTS))
def test_no_rows_take_no_room(kind: SectionKind) -> None:
    assert section(kind, {name: [] for name, _ in LAYOUTS[kind]}) == b""


def test_news_are_utf_8() -> None:
    text = json.dumps({"refusal": "höhe"}, ensure_ascii=False).encode()
    assert read_frame(header(1, 0) + news(text)).news == {"refusal": "höhe"}


def test_columns_of_different_lengths_are_no_section() -> None:
    columns = {name: np.ones(2) for name, _ in LAYOUTS[SectionKind.TRACKS]} | {"track": np.ones(3)}
    with pytest.raises(ValueError, match="equally long"):
        section(SectionKind.TRACKS, columns)
