"""What a mount decides by cues: whom it follows, who is next, and when it goes home."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.cueing import (
    HOME,
    Aim,
    CueBatch,
    CuedState,
    CueRule,
    Motor,
    Mount,
    Pointing,
    advanced,
    after_dwell,
    after_plots,
    at_rest,
    from_mount,
    moved,
    slew_s,
    to_mount,
    turned_to,
)
from plotfeed.models.frames import aer_to_enu, enu_to_aer, wrap_180, wrap_360

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


# How mounts turn: by closed forms, in any steps, and within their bounds.


RATE, ACCELERATION = 60.0, 120.0
MOUNT = Mount(
    pan=Motor(rate_deg_s=RATE, acceleration_deg_s2=ACCELERATION),
    tilt=Motor(rate_deg_s=30.0, acceleration_deg_s2=60.0),
    tilt_min_deg=-30.0,
    tilt_max_deg=90.0,
    settle_s=0.3,
    field_min_deg=2.0,
    field_max_deg=60.0,
    zoom_s=3.0,
)
RESTING = at_rest(Aim(pan_deg=0.0, tilt_deg=0.0, field_deg=20.0), 0)


def aim(pan_deg: float = 0.0, tilt_deg: float = 0.0, field_deg: float = 20.0) -> Aim:
    return Aim(pan_deg=pan_deg, tilt_deg=tilt_deg, field_deg=field_deg)


def later(state: Pointing, to: Aim, dt_s: float) -> Pointing:
    return moved(state, to, MOUNT, state.t_utc_ns + round(dt_s * NS))


@pytest.mark.parametrize("turn_deg", [0.5, 10.0, 29.0, 30.0, 31.0, 90.0, 179.0])
def test_a_turn_from_rest_takes_the_closed_form(turn_deg: float) -> None:
    long = turn_deg >= RATE**2 / ACCELERATION
    expected_s = (
        turn_deg / RATE + RATE / ACCELERATION if long else 2 * np.sqrt(turn_deg / ACCELERATION)
    )
    assert slew_s(RESTING, aim(turn_deg), MOUNT) == pytest.approx(expected_s)
    there = later(RESTING, aim(turn_deg), expected_s + 1e-6)
    assert (there.pan_deg, there.pan_rate_deg_s) == pytest.approx((turn_deg, 0.0))
    before = later(RESTING, aim(turn_deg), expected_s / 2)
    assert before.pan_deg == pytest.approx(turn_deg / 2)


def test_a_turn_goes_the_shorter_way_round() -> None:
    state = later(at_rest(aim(350.0), 0), aim(20.0), 0.1)
    assert 350.0 < state.pan_deg < 360.0
    assert later(state, aim(20.0), 10.0).pan_deg == pytest.approx(20.0)


def test_zoom_is_even_in_the_logarithm() -> None:
    wide, narrow = at_rest(aim(field_deg=60.0), 0), aim(field_deg=2.0)
    assert slew_s(wide, narrow, MOUNT) == pytest.approx(3.0)
    assert later(wide, narrow, 1.5).field_deg == pytest.approx(np.sqrt(120.0))
    assert later(wide, narrow, 3.1).field_deg == 2.0


angles = st.floats(-180, 180)
tilts = st.floats(-30, 90)
steps = st.lists(st.tuples(angles, tilts, st.floats(2, 60), st.floats(0.001, 3)), max_size=4)


@given(steps, angles, tilts, st.floats(0.001, 4.0), st.floats(0.0, 1.0))
def test_two_steps_are_one_and_bounds_hold(
    before: list[tuple[float, float, float, float]],
    pan_deg: float,
    tilt_deg: float,
    dt_s: float,
    share: float,
) -> None:
    """Whatever it was doing before: turning elsewhere, or just slowing down."""
    state = RESTING
    for a, b, field_deg, wait_s in before:
        state = later(state, aim(a, b, field_deg), wait_s)
        assert abs(state.pan_rate_deg_s) <= RATE * (1 + 1e-12)
        assert abs(state.tilt_rate_deg_s) <= 30.0 * (1 + 1e-12)
    to = aim(pan_deg, tilt_deg, 5.0)
    if abs(abs(float(wrap_180(pan_deg - state.pan_deg))) - 180.0) < 1.0:
        return  # either way is as short
    end_ns = state.t_utc_ns + round(dt_s * NS)
    middle_ns = state.t_utc_ns + round(share * dt_s * NS)
    one, half = moved(state, to, MOUNT, end_ns), moved(state, to, MOUNT, middle_ns)
    if abs(float(wrap_180(pan_deg - half.pan_deg))) > 179.0:
        return
    two = moved(half, to, MOUNT, end_ns)
    assert abs(float(wrap_180(one.pan_deg - two.pan_deg))) < 1e-4
    assert one.tilt_deg == pytest.approx(two.tilt_deg, abs=1e-4)
    assert one.field_deg == pytest.approx(two.field_deg)
    arrived = later(state, to, slew_s(state, to, MOUNT) + 1e-3)
    assert abs(float(wrap_180(arrived.pan_deg - pan_deg))) < 1e-4
    assert arrived.tilt_deg == pytest.approx(tilt_deg, abs=1e-4)


def test_what_mount_and_lens_cannot_have_is_the_nearest() -> None:
    found = MOUNT.reachable(aim(-10.0, -80.0, 0.5))
    assert found == aim(350.0, -30.0, 2.0)


@given(angles, tilts, st.floats(0, 360), st.floats(-89, 89))
def test_directions_come_back_from_the_mounts_axes(
    pan_deg: float, tilt_deg: float, azimuth_deg: float, elevation_deg: float
) -> None:
    place = aer_to_enu([azimuth_deg], [elevation_deg], [800.0])
    own = enu_to_aer(to_mount(place, pan_deg, tilt_deg))
    back = from_mount(own[0], own[1], pan_deg, tilt_deg)
    np.testing.assert_allclose(aer_to_enu(*back, [800.0]), place, atol=1e-9 * 800)


def test_what_it_points_at_is_north_of_a_mount() -> None:
    own = enu_to_aer(to_mount(aer_to_enu([123.0], [40.0], [800.0]), 123.0, 40.0))
    assert float(wrap_360(own[0] + 90.0)[0]) == pytest.approx(90.0)
    assert own[1][0] == pytest.approx(0.0, abs=1e-9)
