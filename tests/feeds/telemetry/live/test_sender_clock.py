"""What senders say of their time becomes UTC, however wrong their clocks or ours are."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.live.mavlink import SenderClock

S = 1_000_000_000
NOW = 1_767_225_600 * S


def test_a_good_utc_is_taken_to_the_nanosecond() -> None:
    clock = SenderClock()
    clock.declare(NOW - 50 * S, 50 * S)
    assert clock.utc_ns(60 * S, NOW + 10 * S + 30_000_000) == NOW + 10 * S
    assert not clock.is_off


@given(st.integers(-(10**6), 10**6).filter(lambda s: abs(s) > 1), st.integers(0, 400))
def test_a_wrong_utc_is_not_and_positions_are_of_the_least_delay(off_s: int, seed: int) -> None:
    clock = SenderClock()
    clock.declare(NOW + off_s * S, 0)
    delays = np.random.default_rng(seed).exponential(0.2, 50)
    delays[0] = 0.05
    arrivals_ns = np.maximum.accumulate([i * S // 10 + round(d * S) for i, d in enumerate(delays)])
    for i, arrival_ns in enumerate(arrivals_ns.tolist()):
        t_ns = NOW + i * S // 10
        found = clock.utc_ns(i * S // 10, NOW + arrival_ns)
        assert 0 <= found - t_ns <= 50_000_000
    assert clock.is_off
    assert abs(clock.off_s + off_s) < 1


def test_a_clock_that_begins_anew_is_learned_anew() -> None:
    clock = SenderClock()
    clock.declare(NOW - 500 * S, 500 * S)
    clock.utc_ns(500 * S, NOW)
    assert clock.utc_ns(2 * S, NOW + 10 * S) == NOW + 10 * S  # it has said nothing of its UTC yet
    clock.declare(NOW + 8 * S, 3 * S)
    assert clock.utc_ns(3 * S, NOW + 11 * S + 20_000_000) == NOW + 11 * S


@given(st.integers(-7200, 7200), st.booleans())
def test_when_a_clock_jumps_positions_are_of_now_again_within_seconds(
    jump_s: int, ours: bool
) -> None:
    clock = SenderClock()
    late = []
    for i in range(300):
        jumped = jump_s * S * (i >= 100)
        now_ns = NOW + i * S // 10 + jumped * ours
        count_ns = 10_000 * S + i * S // 10 + jumped * (not ours)
        late.append(abs(clock.utc_ns(count_ns, now_ns) - now_ns))
    assert max(late[:100]) == 0
    assert max(late[-80:]) == 0


def test_drift_is_followed() -> None:
    """A clock that loses 100 ppm is not off by more after an hour than after ten seconds."""
    clock = SenderClock()
    for i in range(36_000):
        now_ns = NOW + i * S // 10
        late_ns = now_ns - clock.utc_ns(round(i * S / 10 * (1 - 1e-4)), now_ns)
        assert 0 <= late_ns <= 1_100_000
