from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.replay.pacing import Laps, Pace, lap_period_ns, speed_of

S = 1_000_000_000
START = 1_767_268_800 * S
RECORDED = st.integers(START - 10**15, START + 10**15)
CLOCK = st.integers(START, START + 10**15)
SPEEDS = st.floats(0.001, 10_000).map(speed_of)
PACES = st.builds(Pace, recorded_ns=RECORDED, due_ns=CLOCK, speed=SPEEDS)


@given(PACES, RECORDED)
def test_what_is_due_is_within_a_nanosecond_of_the_line(pace: Pace, recorded_ns: int) -> None:
    exact = pace.due_ns + Fraction(recorded_ns - pace.recorded_ns) / pace.speed
    assert 0 <= exact - pace.due(recorded_ns) < 1


@given(PACES, CLOCK)
def test_the_position_is_the_latest_that_is_due(pace: Pace, now_ns: int) -> None:
    position_ns = pace.position(now_ns)
    assert pace.due(position_ns) <= now_ns < pace.due(position_ns + 1)


@given(PACES, CLOCK, st.integers(0, 10**15), RECORDED)
def test_a_pause_is_left_out_of_the_line(
    pace: Pace, now_ns: int, for_ns: int, recorded_ns: int
) -> None:
    paused = pace.pause(now_ns)
    assert paused.paused
    assert paused.position(now_ns + for_ns) == pace.position(now_ns)
    resumed = paused.resume(now_ns + for_ns)
    # What had left before the pause is due before it ends, the rest after it, and as much later.
    assert (resumed.due(recorded_ns) <= now_ns + for_ns) == (pace.due(recorded_ns) <= now_ns)
    late_ns = resumed.due(recorded_ns) - pace.due(recorded_ns) - for_ns
    assert abs(late_ns) <= 1 + 1 / pace.speed


@given(PACES, SPEEDS, CLOCK, st.integers(1, 10**12))
def test_another_speed_goes_on_where_the_first_left_off(
    pace: Pace, speed: Fraction, now_ns: int, on_ns: int
) -> None:
    other = pace.at_speed(speed, now_ns)
    assert other.position(now_ns) >= pace.position(now_ns)
    assert other.due(pace.position(now_ns)) == now_ns
    ahead_ns = other.due(pace.position(now_ns) + on_ns) - now_ns
    assert 0 <= Fraction(on_ns) / speed - ahead_ns < 1


@given(PACES, RECORDED, CLOCK, st.booleans())
def test_a_seek_begins_with_that_time(
    pace: Pace, recorded_ns: int, now_ns: int, paused: bool
) -> None:
    if paused:
        pace = pace.pause(now_ns)
    sought = pace.seek(recorded_ns, now_ns)
    assert sought.paused == paused
    begun = sought.resume(now_ns)
    assert begun.due(recorded_ns) in (now_ns, now_ns + int(1 / pace.speed))
    assert begun.due(recorded_ns - 1) < now_ns or paused
    if paused:
        assert sought.position(now_ns + S) == recorded_ns - 1


def test_a_paused_pace_can_be_given_another_speed_and_another_place() -> None:
    paused = Pace(recorded_ns=START, due_ns=START).pause(START + S)
    assert paused.pause(START + 9 * S).position(0) == START + S
    faster = paused.at_speed(Fraction(2), START + 5 * S)
    assert faster.paused
    assert faster.resume(START + 6 * S).due(START + 3 * S) == START + 7 * S


def test_speeds_are_what_was_written_within_limits() -> None:
    for factor in (0.1, 1.5, 0.001, 10_000, 3):
        assert speed_of(factor) == Fraction(str(factor))
    for factor in (0, -1, 0.0009, 10_001, float("nan"), float("inf")):
        with pytest.raises(ValueError, match=r"expected 0\.001 to 10000"):
            speed_of(factor)


@given(st.integers(0, 50), st.integers(0, 10**12), st.integers(1, 10**12))
def test_a_time_in_a_lap_is_found_again(lap: int, since_ns: int, period_ns: int) -> None:
    laps = Laps(begin_ns=START, period_ns=period_ns)
    recorded_ns = START + since_ns % period_ns
    assert laps.rolled(laps.unrolled(lap, recorded_ns)) == (lap, recorded_ns)
    before_ns = START - 5 * period_ns  # what lies before the beginning is in the first lap
    assert laps.rolled(before_ns) == (0, before_ns)


@given(st.integers(2, 1000), st.integers(1, 10**10), st.integers(0, 10**12))
def test_a_regular_feed_stays_regular_over_the_seam(n: int, step_ns: int, silence_ns: int) -> None:
    times = [START + silence_ns + i * step_ns for i in range(n)]
    laps = Laps(begin_ns=START, period_ns=lap_period_ns(START, times[0], times[-1], n))
    assert laps.unrolled(1, times[0]) - times[-1] == silence_ns + step_ns
    assert lap_period_ns(START, START, START, n) == S  # messages of one time
