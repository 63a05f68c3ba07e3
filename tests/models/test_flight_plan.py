"""Plans of flight keep their limits, end where they should, and follow the curved Earth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from plotfeed.models.flight_plan import (
    FlightKnots,
    FlightLimits,
    FlightPlan,
    level_from_ecef,
    level_to_ecef,
    level_velocity,
    to_ecef,
)
from plotfeed.models.frames import LocalFrame, ecef_to_geodetic
from plotfeed.models.state import NS, Floats
from plotfeed.models.truth import KnownTrack, TrackChain

LIMITS = FlightLimits(speed_m_s=18.0, climb_m_s=5.0, sink_m_s=3.0, acceleration_m_s2=2.5)
HOME = LocalFrame(40.45, -3.73, 650.0)
MANOEUVRES: dict[str, Callable[[FlightPlan], object]] = {
    "long way": lambda plan: plan.fly_to([5000.0, 900.0, 40.0]),
    "short way": lambda plan: plan.fly_to([1.0, 2.0, 0.5]),
    "climb": lambda plan: plan.fly_to([0.0, 0.0, 120.0]),
    "sink": lambda plan: plan.fly_to([30.0, 0.0, -120.0]),
    "orbit": lambda plan: plan.orbit([400.0, 0.0, 50.0], 60.0, turns=2.25),
    "other way round": lambda plan: plan.orbit([90.0, 0.0, 0.0], 900.0, is_clockwise=False),
    "tight orbit": lambda plan: plan.orbit([0.0, 0.0, 0.0], 2.0, turns=3.0, speed_m_s=1.0),
    "hover": lambda plan: plan.hover(12.0),
}


def sampled(knots: FlightKnots, step_s: float = 0.02) -> tuple[Floats, Floats, Floats]:
    """Positions, velocities and accelerations by differences along the cubics."""
    track = KnownTrack.smooth(
        [round(t * NS) for t in knots.t_s.tolist()], knots.position_m, knots.velocity_m_s
    )
    times = np.arange(0, track.t_utc_ns[-1] - 1, round(step_s * NS))
    places = np.array([track.segment_at(t).position_m(t) for t in times.tolist()])
    velocity = np.diff(places, axis=0) / step_s
    return places, velocity, np.diff(velocity, axis=0) / step_s


@pytest.mark.parametrize("name", MANOEUVRES)
def test_limits_are_kept_and_it_ends_at_rest(name: str) -> None:
    plan = FlightPlan(LIMITS, [0.0, 0.0, 0.0], [6.0, -3.0, 1.0])
    MANOEUVRES[name](plan)
    knots = plan.knots()
    assert (np.diff(knots.t_s) > 0).all()
    assert not knots.velocity_m_s[-1].any()
    _, velocity, acceleration = sampled(knots)
    assert np.linalg.norm(velocity, axis=1).max() <= LIMITS.speed_m_s * 1.001
    assert -LIMITS.sink_m_s * 1.001 <= velocity[:, 2].min()
    assert velocity[:, 2].max() <= LIMITS.climb_m_s * 1.001
    # A difference sees a change of acceleration between two cubics from both sides.
    assert np.linalg.norm(acceleration, axis=1).max() <= LIMITS.acceleration_m_s2 * 1.02


def test_a_way_takes_as_long_as_speeding_up_flying_and_braking_do() -> None:
    plan = FlightPlan(LIMITS, [0.0, 0.0, 10.0])
    plan.fly_to([1000.0, 0.0, 10.0], 10.0)
    assert plan.end_s == pytest.approx(1000.0 / 10.0 + 10.0 / 2.5, rel=1e-9)
    assert plan.place_m.tolist() == [1000.0, 0.0, 10.0]
    before_s = plan.end_s
    plan.fly_to([1001.0, 0.0, 10.0])  # too short to be fast
    assert plan.end_s - before_s == pytest.approx(2 * (1.0 / 2.5) ** 0.5, rel=1e-9)


def test_an_orbit_stays_on_its_circle_as_often_as_asked() -> None:
    plan = FlightPlan(LIMITS, [500.0, 0.0, 80.0])
    plan.orbit([0.0, 0.0, 80.0], 200.0, turns=1.5)
    places, velocity, _ = sampled(plan.knots(), 0.05)
    away_m = np.hypot(places[:, 0], places[:, 1])
    on_circle = np.flatnonzero(away_m < 200.001)[0]
    assert np.abs(away_m[on_circle:] - 200.0).max() < 200.0 / 20_000
    turned = np.unwrap(np.arctan2(places[on_circle:, 0], places[on_circle:, 1]))
    assert turned[-1] - turned[0] == pytest.approx(3 * np.pi, abs=1e-3)  # clockwise
    speed = np.linalg.norm(velocity, axis=1).max()
    assert speed == pytest.approx(LIMITS.orbit_speed_m_s(200.0), rel=1e-3)
    assert plan.place_m == pytest.approx([-200.0, 0.0, 80.0])


def test_a_drift_keeps_its_velocity_once_it_has_it() -> None:
    plan = FlightPlan(LIMITS, [0.0, 0.0, 0.0], [10.0, 0.0, 0.0])
    plan.drift([0.0, 30.0, 1.0], 600.0)
    knots = plan.knots()
    assert (knots.velocity_m_s[1:] == [0.0, 30.0, 1.0]).all()
    way_m = knots.position_m[-1] - knots.position_m[1]
    assert way_m == pytest.approx([0.0, 18_000.0, 600.0])


def test_flight_at_one_height_follows_the_curved_earth() -> None:
    plan = FlightPlan(LIMITS, [-20_000.0, 3000.0, 100.0])
    plan.fly_to([20_000.0, 3000.0, 100.0])
    knots = to_ecef(HOME, plan.knots())
    times = [round(t * NS) for t in knots.t_s.tolist()]
    track = KnownTrack.smooth(times, knots.position_m, knots.velocity_m_s)
    asked = np.linspace(0, times[-1] - 1, 500).astype(np.int64).tolist()
    places = np.array([track.segment_at(t).position_m(t) for t in asked])
    assert np.abs(ecef_to_geodetic(places)[2] - 750.0).max() < 1e-3


def test_places_and_velocities_go_to_ecef_and_back() -> None:
    level = np.random.default_rng(3).uniform([-5e4, -5e4, -100], [5e4, 5e4, 3000], (50, 3))
    velocity = np.random.default_rng(4).normal(0.0, 20.0, (50, 3))
    knots = to_ecef(HOME, FlightKnots(np.zeros(50), level, velocity))
    assert level_from_ecef(HOME, knots.position_m) == pytest.approx(level, abs=1e-6)
    back = level_velocity(HOME, knots.position_m, knots.velocity_m_s)
    assert back == pytest.approx(velocity, abs=1e-5)
    assert level_to_ecef(HOME, [0.0, 0.0, 0.0]) == pytest.approx(HOME.origin_ecef_m, abs=1e-6)


def test_a_chain_follows_one_track_after_another_without_a_step() -> None:
    first = KnownTrack.smooth(
        [0, 10 * NS],
        np.array([[0.0] * 3, [40.0, 8.0, 0.0]]),
        np.array([[1.0] * 3, [9.0, 0.0, 0.0]]),
    )
    at_ns = 4 * NS
    left = first.segment_at(at_ns).between(at_ns, 10 * NS).coefficients
    second = KnownTrack.smooth(
        [at_ns, 6 * NS], np.array([left[0], [0.0, 0.0, 7.0]]), np.array([left[1], [0.0] * 3])
    )
    chain = TrackChain(first)
    chain.then(at_ns, second)
    before, after = (chain.segment_at(at_ns + d) for d in (-1, 0))
    assert (before.end_ns, after.start_ns) == (at_ns, at_ns)
    assert before.position_m(at_ns) == pytest.approx(after.position_m(at_ns), abs=1e-9)
    same = first.segment_at(0).position_m(2 * NS)
    assert chain.segment_at(2 * NS).position_m(2 * NS) == pytest.approx(same)
    assert not chain.segment_at(6 * NS).alive
    assert chain.span_ns(0) == (0, 6 * NS)
    chain.then(5 * NS, first.later(5 * NS))
    chain.then(at_ns, second)  # what was to come later does not
    assert not chain.segment_at(7 * NS).alive


@pytest.mark.parametrize("start_ns", [0, 3_700_000_000, 8 * NS])
def test_a_part_of_a_stretch_is_where_the_whole_is(start_ns: int) -> None:
    whole = KnownTrack.smooth(
        [0, 10 * NS],
        np.array([[0.0] * 3, [40.0, 8.0, 5.0]]),
        np.array([[1.0] * 3, [9.0, 0.0, 2.0]]),
    ).segment_at(0)
    part = whole.between(start_ns, 9 * NS)
    assert (part.start_ns, part.end_ns) == (start_ns, 9 * NS)
    times = np.linspace(start_ns, 9 * NS, 7).astype(np.int64)
    assert part.position_m(times) == pytest.approx(whole.position_m(times), abs=1e-9)
