from __future__ import annotations

import asyncio

import pytest

from plotfeed.feeds.page.updates import MAX_QUEUED, MAX_QUEUED_OCTETS, Update, Viewer

SNAPSHOT = Update(b"all", b"+true", True)


def update(number: int, octets: int = 4) -> Update:
    return Update(number.to_bytes(octets, "big"), b"!", False)


async def taken(viewer: Viewer, count: int) -> list[bytes]:
    return [await viewer.next() for _ in range(count)]


async def has_next(viewer: Viewer) -> bool:
    try:
        await asyncio.wait_for(viewer.next(), 0.01)
    except TimeoutError:
        return False
    return True


@pytest.mark.asyncio
async def test_a_viewer_begins_with_a_snapshot_and_goes_on_with_updates() -> None:
    viewer = Viewer(lambda: SNAPSHOT)
    viewer.offer(update(1))  # the snapshot holds it already
    assert await viewer.next() == b"all"
    for number in (2, 3):
        viewer.offer(update(number))
    assert await taken(viewer, 2) == [update(2).public, update(3).public]
    assert not await has_next(viewer)


@pytest.mark.asyncio
async def test_a_slow_viewer_drops_what_waits_and_makes_up_by_a_snapshot() -> None:
    viewer = Viewer(lambda: SNAPSHOT)
    await viewer.next()
    for number in range(MAX_QUEUED + 6):
        viewer.offer(update(number))
    made_up = await viewer.next()
    assert made_up.startswith(b"all")
    assert f'{{"missed_updates": {MAX_QUEUED + 6}}}'.encode() in made_up
    assert not await has_next(viewer)
    viewer.offer(update(99))
    assert await viewer.next() == update(99).public


@pytest.mark.asyncio
async def test_what_waits_for_a_viewer_is_bounded_in_octets_too() -> None:
    viewer = Viewer(lambda: SNAPSHOT)
    await viewer.next()
    viewer.offer(update(1, MAX_QUEUED_OCTETS + 1))
    assert b'"missed_updates": 1' in await viewer.next()
    viewer.start_again()  # as when another scene begins: nothing was missed
    assert await viewer.next() == b"all"


@pytest.mark.parametrize("shown", [True, False])
@pytest.mark.asyncio
async def test_the_truth_comes_with_a_snapshot_and_goes_with_one(shown: bool) -> None:
    viewer = Viewer(lambda: SNAPSHOT)
    viewer.show_truth(shown=not shown)
    await viewer.next()
    viewer.offer(update(1))
    viewer.show_truth(shown=shown)
    assert await viewer.next() == (b"all+true" if shown else b"all")
    viewer.offer(update(2))
    assert await viewer.next() == update(2).public + (b"!" if shown else b"")
    viewer.show_truth(shown=shown)  # no news
    assert not await has_next(viewer)
