from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.formats.sapient.sapient_node import MIN_GAP_NS, Groups
from plotfeed.models.beam import Sector, Timetable
from plotfeed.proto.sapient.envelope import stamp_ns

schedules = st.tuples(
    st.integers(20_000_000, 5_000_000_000), st.sampled_from([1, 1, 4, 7, 8, 31, 32, 100, 256])
)
times = st.integers(1_000_000_000, 1_800_000_000).map(lambda s: s * 1_000_000_000)


def sectors(t_utc_ns: int, period_ns: int, count: int, n: int) -> list[Sector]:
    found = [Timetable(period_ns, count).sector_at(t_utc_ns)]
    while len(found) < n:
        found.append(Timetable(period_ns, count).next_sector(found[-1]))
    return found


@given(schedules, times)
def test_stamps_are_80_ms_apart_whatever_the_scan(schedule: tuple[int, int], t_ns: int) -> None:
    period_ns, count = schedule
    groups = Groups(period_ns, count)
    ends = [
        stamp_ns(sector.end_ns)
        for sector in sectors(t_ns, period_ns, count, 6 * groups.size)
        if groups.ends_with(sector)
    ]
    assert len(ends) in (5, 6)
    assert all(b - a >= MIN_GAP_NS for a, b in pairwise(ends))


@given(schedules, times)
def test_no_detection_waits_for_longer_than_it_must(schedule: tuple[int, int], t_ns: int) -> None:
    """A group is as short as the rule allows, but for a sector where rounding would break it."""
    period_ns, count = schedule
    groups = Groups(period_ns, count)
    fewest = -(-MIN_GAP_NS * count // period_ns)
    assert fewest <= groups.size <= fewest + 1
    run = sectors(t_ns, period_ns, count, 3 * groups.size)
    for sector in run:
        last = next((s for s in run if groups.ends_with(s) and s.end_ns >= sector.end_ns), None)
        if last is not None:
            assert last.end_ns - sector.start_ns <= groups.longest_ns + 1
            assert groups.number(last) == groups.number(sector)


def test_a_turn_a_second_in_32_sectors_goes_out_in_threes() -> None:
    assert Groups(1_000_000_000, 32).size == 3
    assert Groups(1_000_000_000, 1).size == 1
    assert Groups(80_000_000, 1).size == 1
    assert Groups(20_000_000, 1).size == 4
    assert Groups(560_000_007, 7).size == 2  # rounding might take the last nanosecond of 80 ms
