from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.tracks import LivingTracks, TrackLives, TrackRule

S = 1_000_000_000
START_NS = 1_700_000_000 * S
DRONES = 3
HIT, MISS, ABSENT = "hit", "miss", "absent"

rules = st.integers(1, 8).flatmap(
    lambda window: st.builds(
        TrackRule,
        confirm_hits=st.integers(1, window),
        confirm_window=st.just(window),
        drop_misses=st.integers(1, 6),
        period_ns=st.just(S),
    )
)
scans = st.lists(
    st.tuples(*[st.sampled_from([HIT, HIT, HIT, MISS, MISS, ABSENT])] * DRONES), max_size=60
)


@dataclass
class Account:
    """One drone's, kept as the rule says it in words."""

    hits: deque[bool]
    track: int = 0
    misses: int = 0
    told: list[tuple[int, int, bool, bool]] = field(default_factory=list)


def feed(lives: TrackLives, scan: int, seen: tuple[str, ...], period_ns: int = S) -> LivingTracks:
    drone = np.array([d for d, what in enumerate(seen) if what != ABSENT], np.int64)
    hit = np.array([seen[d] == HIT for d in drone], np.bool_)
    end_ns = START_NS + (scan + 1) * period_ns
    times_ns = np.full(len(drone), end_ns)
    return lives.take(drone, times_ns, hit, start_ns=end_ns - period_ns, end_ns=end_ns)


@given(rules, scans)
def test_tracks_begin_and_end_as_the_rule_says(
    rule: TrackRule, seen: list[tuple[str, ...]]
) -> None:
    lives, newest = TrackLives(rule), 0
    accounts = [Account(deque(maxlen=rule.confirm_window)) for _ in range(DRONES)]
    for scan, looks in enumerate(seen):
        expected = []
        for drone, account in enumerate(accounts):
            hit = looks[drone] == HIT
            account.hits.append(hit)
            account.misses = 0 if hit else account.misses + 1
            first = not account.track and hit and sum(account.hits) >= rule.confirm_hits
            if first:
                newest += 1
                account.track = newest
            last = account.misses >= rule.drop_misses
            if account.track:
                expected.append((drone, account.track, account.misses, first, last))
            if account.track and last:
                account.track = 0
                account.hits.clear()
        told = feed(lives, scan, looks)
        columns = (told.drone, told.track, told.misses, told.first, told.last)
        assert list(zip(*(c.tolist() for c in columns), strict=True)) == expected


@given(rules, scans)
def test_a_life_has_one_number_a_beginning_and_an_end(
    rule: TrackRule, seen: list[tuple[str, ...]]
) -> None:
    lives = TrackLives(rule)
    of_track: dict[int, list[tuple[int, bool, bool]]] = {}
    for scan, looks in enumerate(seen):
        told = feed(lives, scan, looks)
        assert len(set(told.track.tolist())) == len(told)
        for row in range(len(told)):
            report = (int(told.drone[row]), bool(told.first[row]), bool(told.last[row]))
            of_track.setdefault(int(told.track[row]), []).append(report)
    assert list(of_track) == list(range(1, len(of_track) + 1))
    for reports in of_track.values():
        assert len({drone for drone, _, _ in reports}) == 1
        assert [first for _, first, _ in reports] == [True] + [False] * (len(reports) - 1)
        assert not any(last for _, _, last in reports[:-1])


@given(scans)
def test_a_drone_that_is_out_of_sight_is_one_that_is_missed(seen: list[tuple[str, ...]]) -> None:
    rule = TrackRule(confirm_hits=2, confirm_window=3, drop_misses=3, period_ns=S)
    one, other = TrackLives(rule), TrackLives(rule)
    for scan, looks in enumerate(seen):
        missed = tuple(MISS if what == ABSENT else what for what in looks)
        left, right = feed(one, scan, looks), feed(other, scan, missed)
        for name in ("drone", "track", "misses", "first", "last"):
            np.testing.assert_array_equal(getattr(left, name), getattr(right, name))


def test_nobody_looked_in_a_skipped_scan() -> None:
    rule = TrackRule(confirm_hits=2, confirm_window=3, drop_misses=2, period_ns=S)
    lives = TrackLives(rule)
    feed(lives, 0, (HIT,))
    assert feed(lives, 1, (HIT,)).first.tolist() == [True]
    for scan in (50, 51, 90):
        told = feed(lives, scan, (HIT,) if scan != 51 else (ABSENT,))
        assert told.track.tolist() == [1]
        assert not told.last.any()
        assert told.hit_utc_ns.tolist() == [START_NS + (51 if scan < 90 else 91) * S]


def test_a_beam_may_come_by_half_a_turn_late() -> None:
    rule = TrackRule(
        confirm_hits=1, confirm_window=1, drop_misses=2, period_ns=S, patience_ns=S // 2
    )
    lives = TrackLives(rule)
    told = [feed(lives, 0, (HIT,), S // 8)]
    told += [feed(lives, k, (ABSENT,), S // 8) for k in range(1, 30)]
    assert [k for k, t in enumerate(told) if len(t)] == [0, 12, 20]
    assert [t.misses.tolist() for t in told if len(t)] == [[0], [1], [2]]
    assert told[20].last.tolist() == [True]


def test_numbers_start_again_and_leave_out_those_in_use() -> None:
    rule = TrackRule(confirm_hits=1, confirm_window=1, drop_misses=1, period_ns=S, last_number=3)
    lives = TrackLives(rule)
    assert feed(lives, 0, (HIT, HIT)).track.tolist() == [1, 2]
    assert feed(lives, 1, (HIT, MISS)).track.tolist() == [1, 2]
    assert feed(lives, 2, (HIT, HIT, HIT, HIT)).track.tolist() == [1, 3, 2]  # and none is left
    assert feed(lives, 3, (MISS, HIT, HIT, MISS)).last.tolist() == [True, False, False]
    assert feed(lives, 4, (MISS, HIT, HIT, HIT)).track.tolist() == [3, 2, 1]


def test_drones_of_no_account_are_forgotten() -> None:
    rule = TrackRule(confirm_hits=2, confirm_window=3, drop_misses=2, period_ns=S)
    lives = TrackLives(rule)
    feed(lives, 0, (HIT, MISS, ABSENT))
    assert lives.drones.tolist() == [0]
    for scan in range(1, 4):
        feed(lives, scan, (MISS, MISS, MISS))
    assert lives.drones.tolist() == []
