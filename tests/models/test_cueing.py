"""What a mount decides by cues: whom it follows, who is next, and when it goes home."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plotfeed.models.cueing import (
    HOME,
    Aim,
    CueBatch,
    CuedState,
    CueRule,
    Motor,
    Mount,
    advanced,
    after_dwell,
    after_plots,
    at_rest,
    turned_to,
)

NS = 1_000_000_000
MOTOR = Motor(rate_deg_s=90.0, acceleration_deg_s2=180.0)
REST = Aim(pan_deg=0.0, tilt_deg=5.0, field_deg=10.0)
RULE = CueRule(
    mount=Mount(
        pan=MOTOR,
        tilt=MOTOR,
        tilt_min_deg=-30.0,
        tilt_max_deg=90.0,
        settle_s=0.5,
        field_min_deg=2.0,
        field_max_deg=10.0,
        zoom_s=0.0,
    ),
    home=REST,
    dwell_ns=2 * NS,
    max_age_ns=3 * NS,
)
START = CuedState(pointing=at_rest(REST, 0), aim=REST)


def batch(*pan_deg: float, t_s: float = 0.0) -> CueBatch:
    n = len(pan_deg)
    return CueBatch(
        t_utc_ns=round(t_s * NS),
        source="radar",
        pan_deg=np.array(pan_deg),
        tilt_deg=np.full(n, 5.0),
        field_deg=np.full(n, 4.0),
    )


def test_a_free_mount_turns_to_the_next_clockwise_and_knows_when_it_sees() -> None:
    state = after_plots(START, RULE, batch(350.0, 90.0, 40.0))
    assert (state.aim.pan_deg, state.source) == (40.0, "radar")
    turning_s = 2 * np.sqrt(40.0 / 180.0)
    assert state.settled_ns == round((turning_s + 0.5) * NS)
    assert state.until_ns == state.settled_ns + 2 * NS
    assert not advanced(state, RULE, state.settled_ns - 1).sees(state.settled_ns - 1)
    assert state.sees(state.settled_ns)


def test_it_follows_what_is_near_and_leaves_what_is_not() -> None:
    state = after_plots(START, RULE, batch(40.0))
    near = after_plots(state, RULE, batch(41.5, 90.0))
    assert near.aim.pan_deg == 41.5
    assert (near.settled_ns, near.until_ns) == (state.settled_ns, state.until_ns)
    assert after_plots(state, RULE, batch(90.0)) == state
    assert after_plots(state, RULE, batch()) == state


def test_after_its_dwell_the_others_have_their_turn() -> None:
    state, seen = START, []
    everyone = batch(10.0, 100.0, 200.0, t_s=60.0)
    state = replace(state, pointing=at_rest(REST, 60 * NS))
    for _ in range(6):
        state = after_dwell(state, RULE, everyone)
        seen.append(state.aim.pan_deg)
        state = replace(state, pointing=at_rest(state.aim, 60 * NS))
    assert seen == [10.0, 100.0, 200.0, 10.0, 100.0, 200.0]


def test_one_that_is_in_view_needs_no_settling() -> None:
    there = Aim(pan_deg=40.0, tilt_deg=5.0, field_deg=4.0)
    state = replace(START, pointing=at_rest(there, 9 * NS), aim=there, settled_ns=7, source="radar")
    again = after_dwell(state, RULE, batch(40.5, t_s=8.0))
    assert (again.settled_ns, again.until_ns) == (7, 11 * NS)


def test_old_plots_are_no_cues_and_it_goes_home() -> None:
    away = Aim(pan_deg=40.0, tilt_deg=5.0, field_deg=4.0)
    state = replace(START, pointing=at_rest(away, 9 * NS), aim=away, source="radar")
    for latest in (None, batch(80.0, t_s=5.9)):
        home = after_dwell(state, RULE, latest)
        assert (home.aim, home.source, home.until_ns) == (REST, HOME, None)


def test_plots_do_not_turn_away_what_somebody_asked_for() -> None:
    asked = Aim(pan_deg=120.0, tilt_deg=0.0, field_deg=3.0)
    state = turned_to(START, RULE, asked, "cue", 5 * NS, firm=True)
    assert after_plots(state, RULE, batch(120.5)) == state
