from __future__ import annotations

import tracemalloc
from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.link.counters import LATENESS_KEPT, LastLateness, lateness_us

PARTS = st.tuples(st.integers(-(2**62), 2**62), st.integers(0, 300))


@given(st.integers(1, 100), st.lists(st.one_of(PARTS, st.none()), max_size=20))
def test_the_last_are_kept_in_order(most: int, parts: list[tuple[int, int] | None]) -> None:
    kept, expected = LastLateness(most), deque[int](maxlen=most)
    for part in parts:
        if part is None:
            kept.clear()
            expected.clear()
        else:
            value, times = part
            kept.append(value, times)
            expected.extend([value] * times)
        assert len(kept) == len(expected)
        assert list(kept) == list(kept.values()) == list(expected)


@given(
    st.lists(st.integers(-(10**12), 10**12), min_size=1, max_size=50),
    st.lists(st.floats(0, 100), min_size=1, max_size=4),
)
def test_percentiles_are_those_of_numpy(values: list[int], percentiles: list[float]) -> None:
    kept = LastLateness(len(values))
    assert lateness_us(kept, *percentiles) == [0.0] * len(percentiles)
    for value in (10**12, *values):  # which gives way
        kept.append(value)
    expected = np.percentile(values, percentiles) / 1e3
    for given_as in (values, kept):
        found = lateness_us(given_as, *percentiles)
        assert found == pytest.approx(expected.tolist(), rel=1e-9, abs=1e-5)


def test_it_takes_no_more_memory_than_twice_its_room() -> None:
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        kept = LastLateness()
        for value in range(10**9, 10**9 + 500):
            kept.append(value, LATENESS_KEPT // 100)
            kept.append(value)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 8 * 2.3 * LATENESS_KEPT  # arrays grow by an eighth ahead of need
    assert len(kept) == LATENESS_KEPT


def test_what_is_no_integer_of_64_bits_is_an_error() -> None:
    with pytest.raises(OverflowError):
        LastLateness().append(2**70)
