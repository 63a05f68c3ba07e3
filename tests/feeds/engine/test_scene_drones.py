"""Drones of a scene fly their legs, and leave them by what happens: where they truly are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from plotfeed.feeds.engine.scene_drones import SceneDrones, launch
from plotfeed.feeds.scene.drones import Hold, Resume, Stray
from plotfeed.models.frames import ecef_to_geodetic
from plotfeed.models.state import Floats
from plotfeed.models.truth import Trajectories
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS
from plotfeed.testing import SITE, START_NS, radar, scene

PLACE = {"east_m": 600.0, "north_m": 0.0, "above_site_m": 50.0}
LEGS: list[dict[str, Any]] = [
    {"kind": "take-off", "height_m": 50.0},
    {"kind": "to", **PLACE, "speed_m_s": 10.0},
    {"kind": "hover", "for_s": 20.0},
    {"kind": "orbit", **PLACE, "radius_m": 100.0, "turns": 2.0, "speed_m_s": 10.0},
    {"kind": "to", "east_m": 0.0, "north_m": 0.0, "above_site_m": 50.0, "speed_m_s": 10.0},
    {"kind": "land"},
]
HOME = {"east_m": 0.0, "north_m": 0.0, "above_site_m": 5.0}
PATH = [
    {"east_m": -2000.0, "north_m": 0.0, "above_site_m": 60.0},
    {"east_m": 2000.0, "north_m": 0.0, "above_site_m": 60.0},
]


class Flown:
    """The drones of a scene that nobody looks at."""

    def __init__(self, *drones: dict[str, Any], start_ns: int = START_NS, **more: Any) -> None:
        self.start_ns = start_ns
        self.trajectories = Trajectories(stale_after_s=3.0)
        made = scene([radar()], list(drones), seed=31, **more)
        self.drones: SceneDrones = launch(made, self.trajectories, start_ns)

    def at(self, *times_s: float, name: str = "a") -> Floats:
        """East, north and height above the site at those times; NaN while it is not there."""
        row = np.full(len(times_s), self.trajectories.names.index(name))
        t_ns = np.array([self.start_ns + round(t * NS) for t in times_s])
        places = self.trajectories.position_at(t_ns, row)
        enu = SITE.from_ecef(places)
        enu[:, 2] = ecef_to_geodetic(places)[2] - SITE.height_m
        return enu

    def last(self, from_s: float, to_s: float) -> Floats:
        """Where it is at last, of when it is there."""
        places = self.at(*np.arange(from_s, to_s, 0.25))
        return places[np.isfinite(places[:, 0])][-1]

    def is_there(self, time_s: float) -> bool:
        return bool(np.isfinite(self.at(time_s)).all())

    def doing(self, time_s: float) -> str:
        return self.drones.doing("a", self.start_ns + round(time_s * NS))

    def happen(self, what: Any, time_s: float) -> None:
        self.drones.happen("a", what, self.start_ns + round(time_s * NS))


def on_legs(**more: Any) -> dict[str, Any]:
    return {"id": "a", "home": HOME, "leg": LEGS} | more


def on_path(*happenings: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"id": "a", "path": PATH, "speed_m_s": 20.0, "contingency": list(happenings)} | more


def test_legs_are_flown_one_after_the_other_and_then_it_is_gone() -> None:
    flown = Flown(on_legs())
    # Up 50 m at 6 m/s, 600 m at 10 m/s, each with 4 m/s2: 9.83 s and 62.5 s.
    up_s, there_s = 50 / 6 + 6 / 4, 600 / 10 + 10 / 4
    rising = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, 55.0]])
    assert flown.at(0.0, up_s) == pytest.approx(rising, abs=1e-3)
    hovering = flown.at(up_s + there_s, up_s + there_s + 19.9)
    assert hovering == pytest.approx(np.array([[600.0, 0.0, 50.0]] * 2), abs=0.05)
    orbiting = flown.at(*np.linspace(up_s + there_s + 40.0, up_s + there_s + 120.0, 50))
    assert np.hypot(orbiting[:, 0] - 600.0, orbiting[:, 1]) == pytest.approx(100.0, abs=0.01)
    assert flown.last(0.0, 400.0) == pytest.approx([0.0, 0.0, 5.0], abs=1.0)
    assert not flown.is_there(400.0)


def test_legs_that_are_repeated_begin_again_at_home() -> None:
    flown = Flown(on_legs(leg=LEGS[:3], repeat=True))
    times = np.arange(1.0, 400.0, 0.01)
    home = np.isclose(flown.at(*times), [0.0, 0.0, 5.0], atol=1e-3).all(axis=1)
    period_s = times[home][0]
    assert flown.at(period_s + 30.0) == pytest.approx(flown.at(30.0), abs=0.2)


def test_a_lost_link_brings_it_home_as_high_as_asked_and_down() -> None:
    lost = {"kind": "lost-link", "at_s": 50.0, "hold_s": 5.0, "return_height_m": 90.0}
    flown = Flown(on_path(lost))
    assert flown.at(50.0)[0, 0] == pytest.approx(-1000.0, abs=0.05)
    assert flown.at(56.0, 59.0)[:, 0] == pytest.approx(-950.0, abs=0.05)  # 20 m/s, 4 m/s2
    assert np.nanmax(flown.at(*np.arange(60.0, 200.0, 0.25))[:, 2]) == pytest.approx(90.0, abs=0.01)
    assert flown.last(60.0, 250.0) == pytest.approx([-2000.0, 0.0, 0.0], abs=0.5)
    assert (flown.doing(49.0), flown.doing(60.0)) == ("", "lost-link")
    assert not flown.is_there(250.0)


@pytest.mark.parametrize(
    ("course", "toward"), [({}, (1.0, 0.0)), ({"course_deg": 180.0}, (0.0, -1.0))]
)
def test_a_drone_that_flies_away_keeps_on_through_its_fence(
    course: dict[str, float], toward: tuple[float, float]
) -> None:
    away = {"kind": "fly-away", "at_s": 100.0, "speed_m_s": 15.0, "climb_m_s": 2.0, **course}
    fence = {"radius_m": 4000.0, "above_home_m": 120.0}
    flown = Flown(on_path({**away, "for_s": 300.0}, geofence=fence, home=HOME))
    a, b = flown.at(150.0, 250.0)
    assert (b - a) / 100.0 == pytest.approx([*(15.0 * np.array(toward)), 2.0], abs=0.02)
    assert flown.is_there(399.0)
    assert not flown.is_there(420.0)


def test_who_strays_comes_back_to_its_way() -> None:
    place = {"east_m": -500.0, "north_m": 300.0, "above_site_m": 60.0}
    flown = Flown(on_path({"kind": "stray", "at_s": 60.0, "hold_s": 4.0, **place}))
    places = flown.at(*np.arange(60.0, 150.0, 0.25))
    assert np.hypot(places[:, 0] + 500.0, places[:, 1] - 300.0).min() < 0.1
    assert flown.doing(70.0) == "stray"
    end_s = next(t for t in np.arange(70.0, 400.0, 0.25) if flown.doing(t) == "")
    assert flown.at(end_s - 0.5) == pytest.approx(np.array([[2000.0, 0.0, 60.0]]), abs=1.0)


def test_who_left_an_orbit_flies_it_anew_and_who_left_a_way_goes_to_its_end() -> None:
    place = {"east_m": 600.0, "north_m": 300.0, "above_site_m": 60.0}
    plain = Flown(on_legs())
    orbiting = Flown(on_legs(contingency=[{"kind": "stray", "at_s": 160.0, **place}]))
    back_s = next(t for t in np.arange(165.0, 400.0, 0.05) if orbiting.doing(t) == "")
    assert orbiting.at(back_s + 30.0) == pytest.approx(plain.at(92.33 + 30.0), abs=2.0)
    on_way = Flown(on_legs(contingency=[{"kind": "stray", "at_s": 40.0, **place}]))
    back_s = next(t for t in np.arange(45.0, 400.0, 0.05) if on_way.doing(t) == "")
    assert on_way.at(back_s) == pytest.approx(np.array([[600.0, 0.0, 50.0]]), abs=0.2)


def test_a_low_battery_lands_it_where_it_is() -> None:
    flown = Flown(on_path({"kind": "low-battery", "at_s": 30.0}))
    assert flown.at(36.0)[0, 0] == pytest.approx(-1350.0, abs=0.05)
    assert flown.last(36.0, 70.0) == pytest.approx([-1350.0, 0.0, 0.0], abs=0.3)
    assert not flown.is_there(70.0)


@pytest.mark.parametrize(
    ("does", "end"),
    [("hold", [1550.0, 0.0, 60.0]), ("return", [0.0, 0.0, 5.0]), ("land", [1550.0, 0.0, 5.0])],
)
def test_a_geofence_stops_it_where_it_has_braked(does: str, end: list[float]) -> None:
    fence = {"radius_m": 1500.0, "does": does}
    flown = Flown(on_path(geofence=fence, home=HOME, start_s=3.0))
    # It sets out beyond its fence, and leaves it 3500 m later; 50 m are its way to brake.
    crossed_s = 3.0 + 3500.0 / 20.0
    assert flown.doing(crossed_s - 0.01) == ""
    assert flown.doing(crossed_s + 0.01) == "geofence"
    times = crossed_s, crossed_s + 130.0
    assert np.nanmax(flown.at(*np.arange(*times, 0.25))[:, 0]) == pytest.approx(1550.0, abs=0.1)
    assert flown.last(*times) == pytest.approx(end, abs=1.5)


def test_a_fence_has_a_top_and_is_minded_on_the_way_astray() -> None:
    place = {"east_m": 100.0, "north_m": 0.0, "above_site_m": 300.0}
    stray = {"kind": "stray", "at_s": 30.0, **place}
    fence = {"radius_m": 5000.0, "above_home_m": 120.0, "does": "hold"}
    flown = Flown(on_path(stray, geofence=fence, home=HOME))
    places = flown.at(*np.arange(30.0, 500.0, 0.25))
    assert 125.0 < np.nanmax(places[:, 2]) < 135.0
    assert flown.doing(499.0) == "geofence"


def test_what_is_commanded_goes_before_what_the_scene_wants_later() -> None:
    """The script's own still happens, unless the drone is not there any more."""
    low = {"kind": "low-battery", "at_s": 150.0}
    flown = Flown(on_path(low))
    flown.happen(Hold(kind="hold"), 60.0)
    assert (flown.doing(100.0), flown.doing(151.0)) == ("hold", "low-battery")
    assert flown.at(100.0)[0, 0] == pytest.approx(-750.0, abs=0.1)
    flown.happen(Resume(kind="resume"), 80.0)
    assert flown.doing(130.0) == "resume"
    flown = Flown(on_path({"kind": "low-battery", "at_s": 30.0}))
    with pytest.raises(PlotfeedError, match="not there then"):
        flown.happen(Hold(kind="hold"), 200.0)
    with pytest.raises(PlotfeedError, match="it is on its way"):
        Flown(on_path()).happen(Resume(kind="resume"), 10.0)


def test_it_is_the_same_whenever_the_session_begins() -> None:
    """To the last bit: geofence, contingencies and legs count from the start."""
    fence = {"radius_m": 650.0}
    drone = on_legs(geofence=fence, contingency=[{"kind": "stray", "at_s": 40.0, **PATH[1]}])
    made = scene([radar()], [drone], seed=31)
    whole, late = Trajectories(stale_after_s=3.0), Trajectories(stale_after_s=3.0)
    launch(made, whole, START_NS)
    by_ns = 146_800_123
    launch(made, late, START_NS - by_ns).put_off(by_ns)
    times = START_NS + np.arange(0, 120 * NS, NS // 3)
    rows = np.zeros(len(times), np.int64)
    assert np.array_equal(
        whole.position_at(times, rows), late.position_at(times, rows), equal_nan=True
    )


SWARM = {
    "id": "s", "number": 9, "path": PATH, "speed_m_s": 20.0, "stagger_s": 1.0,
    "formation": {"kind": "grid", "spacing_m": 30.0},
    "emitters": [{"frequency_hz": 2.4e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0, "identity": "x"}],
}  # fmt: skip


def test_a_swarm_flies_in_formation_each_later_than_the_one_before() -> None:
    flown = Flown(swarm=[SWARM])
    assert flown.trajectories.names == [f"s-{n}" for n in range(1, 10)]
    corner, middle = (flown.at(20.0 + n, name=f"s-{n + 1}") for n in (0, 4))
    assert corner - middle == pytest.approx(np.array([[-30.0, 30.0, 0.0]]), abs=0.01)
    assert not np.isfinite(flown.at(3.0, name="s-9")).any()
    assert [e[0].identity for e in flown.trajectories.signatures.emitters] == [
        f"x-{n}" for n in range(1, 10)
    ]


@pytest.mark.parametrize("kind", ["line", "circle"])
def test_neighbours_of_a_formation_are_so_far_apart(kind: str) -> None:
    formation = {"kind": kind, "spacing_m": 25.0}
    flown = Flown(swarm=[SWARM | {"formation": formation, "stagger_s": 0.0}])
    places = np.concatenate([flown.at(5.0, name=f"s-{n}") for n in range(1, 10)])
    apart_m = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert apart_m == pytest.approx(25.0, abs=0.01)
    assert places.mean(axis=0) == pytest.approx([-1900.0, 0.0, 60.0], abs=0.05)


def test_a_random_formation_is_by_the_seed_and_within_its_cylinder() -> None:
    area = {"kind": "random", "radius_m": 200.0, "height_spread_m": 60.0}
    swarm = SWARM | {"formation": area, "stagger_s": 0.0, "number": 400}
    places = [Flown(swarm=[swarm]).trajectories.state_at(START_NS).position_ecef_m for _ in "ab"]
    assert np.array_equal(*places)
    enu = SITE.from_ecef(places[0]) - [-2000.0, 0.0, 59.7]
    away_m = np.hypot(enu[:, 0], enu[:, 1])
    assert away_m.max() < 200.0
    assert 0.4 < (away_m < 200.0 / 2**0.5).mean() < 0.6  # evenly over the area
    assert np.abs(enu[:, 2]).max() < 30.1
    assert np.ptp(enu[:, 2]) > 50.0


@pytest.mark.parametrize(
    ("drone", "expected"),
    [
        ({"path": PATH}, "a drone has either a path, a flight or legs"),
        ({"home": None}, "home of 'a': needed with leg"),
        ({"leg": [LEGS[-1], LEGS[0]]}, r"leg\[0\] of 'a': nothing comes after land"),
        ({"repeat": True}, "repeat of 'a': who has landed is gone"),
        ({"speed_m_s": 9.0}, "speed_m_s of 'a': of a path; legs have their own"),
        ({"limits": {"speed_m_s": 9.0}}, r"leg\[1\].speed_m_s of 'a': at most 9 m/s by its limits"),
        ({"leg": [{"kind": "orbit", **PLACE, "radius_m": 5.0, "speed_m_s": 8.0}]},
         r"at most 4 m/s by its limits, on a circle of 5 m"),
        ({"contingency": [{"kind": "hold"}]}, r"contingency\[0\].at_s of 'a': missing"),
        ({"contingency": [{"kind": "hold", "at_s": 9.0}, {"kind": "resume", "at_s": 9.0}]},
         r"contingency\[1\].at_s of 'a': must be above"),
        ({"contingency": [{"kind": "hold", "at_s": 5e3}]},
         r"'a': hold: it is not there then.*\[0\]"),
        ({"home": None, "leg": None, "flight": {"file": "no.csv"}}, r"no\.csv: cannot be read"),
        ([SWARM, SWARM], r"swarm\[1\].id: the id 's' is used twice"),
        ([SWARM | {"id": "a", "number": 0}], r"swarm\[0\].number of 'a'"),
        ([SWARM | {"claim": [{"from_s": 1.0, "freeze": True}]}],
         r"swarm\[0\].claim of 's': the drone says nothing: it is not \[cooperative\]"),
    ],
)  # fmt: skip
def test_what_no_drone_and_no_swarm_can_be_is_refused_with_its_key(
    drone: dict[str, Any] | list[dict[str, Any]], expected: str
) -> None:
    swarms = drone if isinstance(drone, list) else []
    one = on_path() if isinstance(drone, list) else on_legs(**drone)
    with pytest.raises(PlotfeedError, match=expected):
        Flown({k: v for k, v in one.items() if v is not None}, swarm=swarms)


def test_a_path_that_ends_when_no_time_can_be_told_is_refused() -> None:
    ends = [{"east_m": m, "north_m": m, "above_site_m": 0.0} for m in (1e6, -1e6)]
    slow = on_path(path=ends * 3, speed_m_s=0.01, start_s=1e9)
    with pytest.raises(PlotfeedError, match="'a': path: it ends after the year 2262"):
        Flown(slow, start_ns=230 * 365 * 86_400 * NS)


def test_one_by_latitude_is_moved_like_one_by_metres() -> None:
    of = map(float, SITE.to_geodetic(np.array([100.0, 200.0, 30.0])))
    place = dict(zip(("latitude_deg", "longitude_deg", "height_m"), of, strict=True))
    further = place | {"latitude_deg": place["latitude_deg"] + 0.01}
    drone = {"id": "a", "path": [place, further], "speed_m_s": 10.0, "offset_enu_m": [40, -30, 5]}
    assert Flown(drone).at(0.0) == pytest.approx(np.array([[140.0, 170.0, 35.0]]), abs=0.01)


def test_a_command_to_stray_is_by_the_drone_s_own_place() -> None:
    flown = Flown(on_path(offset_enu_m=[0.0, 50.0, 0.0]))
    place = {"east_m": -1500.0, "north_m": 0.0, "above_site_m": 60.0}
    flown.happen(Stray(kind="stray", hold_s=100.0, **place), 10.0)
    assert flown.at(60.0) == pytest.approx(np.array([[-1500.0, 50.0, 60.0]]), abs=0.03)
