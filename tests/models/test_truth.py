from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.one_sample import add_sample

from plotfeed.models.frames import LocalFrame, geodetic_to_ecef
from plotfeed.models.state import Floats, Signature, Signatures, TruthState
from plotfeed.models.truth import KnownTrack, Trajectories, fit_velocity
from plotfeed.proto.utc import NS

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


@pytest.mark.parametrize("k", [0, 1, 2])
def test_the_path_goes_through_every_sample_with_its_velocity(k: int) -> None:
    paths = trajectories()
    for t_s, position, velocity in CURVE:
        sample(paths, t_s, position, velocity)
    t_s, position, velocity = CURVE[k]
    state = at(paths, t_s)
    np.testing.assert_allclose(enu(state), position, atol=1e-8)
    local = LocalFrame(*(float(x) for x in HOME.to_geodetic(np.array(position))))
    np.testing.assert_allclose(
        local.rotate_from_ecef(state.velocity_ecef_m_s[0]), velocity, atol=1e-9
    )


def test_position_and_velocity_do_not_jump_at_a_sample() -> None:
    paths = trajectories()
    for t_s, position, velocity in CURVE:
        sample(paths, t_s, position, velocity)
    before, after = at(paths, 1.0 - 1e-9), at(paths, 1.0)
    np.testing.assert_allclose(before.position_ecef_m, after.position_ecef_m, atol=1e-7)
    np.testing.assert_allclose(before.velocity_ecef_m_s, after.velocity_ecef_m_s, atol=1e-7)


def test_the_velocity_is_the_derivative_of_the_position() -> None:
    paths = trajectories()
    for t_s, position, velocity in CURVE:
        sample(paths, t_s, position, velocity)
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
    paths = trajectories()
    velocity = np.array(velocity_ecef)
    t_ms = [0, *np.cumsum(steps_ms).tolist()]
    for t in t_ms:
        position = HOME.origin_ecef_m + velocity * t / 1e3
        place = HOME.to_geodetic(HOME.from_ecef(position))
        frame = LocalFrame(*(float(x) for x in place))
        east, north, up = frame.rotate_from_ecef(velocity).tolist()
        sample(paths, t / 1e3, HOME.from_ecef(position).tolist(), (east, north, up))
    t_s = share * t_ms[-1] / 1e3
    state = at(paths, t_s)
    expected = HOME.origin_ecef_m + velocity * (int(state.t_utc_ns[0]) - T0) / NS
    np.testing.assert_allclose(state.position_ecef_m[0], expected, atol=1e-7)
    np.testing.assert_allclose(state.velocity_ecef_m_s[0], velocity, atol=1e-4)


def test_a_drone_flies_on_until_it_is_stale_and_is_then_gone() -> None:
    paths = trajectories(stale_after_s=3.0)
    sample(paths, 0.0, (0.0, 0.0, 50.0), (10.0, 0.0, 0.0))
    state = at(paths, 2.0)
    np.testing.assert_allclose(enu(state)[0], 20.0, atol=1e-6)
    assert there(paths, 3.0 - 1e-9)
    assert not there(paths, 3.0)
    assert not there(paths, 1e6)


def test_a_drone_is_not_there_before_its_first_sample() -> None:
    paths = trajectories()
    sample(paths, 0.0, (0.0, 0.0, 50.0))
    assert not there(paths, -1e-9)
    assert not there(paths, -1e6)
    assert there(paths, 0.0)


def test_spans_are_from_the_first_sample_to_the_last() -> None:
    paths = trajectories()
    assert paths.spans_ns.shape == (0, 2)
    for t_s in (2.0, 3.0, 5.0):
        sample(paths, t_s, (0.0, 0.0, 0.0))
    knots = np.stack([HOME.to_ecef(np.array([x, 0.0, 0.0])) for x in (0.0, 10.0)])
    paths.add_track("b", KnownTrack.straight([T0, T0 + 7 * NS], knots), SIGNATURE)
    assert (paths.spans_ns - T0).tolist() == [[2 * NS, 5 * NS], [0, 7 * NS]]


def test_a_gap_longer_than_stale_is_not_bridged() -> None:
    paths = trajectories(stale_after_s=3.0)
    sample(paths, 0.0, (0.0, 0.0, 50.0), (10.0, 0.0, 0.0))
    sample(paths, 8.0, (0.0, 500.0, 50.0), (10.0, 0.0, 0.0))
    assert [there(paths, t) for t in (2.9, 3.0, 5.0, 7.999, 8.0, 10.9, 11.0)] == [
        True, False, False, False, True, True, False,
    ]  # fmt: skip
    np.testing.assert_allclose(enu(at(paths, 2.9))[1], 0.0, atol=1e-6)  # not drawn to what follows


def test_a_gap_as_long_as_stale_is_bridged() -> None:
    paths = trajectories(stale_after_s=3.0)
    sample(paths, 0.0, (0.0, 0.0, 50.0), (10.0, 0.0, 0.0))
    sample(paths, 3.0, (30.0, 0.0, 50.0), (10.0, 0.0, 0.0))
    assert there(paths, 3.0 - 1e-9)
    np.testing.assert_allclose(enu(at(paths, 1.5))[0], 15.0, atol=1e-5)


def test_news_of_a_drone_that_was_gone_brings_it_back() -> None:
    paths = trajectories(stale_after_s=3.0)
    sample(paths, 0.0, (0.0, 0.0, 50.0))
    assert not there(paths, 9.0)
    sample(paths, 9.0, (5.0, 0.0, 50.0))
    assert there(paths, 9.0)
    assert paths.names == ["a"]


def test_every_sample_changes_the_version() -> None:
    paths = trajectories()
    versions = {paths.version}
    for t_s in range(5):
        sample(paths, t_s, (0.0, 0.0, 50.0))
        versions.add(paths.version)
    assert len(versions) == 6


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


def test_a_scripted_drone_is_gone_at_its_last_knot() -> None:
    paths = scripted(repeat=False)
    assert [there(paths, t) for t in (-1e-9, 0.0, 16.0 - 1e-9, 16.0)] == [False, True, True, False]


@given(st.integers(0, 16 * NS - 1), st.integers(0, 10**8))
def test_a_repeated_path_is_the_same_in_every_turn(into_ns: int, turn: int) -> None:
    paths = scripted(repeat=True)
    first = paths.state_at(T0 + into_ns)
    later = paths.state_at(T0 + into_ns + turn * 16 * NS)
    np.testing.assert_array_equal(first.position_ecef_m, later.position_ecef_m)
    np.testing.assert_array_equal(first.velocity_ecef_m_s, later.velocity_ecef_m_s)


def test_a_repeated_path_is_not_there_before_it_begins() -> None:
    assert not there(scripted(repeat=True), -1e-9)


@given(st.lists(st.integers(-NS, 14 * NS), min_size=1, max_size=30))
def test_states_do_not_depend_on_what_was_asked_before(asked_ns: list[int]) -> None:
    def make() -> Trajectories:
        paths = trajectories()
        for t_s, position, velocity in CURVE:
            sample(paths, t_s, position, velocity)
        sample(paths, 9.0, (0.0, 0.0, 9.0))
        return paths

    often = make()
    for t in asked_ns:
        one, fresh = often.state_at(T0 + t), make().state_at(T0 + t)
        assert len(one) == len(fresh)
        np.testing.assert_array_equal(one.position_ecef_m, fresh.position_ecef_m)
        np.testing.assert_array_equal(one.velocity_ecef_m_s, fresh.velocity_ecef_m_s)


def test_each_drone_can_be_asked_for_at_its_own_time() -> None:
    paths = trajectories()
    for drone, east_m in (("a", 0.0), ("b", 1000.0), ("c", 2000.0)):
        for t_s in (0.0, 1.0, 2.0):
            sample(paths, t_s, (east_m + 10 * t_s, 0.0, 50.0), (10.0, 0.0, 0.0), drone=drone)
    times = T0 + np.array([1_300_000_000, 200_000_000])
    together = paths.state_at(times, np.array([2, 0]))
    assert together.drone.tolist() == [2, 0]
    assert together.t_utc_ns.tolist() == times.tolist()
    for i, row in enumerate((2, 0)):
        alone = paths.state_at(int(times[i]))
        np.testing.assert_array_equal(together.position_ecef_m[i], alone.position_ecef_m[row])


def test_a_drone_that_is_gone_at_its_time_is_left_out() -> None:
    paths = trajectories(stale_after_s=1.0)
    sample(paths, 0.0, (0.0, 0.0, 50.0), drone="a")
    sample(paths, 0.0, (0.0, 0.0, 50.0), drone="b")
    state = paths.state_at(T0 + np.array([2 * NS, 0]), np.array([0, 1]))
    assert state.drone.tolist() == [1]


def test_there_may_be_many_drones_and_none() -> None:
    paths = trajectories()
    assert len(at(paths, 0.0)) == 0
    for i in range(100):
        sample(paths, 0.0, (float(i), 0.0, 50.0), drone=f"d{i}")
    state = at(paths, 0.5)
    assert state.drone.tolist() == list(range(100))
    np.testing.assert_allclose(
        HOME.from_ecef(state.position_ecef_m)[:, 0], np.arange(100), atol=1e-6
    )


@st.composite
def sample_lists(draw: st.DrawFn) -> list[tuple[int, float, float, float, Enu | None]]:
    component = st.one_of(st.floats(-1000, 1000), st.just(math.nan))
    steps = draw(st.lists(st.integers(1, 20 * NS), min_size=1, max_size=12))
    return [
        (
            t,
            draw(st.floats(-90, 90)),
            draw(st.floats(-180, 180)),
            draw(st.floats(-1000, 100_000)),
            draw(st.none() | st.tuples(component, component, component)),
        )
        for t in np.cumsum(steps).tolist()
    ]


@settings(max_examples=40)
@given(
    sample_lists(),
    st.lists(st.integers(-NS, 300 * NS), min_size=1, max_size=10),
    st.none() | st.floats(0, 1e6),
)
def test_arbitrary_samples_give_finite_states(
    samples: list[tuple[int, float, float, float, Enu | None]],
    asked_ns: list[int],
    sigma_m: float | None,
) -> None:
    paths = trajectories()
    for t, latitude_deg, longitude_deg, height_m, velocity in samples:
        add_sample(
            paths,
            "a",
            T0 + t,
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            height_m=height_m,
            velocity_enu_m_s=velocity,
            sigma_m=sigma_m,
            signature=SIGNATURE,
        )
    for t in (*asked_ns, *(s[0] for s in samples)):
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
    fitted = fit_velocity((T0 + t_ms * 1_000_000).tolist(), list(positions), sigma_m)
    np.testing.assert_allclose(fitted, velocity, atol=1e-8)


def test_a_single_position_stands_still() -> None:
    assert fit_velocity([T0], [np.ones(3)], 0.5).tolist() == [0.0, 0.0, 0.0]


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


@given(st.floats(-89, 89), st.floats(-180, 180), st.floats(-1000, 100_000))
def test_a_hovering_drone_is_where_it_said_to_nanometres(
    latitude_deg: float, longitude_deg: float, height_m: float
) -> None:
    paths = trajectories()
    for t_s in (0, 1):
        add_sample(
            paths,
            "a",
            T0 + t_s * NS,
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            height_m=height_m,
            velocity_enu_m_s=None,
            sigma_m=None,
            signature=SIGNATURE,
        )
    expected = geodetic_to_ecef(latitude_deg, longitude_deg, height_m)
    for asked_s in (0.0, 0.37, 1.0, 2.9):
        np.testing.assert_allclose(
            at(paths, asked_s).position_ecef_m[0], expected, atol=5e-9, rtol=0
        )


def test_the_last_year_that_nanoseconds_hold_is_like_any_other() -> None:
    paths = trajectories(stale_after_s=3.0)
    late_ns = 2**63 - 10 * NS
    shift_s = (late_ns - T0) // NS
    sample(paths, shift_s, (0.0, 0.0, 50.0))
    assert there(paths, shift_s + 2)
    assert not there(paths, shift_s + 4)


def test_the_latest_signature_counts() -> None:
    paths = scripted(repeat=False)
    paths.add_track("a", KnownTrack.straight([T0, T0 + NS], np.eye(2, 3)), Signature(rcs_m2=0.5))
    assert paths.signatures.rcs_m2[0] == 0.5


Sample = tuple[str, int, tuple[float, float, float], tuple[float, float, float], float]


def add_together(paths: Trajectories, samples: Sequence[Sample]) -> None:
    drones, times, places, velocities, sigmas = zip(*samples, strict=True)
    latitude_deg, longitude_deg, height_m = HOME.to_geodetic(np.array(places))
    number = len(samples)
    paths.add_samples(
        drones,
        np.array(times),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=height_m,
        velocity_enu_m_s=np.array(velocities),
        sigma_m=np.array(sigmas),
        signatures=Signatures(
            rcs_m2=np.array(sigmas), sound_power_db=np.zeros(number), emitters=[()] * number
        ),
    )


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
        asked = data.draw(
            st.lists(
                st.tuples(st.integers(0, len(single.names) - 1), st.integers(-9_000, 9_000)),
                min_size=1,
                max_size=9,
            )
        )
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


def test_what_is_forgotten_makes_room() -> None:
    paths = trajectories(history_s=1.0)
    for t_s in range(2_000):
        add_together(
            paths,
            [
                (str(d), T0 + t_s * NS // 10, (0.0, 0.0, 50.0), (1.0, 0.0, 0.0), 1.0)
                for d in range(9)
            ],
        )
    assert len(paths._live) < 1_000
    assert paths.spans_ns[:, 1].tolist() == [T0 + 1_999 * NS // 10] * 9
    assert (paths.spans_ns[:, 1] - paths.spans_ns[:, 0] >= NS).all()


def test_a_flight_is_as_if_it_had_been_told_live() -> None:
    rng = np.random.default_rng(7)
    t_ns = T0 + np.cumsum(rng.integers(20, 3_500, 200)) * 1_000_000
    latitude_deg, longitude_deg, height_m = HOME.to_geodetic(
        np.cumsum(rng.normal(size=(200, 3)), 0)
    )
    velocity = rng.normal(size=(200, 3))
    velocity[rng.random((200, 3)) < 0.2] = np.nan
    live, flight = trajectories(history_s=1e6), trajectories()
    for i, t in enumerate(t_ns.tolist()):
        add_sample(
            live,
            "a",
            t,
            latitude_deg=float(latitude_deg[i]),
            longitude_deg=float(longitude_deg[i]),
            height_m=float(height_m[i]),
            velocity_enu_m_s=velocity[i].tolist(),
            sigma_m=2.0,
            signature=SIGNATURE,
        )
    flight.add_flight(
        "a",
        t_ns,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=height_m,
        velocity_enu_m_s=velocity,
        sigma_m=np.full(200, 2.0),
        signature=SIGNATURE,
    )
    for t in rng.integers(t_ns[0] - NS, t_ns[-1] + 5 * NS, 300).tolist():
        one, other = live.state_at(t), flight.state_at(t)
        np.testing.assert_array_equal(one.position_ecef_m, other.position_ecef_m)
        np.testing.assert_array_equal(one.velocity_ecef_m_s, other.velocity_ecef_m_s)
    assert live.spans_ns.tolist() == flight.spans_ns.tolist()
