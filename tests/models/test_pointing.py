"""How mounts turn: by closed forms, in any steps, and within their bounds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.cueing import (
    Aim,
    Motor,
    Mount,
    Pointing,
    at_rest,
    from_mount,
    moved,
    slew_s,
    to_mount,
)
from plotfeed.models.frames import aer_to_enu, enu_to_aer, wrap_180, wrap_360

NS = 1_000_000_000
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
HOME = at_rest(Aim(pan_deg=0.0, tilt_deg=0.0, field_deg=20.0), 0)


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
    assert slew_s(HOME, aim(turn_deg), MOUNT) == pytest.approx(expected_s)
    there = later(HOME, aim(turn_deg), expected_s + 1e-6)
    assert (there.pan_deg, there.pan_rate_deg_s) == pytest.approx((turn_deg, 0.0))
    before = later(HOME, aim(turn_deg), expected_s / 2)
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
    state = HOME
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
