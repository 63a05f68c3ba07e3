from __future__ import annotations

import numpy as np
import pytest

from plotfeed.models.frames import LocalFrame
from plotfeed.models.track_metrics import FlightPath, Level, along_enu, covered_at, rates, stays_of

NS = 1_000_000_000
T_NS = 1_767_268_800 * NS
FRAME = LocalFrame(40.45, -3.73, 650.0)


def turning(t_s: np.ndarray) -> np.ndarray:
    """15 m/s on a circle of 60 m: 3.75 m/s2."""
    angle = t_s * 15.0 / 60.0
    return np.stack([60 * np.cos(angle), 60 * np.sin(angle), 100 + 0 * t_s], axis=-1)


def path_of(t_s: np.ndarray, gap_s: float = 6.0) -> FlightPath:
    t_ns = T_NS + np.round(t_s * NS).astype(np.int64)
    return FlightPath.of(t_ns, FRAME.to_ecef(turning(t_s)), round(gap_s * NS))


def test_between_looks_of_a_second_a_turn_is_known_to_centimetres() -> None:
    path = path_of(np.arange(0.0, 30.0, 1.0))
    t_s = np.linspace(2.0, 27.0, 301)
    place_m, velocity_m_s = path.states_at(T_NS + np.round(t_s * NS).astype(np.int64))
    wrong_m = np.linalg.norm(FRAME.from_ecef(place_m) - turning(t_s), axis=1)
    assert wrong_m.max() < 0.06
    speed_m_s = np.linalg.norm(velocity_m_s, axis=1)
    assert np.abs(speed_m_s - 15.0).max() < 0.35


def test_looks_of_several_sensors_in_any_order_are_one_flight() -> None:
    rng = np.random.default_rng(1)
    t_s = np.sort(np.concatenate([np.arange(0.0, 30.0, 1.0), rng.uniform(0, 29, 40)]))
    rng.shuffle(t_s)
    path = path_of(t_s)
    assert (np.diff(path.t_utc_ns) > 0).all()
    at_s = np.linspace(2.0, 27.0, 301)
    place_m, _ = path.states_at(T_NS + np.round(at_s * NS).astype(np.int64))
    assert np.linalg.norm(FRAME.from_ecef(place_m) - turning(at_s), axis=1).max() < 0.06


def test_beyond_the_ends_and_in_gaps_it_is_not_there() -> None:
    path = path_of(np.array([0.0, 1.0, 2.0, 10.0, 11.0]))
    t_s = np.array([-0.1, 0.0, 1.5, 2.0, 5.0, 10.5, 11.0, 11.1])
    place_m, _ = path.states_at(T_NS + np.round(t_s * NS).astype(np.int64))
    there = np.isfinite(place_m[:, 0]).tolist()
    assert there[:3] == [False, True, True]
    assert there[4:] == [False, True, True, False]


@pytest.mark.parametrize("count", [0, 1])
def test_of_one_look_no_flight_follows(count: int) -> None:
    path = path_of(np.arange(float(count)))
    place_m, velocity_m_s = path.states_at(np.array([T_NS]))
    assert np.isnan(place_m).all()
    assert np.isnan(velocity_m_s).all()


def test_cover_is_between_looks_that_are_near_each_other() -> None:
    looks = np.array([0, 1, 2, 10, 11])
    at = np.array([-1, 0, 1, 2, 5, 10, 11, 12])
    assert covered_at(looks, at, 3).tolist() == [False, *[True] * 3, False, True, True, False]
    assert stays_of(looks, 3) == [(0, 2), (10, 11)]
    assert stays_of(looks[:0], 3) == []


def test_errors_over_the_ground_are_east_and_north_at_the_drone() -> None:
    """20 km from the site, where the site's own horizontal leans by a fifth of a degree."""
    place = FRAME.to_ecef(np.array([14_000.0, 14_000.0, 300.0]))
    latitude_deg, longitude_deg, height_m = FRAME.to_geodetic([14_000.0, 14_000.0, 300.0])
    there = LocalFrame(float(latitude_deg), float(longitude_deg), float(height_m))
    assert np.linalg.norm(there.origin_ecef_m - place) < 1e-6
    wrong = there.to_geodetic(np.array([30.0, -40.0, 7.0]))
    level = Level(float(height_m))
    at = (np.array([each]) for each in (latitude_deg, longitude_deg))
    true_point = level.points(latitude_deg, longitude_deg, height_m)[None]
    point = level.points(wrong[0], wrong[1], wrong[2])[None]
    error_m = along_enu(point - true_point, *at)
    assert error_m[0] == pytest.approx([30.0, -40.0, 7.0], abs=2e-3)
    assert np.linalg.norm((point - true_point)[0, :3]) == pytest.approx(50.0, abs=2e-3)


def test_a_velocity_moves_a_point_as_far_as_it_says() -> None:
    rate = rates(np.array([40.0]), np.array([-3.0]), np.array([[3.0, -4.0, np.nan]]))[0]
    assert np.linalg.norm(rate[:3]) == pytest.approx(5.0)
    assert rate[3] == 0.0
    back = along_enu(rate[None], np.array([40.0]), np.array([-3.0]))[0]
    assert back == pytest.approx([3.0, -4.0, 0.0])
