"""Paths of drones: samples, plans of flight, who is forgotten, and structures of arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.held_sizes import held
from support.targets import add_sample

from plotfeed.models.beam import Borders
from plotfeed.models.chance import Chance, Purpose, ScanDraws
from plotfeed.models.flight_plan import FlightKnots, FlightLimits, FlightPlan, to_ecef
from plotfeed.models.frames import LocalFrame, ecef_to_geodetic
from plotfeed.models.state import (
    FALSE_ALARM,
    NS,
    Emitter,
    Floats,
    Ints,
    Plots,
    Signature,
    Signatures,
    TruthState,
    renamed,
)
from plotfeed.models.tracks import TrackLives, TrackRule
from plotfeed.models.truth import (
    EmitterTable,
    FlightSamples,
    KnownTrack,
    TrackChain,
    Trajectories,
    fit_velocities,
    stretches_of,
)

T0 = 1_700_000_000 * NS
HOME = LocalFrame(40.45, -3.73, 650.0)
SIGNATURE = Signature(rcs_m2=0.01)

Enu = tuple[float, float, float]


def trajectories(*, stale_after_s: float = 3.0, history_s: float = 60.0) -> Trajectories:
    return Trajectories(stale_after_s=stale_after_s, history_s=history_s)


def sample(
    into: Trajectories,
    t_s: float,
    enu_m: Sequence[float],
    velocity: Enu | None = (0.0, 0.0, 0.0),
    *,
    drone: str = "a",
    sigma_m: float | None = 0.01,
) -> None:
    latitude_deg, longitude_deg, height_m = HOME.to_geodetic(np.array(enu_m))
    add_sample(
        into,
        drone,
        T0 + round(t_s * NS),
        latitude_deg=float(latitude_deg),
        longitude_deg=float(longitude_deg),
        height_m=float(height_m),
        velocity_enu_m_s=velocity,
        sigma_m=sigma_m,
        signature=SIGNATURE,
    )


def at(paths: Trajectories, t_s: float) -> TruthState:
    return paths.state_at(T0 + round(t_s * NS))


def there(paths: Trajectories, t_s: float) -> bool:
    return len(at(paths, t_s)) == 1


def enu(state: TruthState) -> Floats:
    return HOME.from_ecef(state.position_ecef_m[0])


def east_at_10_m_s(t_s: float) -> Enu:
    return (10 * t_s, 0.0, 0.0)


CURVE = [
    (0.0, (0.0, 0.0, 50.0), (10.0, 0.0, 1.0)),
    (1.0, (9.0, 3.0, 52.0), (8.0, 6.0, 0.0)),
    (2.5, (20.0, 15.0, 51.0), (5.0, 9.0, -2.0)),
]


def curved() -> Trajectories:
    paths = trajectories()
    for t_s, position, velocity in CURVE:
        sample(paths, t_s, position, velocity)
    return paths


def test_the_path_goes_through_every_sample_with_its_velocity_the_derivative() -> None:
    paths = curved()
    for t_s, position, velocity in CURVE:
        state = at(paths, t_s)
        np.testing.assert_allclose(enu(state), position, atol=1e-8)
        local = LocalFrame(*(float(x) for x in HOME.to_geodetic(np.array(position))))
        found = local.rotate_from_ecef(state.velocity_ecef_m_s[0])
        np.testing.assert_allclose(found, velocity, atol=1e-9)
    for t_s in (0.3, 0.9, 1.7, 2.4):
        moved = at(paths, t_s + 1e-3).position_ecef_m - at(paths, t_s - 1e-3).position_ecef_m
        np.testing.assert_allclose(moved / 2e-3, at(paths, t_s).velocity_ecef_m_s, atol=1e-4)


@given(
    st.tuples(*[st.floats(-80, 80)] * 3),
    st.lists(st.integers(1, 2_000), min_size=1, max_size=8),
    st.floats(0, 1),
)
def test_straight_flight_at_constant_speed_is_reproduced(
    velocity_ecef: Enu, steps_ms: list[int], share: float
) -> None:
    paths, velocity = trajectories(), np.array(velocity_ecef)
    t_ms = [0, *np.cumsum(steps_ms).tolist()]
    for t in t_ms:
        here = HOME.from_ecef(HOME.origin_ecef_m + velocity * t / 1e3)
        frame = LocalFrame(*(float(x) for x in HOME.to_geodetic(here)))
        east, north, up = frame.rotate_from_ecef(velocity).tolist()
        sample(paths, t / 1e3, here.tolist(), (east, north, up))
    state = at(paths, share * t_ms[-1] / 1e3)
    expected = HOME.origin_ecef_m + velocity * (int(state.t_utc_ns[0]) - T0) / NS
    np.testing.assert_allclose(state.position_ecef_m[0], expected, atol=1e-7)
    np.testing.assert_allclose(state.velocity_ecef_m_s[0], velocity, atol=1e-4)


def test_spans_are_from_the_first_sample_to_the_last() -> None:
    paths = trajectories()
    assert paths.spans_ns.shape == (0, 2)
    for t_s in (2.0, 3.0, 5.0):
        sample(paths, t_s, (0.0, 0.0, 0.0))
    knots = np.stack([HOME.to_ecef(np.array([x, 0.0, 0.0])) for x in (0.0, 10.0)])
    paths.add_track("b", KnownTrack.straight([T0, T0 + 7 * NS], knots), SIGNATURE)
    assert (paths.spans_ns - T0).tolist() == [[2 * NS, 5 * NS], [0, 7 * NS]]


def test_a_drone_flies_straight_on_until_it_is_stale_and_a_longer_gap_is_not_bridged() -> None:
    paths = trajectories(stale_after_s=3.0)
    sample(paths, 0.0, (0.0, 0.0, 50.0), (10.0, 0.0, 0.0))
    sample(paths, 8.0, (0.0, 500.0, 50.0), (10.0, 0.0, 0.0))
    assert [there(paths, t) for t in (3.0 - 1e-9, 3.0, 5.0, 7.999, 8.0, 10.9, 11.0, 1e6)] == [
        True, False, False, False, True, True, False, False,
    ]  # fmt: skip
    np.testing.assert_allclose(enu(at(paths, 2.9))[:2], (29.0, 0.0), atol=1e-5)


def scripted(*, repeat: bool) -> Trajectories:
    paths = trajectories()
    knots = HOME.to_ecef(np.array([(0.0, 0.0, 50.0), (100.0, 0.0, 50.0), (100.0, 60.0, 50.0)]))
    times = [T0, T0 + 10 * NS, T0 + 16 * NS]
    paths.add_track("a", KnownTrack.straight(times, knots, repeat=repeat), Signature(rcs_m2=0.02))
    return paths


def test_a_scripted_path_has_constant_velocity_between_its_knots() -> None:
    paths = scripted(repeat=False)
    for t_s, expected in (
        (0.0, (0, 0, 50)),
        (2.5, (25, 0, 50)),
        (10.0, (100, 0, 50)),
        (13.0, (100, 30, 50)),
    ):
        np.testing.assert_allclose(enu(at(paths, t_s)), expected, atol=1e-8)
    np.testing.assert_allclose(
        HOME.rotate_from_ecef(at(paths, 12.0).velocity_ecef_m_s[0]), (0, 10, 0), atol=1e-9
    )


@given(st.integers(0, 16 * NS - 1), st.integers(0, 10**8))
def test_a_repeated_path_is_the_same_in_every_turn(into_ns: int, turn: int) -> None:
    paths = scripted(repeat=True)
    first = paths.state_at(T0 + into_ns)
    later = paths.state_at(T0 + into_ns + turn * 16 * NS)
    np.testing.assert_array_equal(first.position_ecef_m, later.position_ecef_m)
    np.testing.assert_array_equal(first.velocity_ecef_m_s, later.velocity_ecef_m_s)


COMPONENT = st.floats(-1000, 1000) | st.just(math.nan)
ANYWHERE = st.fixed_dictionaries({
    "latitude_deg": st.floats(-90, 90), "longitude_deg": st.floats(-180, 180),
    "height_m": st.floats(-1000, 100_000),
    "velocity_enu_m_s": st.none() | st.tuples(COMPONENT, COMPONENT, COMPONENT),
})  # fmt: skip


@settings(max_examples=40)
@given(
    st.lists(st.tuples(st.integers(1, 20 * NS), ANYWHERE), min_size=1, max_size=12),
    st.lists(st.integers(-NS, 300 * NS), min_size=1, max_size=10),
    st.none() | st.floats(0, 1e6),
)
def test_arbitrary_samples_give_finite_states(
    samples: list[tuple[int, dict[str, Any]]], asked_ns: list[int], sigma_m: float | None
) -> None:
    paths, t_ns = trajectories(), T0
    for step_ns, place in samples:
        t_ns += step_ns
        asked_ns.append(t_ns - T0)
        add_sample(paths, "a", t_ns, **place, sigma_m=sigma_m, signature=SIGNATURE)
    for t in asked_ns:
        state = paths.state_at(T0 + t)
        assert np.isfinite(state.position_ecef_m).all()
        assert np.isfinite(state.velocity_ecef_m_s).all()


@given(
    st.tuples(*[st.floats(-300, 300)] * 3),
    st.lists(st.integers(10, 1500), min_size=1, max_size=25),
    st.floats(0, 30),
)
def test_the_fitted_velocity_of_straight_noise_free_flight_is_exact(
    velocity: Enu, steps_ms: list[int], sigma_m: float
) -> None:
    t_ms = np.concatenate([[0], np.cumsum(steps_ms)])
    positions = t_ms[:, None] / 1e3 * np.array(velocity)
    counts, sigmas_m = np.array([len(t_ms)]), np.array([sigma_m])
    fitted = fit_velocities((T0 + t_ms * 1_000_000)[None], positions[None], counts, sigmas_m)
    np.testing.assert_allclose(fitted, [velocity], atol=1e-8)


def test_steps_of_coarse_positions_are_not_taken_for_speed() -> None:
    step_m = 11.0  # four decimals of a degree
    paths = trajectories()
    speeds = []
    for t_s in range(60):
        east_m = round(10.0 * t_s / step_m) * step_m
        sample(paths, t_s, (east_m, 0.0, 50.0), None, sigma_m=step_m / math.sqrt(12))
        speeds.append(float(HOME.rotate_from_ecef(at(paths, t_s).velocity_ecef_m_s[0])[0]))
    settled = np.array(speeds[6:])
    assert np.abs(settled - 10.0).max() < 3.0
    assert abs(settled.mean() - 10.0) < 0.5


def test_fine_positions_follow_a_turn_at_once() -> None:
    paths = trajectories()
    for t_s in range(4):
        sample(paths, t_s, east_at_10_m_s(t_s), None, sigma_m=0.01)
    sample(paths, 4, (30.0, 10.0, 0.0), None, sigma_m=0.01)
    velocity = HOME.rotate_from_ecef(at(paths, 4).velocity_ecef_m_s[0])
    np.testing.assert_allclose(velocity, (0.0, 10.0, 0.0), atol=1e-3)


def test_only_the_unknown_components_of_a_velocity_are_fitted() -> None:
    paths = trajectories()
    sample(paths, 0.0, (0.0, 0.0, 50.0))
    sample(paths, 1.0, (10.0, 0.0, 54.0), (3.0, 2.0, math.nan))
    velocity = HOME.rotate_from_ecef(at(paths, 1.0).velocity_ecef_m_s[0])
    np.testing.assert_allclose(velocity, (3.0, 2.0, 4.0), atol=1e-4)


@settings(max_examples=5)
@given(st.lists(st.integers(20, 2900), min_size=150, max_size=160), st.booleans())
def test_forgetting_changes_no_state_within_the_history(
    steps_ms: list[int], with_velocity: bool
) -> None:
    short, whole = trajectories(history_s=10.0), trajectories(history_s=1e6)
    for i, t_s in enumerate(np.cumsum(steps_ms) / 1e3):
        velocity = (float(i % 7), 1.0, 0.0) if with_velocity else None
        place = (5.0 * i, float(i * i % 11), 50.0)
        sample(short, t_s, place, velocity, sigma_m=2.0)
        sample(whole, t_s, place, velocity, sigma_m=2.0)
    for back_s in np.linspace(0, 10.0, 40):
        one, other = at(short, t_s - back_s), at(whole, t_s - back_s)
        np.testing.assert_array_equal(one.position_ecef_m, other.position_ecef_m)
        np.testing.assert_array_equal(one.velocity_ecef_m_s, other.velocity_ecef_m_s)


def test_the_last_year_that_nanoseconds_hold_is_like_any_other() -> None:
    paths = trajectories(stale_after_s=3.0)
    late_ns = 2**63 - 10 * NS
    shift_s = (late_ns - T0) // NS
    sample(paths, shift_s, (0.0, 0.0, 50.0))
    assert there(paths, shift_s + 2)
    assert not there(paths, shift_s + 4)


Sample = tuple[str, int, tuple[float, float, float], tuple[float, float, float], float]


def flight_of(t_utc_ns: Ints, enu_m: Floats, velocity: Floats, sigma_m: Floats) -> FlightSamples:
    latitude_deg, longitude_deg, height_m = HOME.to_geodetic(enu_m)
    return FlightSamples(
        t_utc_ns=t_utc_ns, latitude_deg=latitude_deg, longitude_deg=longitude_deg,
        height_m=height_m, velocity_enu_m_s=velocity, sigma_m=sigma_m,
    )  # fmt: skip


def add_together(paths: Trajectories, samples: Sequence[Sample]) -> None:
    drones, times, places, velocities, sigmas = zip(*samples, strict=True)
    number = len(samples)
    told = flight_of(np.array(times), np.array(places), np.array(velocities), np.array(sigmas))
    signatures = Signatures(
        rcs_m2=np.array(sigmas), sound_power_db=np.zeros(number), emitters=[()] * number
    )
    paths.add_samples(drones, told, signatures)


STEP_MS = st.integers(1, 400) | st.sampled_from([2_999, 3_000, 3_001, 20_000])
UNKNOWN = st.just(math.nan) | st.floats(-50, 50)
STEPS = st.tuples(
    st.sampled_from("abc"),
    STEP_MS,
    st.tuples(*[st.floats(-900, 900)] * 3),
    st.tuples(*[UNKNOWN] * 3),
    st.just(math.nan) | st.floats(0.01, 50),
)


@settings(max_examples=60)
@given(st.lists(STEPS, min_size=1, max_size=60), st.data())
def test_samples_added_together_are_those_added_one_after_the_other(
    steps: list[Sample], data: st.DataObject
) -> None:
    now_ns, samples = dict.fromkeys("abc", T0), list[Sample]()
    for drone, step_ms, *rest in steps:
        now_ns[drone] += step_ms * 1_000_000
        samples.append((drone, now_ns[drone], *rest))  # type: ignore[arg-type]
    single, batched = trajectories(history_s=20.0), trajectories(history_s=20.0)
    first = 0
    while first < len(samples):
        end = first + data.draw(st.integers(1, len(samples)))
        part, first = samples[first:end], end
        add_together(batched, part)
        for one in part:
            add_together(single, [one])
        one_of = st.tuples(st.integers(0, len(single.names) - 1), st.integers(-9_000, 9_000))
        asked = data.draw(st.lists(one_of, min_size=1, max_size=9))
        drones = np.array([drone for drone, _ in asked])
        t_ns = np.array([now_ns[single.names[d]] + ms * 1_000_000 for d, ms in asked])
        for found in (batched.state_at(t_ns, drones), batched.state_at(t_ns[::-1], drones[::-1])):
            assert set(found.drone) <= set(drones)
        one_by_one, together = single.state_at(t_ns, drones), batched.state_at(t_ns, drones)
        for name, column in vars(one_by_one).items():
            np.testing.assert_array_equal(column, getattr(together, name))
        alone = [single.position_at(t_ns[i : i + 1], drones[i : i + 1]) for i in range(len(asked))]
        np.testing.assert_array_equal(np.concatenate(alone), batched.position_at(t_ns, drones))
        assert batched.names == single.names
        np.testing.assert_array_equal(single.signatures.rcs_m2, batched.signatures.rcs_m2)


def test_a_flight_is_as_if_it_had_been_told_live() -> None:
    rng = np.random.default_rng(7)
    t_ns = T0 + np.cumsum(rng.integers(20, 3_500, 200)) * 1_000_000
    enu_m = np.cumsum(rng.normal(size=(200, 3)), 0)
    velocity = rng.normal(size=(200, 3))
    velocity[rng.random((200, 3)) < 0.2] = np.nan
    samples = flight_of(t_ns, enu_m, velocity, np.full(200, 2.0))
    live, flight = trajectories(history_s=1e6), trajectories()
    starts = (0, 70, 71, 150)  # Of flights that begin anew in one log
    for i in range(200):
        begins = [0] if i in starts else []
        live.add_samples(["a"], samples.between(i, i + 1), Signatures.of_one(SIGNATURE), begins)
    flight.add_flight("a", samples, SIGNATURE, starts)
    for t in rng.integers(t_ns[0] - NS, t_ns[-1] + 5 * NS, 300).tolist():
        one, other = live.state_at(t), flight.state_at(t)
        np.testing.assert_array_equal(one.position_ecef_m, other.position_ecef_m)
        np.testing.assert_array_equal(one.velocity_ecef_m_s, other.velocity_ecef_m_s)
    assert live.spans_ns.tolist() == flight.spans_ns.tolist()


def test_no_velocity_is_fitted_over_the_start_of_another_flight() -> None:
    t_ns = T0 + np.arange(12) * NS
    east_m = 10.0 * np.arange(12) + 1000.0 * (np.arange(12) >= 6)
    enu_m = np.stack([east_m, np.zeros(12), np.zeros(12)], axis=1)
    whole = flight_of(t_ns, enu_m, np.full((12, 3), np.nan), np.full(12, 2.0))

    def velocities(first: int, *starts: int) -> Any:
        flight = trajectories()
        flight.add_flight("a", whole.between(first, 12), SIGNATURE, starts)
        return np.array([flight.state_at(t).velocity_ecef_m_s for t in t_ns[6:].tolist()])

    np.testing.assert_array_equal(velocities(0, 0, 6), velocities(6, 0))
    assert (np.abs(velocities(0, 0) - velocities(6, 0)).max(axis=(1, 2)) > 1.0).any()


# Drones that are forgotten: those that stay are as they were; nothing of the others is held.


RADIO = (Emitter(frequency_hz=2.4e9, eirp_dbm=20.0),)


def say(into: Trajectories, drone: str, t_s: float, place: int) -> None:
    add_sample(
        into,
        drone,
        T0 + round(t_s * NS),
        latitude_deg=40.0 + 1e-3 * place,
        longitude_deg=-3.0 + 1e-6 * t_s,
        height_m=700.0,
        velocity_enu_m_s=None,
        sigma_m=1.0,
        signature=Signature(rcs_m2=1.0 + place, emitters=RADIO * (place % 3)),
    )


steps = st.lists(st.tuples(st.sampled_from("abcdefgh"), st.booleans()), max_size=60)


@given(steps)
def test_drones_that_stay_keep_their_rows_and_their_states(steps: list[tuple[str, bool]]) -> None:
    """To the last bit what each would be alone; a name that comes again begins anew."""
    together = trajectories()
    alone: dict[str, Trajectories] = {}
    rows: dict[str, int] = {}
    for k, (drone, goes) in enumerate(steps):
        if goes and drone in alone:
            before = together.names
            together.forget([drone])
            others, row = set(renamed(before, together.names).tolist()), rows.pop(drone)
            assert row in others
            assert others.isdisjoint(rows.values())
            del alone[drone]
        else:
            own = alone.setdefault(drone, trajectories())
            for into in (together, own):
                say(into, drone, 0.2 * k, ord(drone))
            row = together.names.index(drone)
            free = [i for i in range(len(together.names)) if i not in rows.values()]
            assert row == rows.setdefault(drone, min(free, default=row))
        for asked_s in (0.2 * k - 1.0, 0.2 * k, 0.2 * k + 1.0):
            there = at(together, asked_s)
            names = [together.names[row] for row in there.drone.tolist()]
            by_itself = {name: at(own, asked_s) for name, own in alone.items()}
            assert sorted(names) == sorted(name for name, state in by_itself.items() if len(state))
            for i, name in enumerate(names):
                for column in ("position_ecef_m", "velocity_ecef_m_s"):
                    found, own = (getattr(state, column) for state in (there, by_itself[name]))
                    np.testing.assert_array_equal(found[i], own[0])
        for name, row in rows.items():
            (emitters,) = alone[name].signatures.emitters
            assert together.signatures.emitters[row] == emitters
        assert len(together) == len(alone)


def test_a_week_of_a_thousand_names_an_hour_holds_no_more_than_an_hour_of_them() -> None:
    paths, sizes = trajectories(), []
    say(paths, "stays", 0.0, 1)
    signatures = Signatures(
        rcs_m2=np.ones(1001), sound_power_db=np.ones(1001), emitters=[RADIO] * 1001
    )
    for hour in range(168):
        names = [f"{hour}-{i}" for i in range(1000)]
        t_utc_ns = np.full(1001, T0 + hour * 3600 * NS + NS)
        told = flight_of(t_utc_ns, np.zeros((1001, 3)), np.zeros((1001, 3)), np.full(1001, 1.0))
        paths.add_samples([*names, "stays"], told, signatures)
        assert len(paths.state_at(int(t_utc_ns[0]))) == 1001
        paths.forget(names)
        sizes.append(held(paths))
    assert paths.names == ["stays"]
    assert max(sizes) == sizes[0] < 20_000


def test_draws_of_drones_that_stay_are_the_same_however_many_there_were() -> None:
    draws = ScanDraws([Chance(1, "radar")], Purpose.DETECTION)
    zeros = np.zeros(1, np.int64)

    def drawn(row: int) -> tuple[float, float]:
        of = draws.of(zeros, zeros + 7, zeros + row)
        return float(of.standard_gamma(0.3, (1,))[0]), float(of.standard_normal((1,))[0])

    before, small = drawn(5), held(draws)
    drawn(20_000)
    assert held(draws) > 50 * small
    draws.trim(6)
    assert drawn(5) == before
    assert held(draws) == small


def test_borders_and_lives_of_tracks_hold_no_more_than_the_drones_that_are_known() -> None:
    borders = Borders(3)
    borders.make_room(10_000)
    borders.azimuth_deg[:] = 1.0
    borders.forget(np.arange(5, 10_000), 5)
    assert borders.azimuth_deg.shape[1] < 100
    assert (borders.azimuth_deg[:, :5] == 1.0).all()
    assert np.isnan(borders.azimuth_deg[:, 5:]).all()
    rule = TrackRule(confirm_hits=1, confirm_window=2, drop_misses=2, period_ns=NS)
    lives, drones = TrackLives(rule), np.arange(5000)
    hit = np.ones(len(drones), np.bool_)
    begun = lives.take(drones, np.full(len(drones), NS), hit, start_ns=0, end_ns=NS)
    lives.forget(drones[3:], 3)
    assert held(lives) < 2000
    assert lives.drones.tolist() == [0, 1, 2]
    later = lives.take(drones[:4], np.full(4, 2 * NS), hit[:4], start_ns=NS, end_ns=2 * NS)
    assert later.track[:3].tolist() == begun.track[:3].tolist()
    assert later.first.tolist() == [False, False, False, True], "who has the row is another"


# Plans of flight keep their limits, end where they should, and follow the curved Earth.


LIMITS = FlightLimits(speed_m_s=18.0, climb_m_s=5.0, sink_m_s=3.0, acceleration_m_s2=2.5)
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
    places = stretches_of([TrackChain(track)] * len(times), times.tolist()).places_m(times)
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
    asked = np.linspace(0, times[-1] - 1, 500).astype(np.int64)
    places = stretches_of([TrackChain(track)] * 500, asked.tolist()).places_m(asked)
    assert np.abs(ecef_to_geodetic(places)[2] - 750.0).max() < 1e-3


def test_a_chain_follows_one_track_after_another_without_a_step() -> None:
    first = KnownTrack.smooth(
        [0, 10 * NS],
        np.array([[0.0] * 3, [40.0, 8.0, 0.0]]),
        np.array([[1.0] * 3, [9.0, 0.0, 0.0]]),
    )
    at_ns = 4 * NS
    rest, later_ns = first.stretch_at(at_ns).between(at_ns, 10 * NS), np.array([7 * NS])
    np.testing.assert_allclose(rest.places_m(later_ns), first.stretch_at(0).places_m(later_ns))
    left = rest.coefficients[:, :, 0]
    second = KnownTrack.smooth(
        [at_ns, 6 * NS], np.array([left[0], [0.0, 0.0, 7.0]]), np.array([left[1], [0.0] * 3])
    )
    chain = TrackChain(first)
    chain.then(at_ns, second)
    found = stretches_of([chain] * 2, [at_ns - 1, at_ns])
    assert (found.end_ns[0], found.start_ns[1]) == (at_ns, at_ns)
    border_ns, soon_ns = np.full(2, at_ns), np.array([2 * NS])
    np.testing.assert_allclose(*found.places_m(border_ns), atol=1e-9)
    same = first.stretch_at(0).places_m(soon_ns)
    np.testing.assert_allclose(stretches_of([chain], [2 * NS]).places_m(soon_ns), same)
    assert not stretches_of([chain], [6 * NS]).alive
    assert chain.span_ns(0) == (0, 6 * NS)
    chain.then(5 * NS, first.later(5 * NS))
    chain.then(at_ns, second)  # what was to come later does not
    assert not stretches_of([chain], [7 * NS]).alive


# Structures of arrays: rows and joins keep every column, those that are not there included.


def plots(t_utc_ns: list[int], with_columns: frozenset[str]) -> Plots:
    n = len(t_utc_ns)
    columns: dict[str, Any] = {"t_utc_ns": np.array(t_utc_ns, np.int64)}
    if "range_m" in with_columns:
        columns["range_m"] = np.arange(n) + 1.5
    if "range_rate_m_s" in with_columns:
        columns["range_rate_m_s"] = np.arange(n) - 0.5
    if "merged_drones" in with_columns:
        columns["merged_drones"] = np.empty(n, np.object_)
        columns["merged_drones"][:] = [(i, i + 1) for i in range(n)]
    return Plots.of(**columns)


def listed(found: Plots) -> dict[str, list[str]]:
    """Every column as text, so that NaN equals NaN; absent ones as what they say row by row."""
    told = {}
    for field in fields(found):
        column = getattr(found, field.name)
        nothing = () if field.name == "merged_drones" else np.nan
        told[field.name] = [str(x) for x in ([nothing] * len(found) if column is None else column)]
    return told


some_columns = st.frozensets(st.sampled_from(["range_m", "range_rate_m_s", "merged_drones"]))
some_plots = st.builds(plots, st.lists(st.integers(0, 9), max_size=6), some_columns)


@given(st.lists(some_plots, min_size=1, max_size=4), st.data())
def test_rows_joins_and_orders_keep_every_column(parts: list[Plots], data: st.DataObject) -> None:
    """Joined rows are those of each part; in the order of time ties stay as they were."""
    each, joined = [listed(part) for part in parts], Plots.joined(parts)
    whole, n = listed(joined), len(joined)
    assert whole == {name: [x for told in each for x in told[name]] for name in whole}

    def of_rows(which: list[int]) -> dict[str, list[str]]:
        return {name: [column[i] for i in which] for name, column in whole.items()}

    mask = np.array(data.draw(st.lists(st.booleans(), min_size=n, max_size=n)), bool)
    chosen = np.flatnonzero(mask)
    assert listed(joined.rows(mask)) == listed(joined.rows(chosen)) == of_rows(chosen.tolist())
    order = sorted(range(n), key=lambda i: joined.t_utc_ns[i])
    assert listed(joined.in_order_of_time()) == of_rows(order)


def test_what_is_not_measured_takes_no_memory_and_says_so() -> None:
    found = Plots.of(t_utc_ns=np.zeros(1_000_000, np.int64))
    assert (found.drone == FALSE_ALARM).all()
    assert (found.channel == 0).all()
    assert np.isnan(found.range_m).all()
    assert found.kind[0] == found.identity[-1] == ""
    assert held(found) < 9_000_000  # of the times
    assert not found.range_m.flags.writeable
    both = Plots.joined([found, found])
    assert both.range_m.strides == (0,)
    assert len(both) == len(both.range_m) == 2_000_000


def test_what_is_no_column_is_refused() -> None:
    with pytest.raises(TypeError, match="azimut_deg"):
        Plots.of(t_utc_ns=np.zeros(1, np.int64), azimut_deg=np.zeros(1))
    with pytest.raises(AttributeError, match="azimut_deg"):
        _ = Plots.of(t_utc_ns=np.zeros(1, np.int64)).azimut_deg  # type: ignore[attr-defined]


def test_a_column_is_measured_if_it_was_given() -> None:
    one = Plots.of(t_utc_ns=np.zeros(1, np.int64), range_m=np.ones(1))
    other = Plots.of(t_utc_ns=np.ones(1, np.int64))
    assert one.measures("range_m")
    assert not other.measures("range_m")
    assert Plots.joined([other, one]).measures("range_m")
    assert one.but(height_m=np.ones(1)).measures("height_m")
    assert not one.measures("height_m")


# Emitters by columns are those of the drones, whatever was set anew in what order.


emitters = st.builds(
    Emitter,
    frequency_hz=st.floats(1e6, 1e10),
    bandwidth_hz=st.floats(0, 1e8),
    eirp_dbm=st.floats(-50, 50),
    kind=st.sampled_from(["", "control", "video"]),
    identity=st.text(max_size=3),
)
of_a_drone = st.lists(emitters, max_size=3).map(tuple)


def told(table: EmitterTable, drones: list[int]) -> list[tuple[int, int, Emitter]]:
    found = table.emissions(np.array(drones, np.int64))
    names = ("frequency_hz", "bandwidth_hz", "eirp_dbm", "kind", "identity")
    columns = [getattr(found, name) for name in names[:3]]
    rows = zip(*columns, table.kinds(found), table.identities(found), strict=True)
    of = [Emitter(**dict(zip(names, row, strict=True))) for row in rows]
    return list(zip(found.target.tolist(), found.channel.tolist(), of, strict=True))


@given(st.lists(of_a_drone, min_size=1, max_size=6), st.data())
def test_columns_are_those_of_the_drones(
    first: list[tuple[Emitter, ...]], data: st.DataObject
) -> None:
    table, expected = EmitterTable(first), list(first)
    for _ in range(data.draw(st.integers(0, 12))):
        new, drone = data.draw(of_a_drone), data.draw(st.integers(0, len(expected)))
        if drone == len(expected):
            table.append(new)
            expected.append(new)
        else:
            table[drone] = new
            expected[drone] = new
        drones = data.draw(st.lists(st.integers(0, len(expected) - 1), max_size=6))
        assert told(table, drones) == [
            (row, channel, emitter)
            for row, drone in enumerate(drones)
            for channel, emitter in enumerate(expected[drone])
        ]
    assert list(table) == expected
    assert len(table) == len(expected)
    assert EmitterTable.of(table) is table


def test_a_drone_that_changes_for_ever_takes_no_more_room() -> None:
    table = EmitterTable([(), ()])
    for i in range(5000):
        table[1] = (Emitter(frequency_hz=float(i + 1)),) * 3
        assert told(table, [1])[0][2].frequency_hz == i + 1
    assert held(table) < 5000
