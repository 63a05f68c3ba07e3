"""What passes between the page and a browser: frames, and what waits for a viewer that is slow."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.page_updates import read_frame

from plotfeed.feeds.page.page_access import Audience
from plotfeed.feeds.page.updates import (
    COUNT_MASK,
    LAYOUTS,
    MAX_QUEUED,
    MAX_QUEUED_OCTETS,
    SectionKind,
    Update,
    UpdateFlag,
    Viewer,
    header,
    news,
    section,
)

SNAPSHOT = Update(b"all", b"+true", True)


def table(kind: SectionKind, rows: int, seed: int) -> dict[str, Any]:
    """Any octets at all, as the columns of a layout."""
    rng = np.random.default_rng(seed)
    return {
        name: np.frombuffer(rng.bytes(rows * np.dtype(dtype).itemsize), dtype)
        for name, dtype in LAYOUTS[kind]
    }


SECTIONS = st.tuples(
    st.sampled_from(list(LAYOUTS)), st.integers(0, 9), st.integers(0, 99), st.integers(0, 1 << 40)
)


@given(st.lists(SECTIONS, max_size=6))
def test_what_is_written_is_read_and_columns_lie_where_typed_arrays_may(
    written: list[tuple[SectionKind, int, int, int]],
) -> None:
    data = header(7, 0)
    for kind, rows, seed, first in written:
        data += news('{"a":"höhe"}'.encode()) + section(kind, table(kind, rows, seed), first)
    assert len(data) % 8 == 0
    sections = iter(read_frame(data).sections)
    for kind, rows, seed, first in written:
        assert next(sections).news == {"a": "höhe"}
        if not rows:  # which take no room
            continue
        read, expected = next(sections), table(kind, rows, seed)
        assert (read.kind, read.rows, read.first) == (kind, rows, first & COUNT_MASK)
        assert read.columns.keys() == expected.keys()
        for name, column in expected.items():
            np.testing.assert_array_equal(read.columns[name], column)
    assert next(sections, None) is None


def test_the_header_says_when_it_is_to_the_microsecond_and_what_the_frame_is() -> None:
    frame = read_frame(header(1 << 60, 1_700_000_000_123_456_789, UpdateFlag.SNAPSHOT))
    assert (frame.is_snapshot, frame.number) == (True, 1 << 60)
    assert abs(frame.now_ms - 1_700_000_000_123.4568) < 1e-3
    assert not read_frame(header(1, 0)).is_snapshot


def test_columns_of_different_lengths_are_no_section() -> None:
    columns = {name: np.ones(2) for name, _ in LAYOUTS[SectionKind.TRACKS]} | {"track": np.ones(3)}
    with pytest.raises(ValueError, match="equally long"):
        section(SectionKind.TRACKS, columns)


def update(number: int, octets: int = 4) -> Update:
    return Update(number.to_bytes(octets, "big"), b"!", False)


async def all_of(viewer: Viewer) -> list[bytes]:
    """What there is to send to it now."""
    found = []
    while True:
        try:
            found.append(await asyncio.wait_for(viewer.next(), 0.01))
        except TimeoutError:
            return found


@pytest.mark.asyncio
async def test_a_viewer_begins_with_a_snapshot_and_one_that_was_slow_goes_on_from_another() -> None:
    viewer = Viewer(lambda: SNAPSHOT, Audience())
    viewer.offer(update(1))  # the snapshot holds it already
    assert await all_of(viewer) == [b"all"]
    for number in range(MAX_QUEUED):
        viewer.offer(update(number))
    assert await all_of(viewer) == [update(number).public for number in range(MAX_QUEUED)]
    viewer.offer(update(99, MAX_QUEUED_OCTETS))
    assert await all_of(viewer) == [update(99, MAX_QUEUED_OCTETS).public]
    for missed, octets in ((MAX_QUEUED + 1, 4), (1, MAX_QUEUED_OCTETS + 1)):
        for number in range(missed):
            viewer.offer(update(number, octets))
        (made_up,) = await all_of(viewer)
        assert made_up.startswith(b"all")
        assert json.dumps({"missed_updates": missed}).encode() in made_up
    viewer.start_again()  # as when another scene begins: nothing was missed
    assert await all_of(viewer) == [b"all"]


@pytest.mark.parametrize("shown", [True, False])
@pytest.mark.asyncio
async def test_the_truth_comes_with_a_snapshot_and_goes_with_one(shown: bool) -> None:
    viewer = Viewer(lambda: SNAPSHOT, Audience())
    viewer.show_truth(shown=not shown)
    await viewer.next()
    viewer.offer(update(1))
    viewer.show_truth(shown=shown)
    viewer.offer(update(2))  # the snapshot holds it already
    assert await all_of(viewer) == [b"all+true" if shown else b"all"]
    viewer.offer(update(3))
    viewer.show_truth(shown=shown)  # no news
    assert await all_of(viewer) == [update(3).public + (b"!" if shown else b"")]
