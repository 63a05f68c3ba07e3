"""The score of a tracker while a session runs: what it is by hand, and what comes over a broker."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from plotfeed.feeds.lab.live import EVERY_SECONDS, LiveScore
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.frames import LocalFrame
from plotfeed.testing import START_NS, held, radar, scene

NS = 10**9
SITE = LocalFrame(40.45, -3.73, 650.0)


class EverySecond(Observer):
    """Has a session scored at each second of its own time, with a tracker made up."""

    def __init__(self, live: LiveScore, tracker: Callable[[int], list[dict[str, Any]]]) -> None:
        self._live, self._tracker = live, tracker
        self._next_ns = START_NS + NS
        self.scores: list[dict[str, Any]] = []

    def before_due(self, due_utc_ns: int) -> None:
        """A second is over."""
        while due_utc_ns > self._next_ns:
            told = self._tracker(self._next_ns)
            if told:
                self._live.tracked("x", json.dumps(told).encode(), None, self._next_ns)
            found = self._live.score(self._next_ns)
            if found is not None:
                self.scores.append(found)
            self._next_ns += NS


def scored(
    made: Scene, seconds: float, tracker: Callable[[int], list[dict[str, Any]]]
) -> list[dict[str, Any]]:
    live = LiveScore()
    every = EverySecond(live, tracker)
    clock = InstantClock(START_NS)
    asyncio.run(run(made, clock=clock, broker="none", duration_s=seconds, observers=[live, every]))
    assert live.score(START_NS) is None  # the session is over
    return every.scores


def track(number: int, east_m: float, north_m: float, t_ns: int, **more: Any) -> dict[str, Any]:
    latitude_deg, longitude_deg, height_m = (
        float(v) for v in SITE.to_geodetic([east_m, north_m, 200.0])
    )
    return {
        "track": number,
        "latitude_deg": latitude_deg,
        "longitude_deg": longitude_deg,
        "height_m": height_m,
        "time_utc_ns": t_ns,
    } | more


def two() -> Scene:
    """Two drones that hover, 2 km north and 2 km east of a radar that sees both."""
    drones = [held("north", 0.0, 5.0, 2000.0), held("east", 90.0, 5.0, 2000.0)]
    return scene([radar()], drones, seed=5)


def test_figures_are_those_worked_out_by_hand() -> None:
    far_m = 2000.0 * np.cos(np.radians(5.0))

    def tracker(now_ns: int) -> list[dict[str, Any]]:
        """One drone 3 m off, half a second late; one track of nobody; the other drone is missed."""
        late_ns = now_ns - NS // 2
        return [track(1, 3.0, far_m, late_ns), track(2, 700.0, 700.0, late_ns)]

    last = scored(two(), 20.0, tracker)[-1]
    now = last["now"]
    assert last["drones"] == last["tracks"] == 2
    # 3 m of localisation, and 50^2 / 2 each for the missed drone and for the false track.
    assert now["gospa_m"] == pytest.approx(np.sqrt(9.0 + 2500.0), rel=1e-3)
    assert now["ospa_m"] == pytest.approx(np.sqrt((9.0 + 2500.0) / 2), rel=1e-3)
    assert now["completeness"] == 0.5
    assert now["spuriousness"] == 0.5
    assert now["position_error_m"] == pytest.approx(3.0, abs=0.1)
    assert now["latency_s"] == pytest.approx(0.5)
    assert last["window"]["completeness"] == pytest.approx(0.5, abs=0.15)


def test_birds_are_no_drones() -> None:
    """Ten of them, which the radar sees and no track is of."""
    way = [{"east_m": 500.0, "north_m": 1000.0 + n, "above_site_m": 100.0} for n in (0.0, 900.0)]
    birds = [{"id": "gulls", "count": 10, "rcs_m2": 0.1, "path": way}]
    made = scene([radar()], [held("north", 0.0, 5.0, 2000.0)], seed=5, birds=birds)
    far_m = 2000.0 * np.cos(np.radians(5.0))
    last = scored(made, 10.0, lambda now_ns: [track(1, 0.0, far_m, now_ns)])[-1]
    assert (last["drones"], last["tracks"], last["dimensions"]) == (1, 1, 2)
    assert last["now"]["completeness"] == 1.0
    assert last["now"]["gospa_m"] < 1.0


def test_a_track_goes_on_by_its_velocity_and_is_stale_after_a_while() -> None:
    far_m = 2000.0 * np.cos(np.radians(5.0))

    def tracker(now_ns: int) -> list[dict[str, Any]]:
        """Once, 30 m short of the drone at 10 m/s."""
        first = now_ns == START_NS + 5 * NS
        moving = {"velocity_east_m_s": 0.0, "velocity_north_m_s": 10.0}
        return [track(1, 0.0, far_m - 30.0, now_ns, **moving)] if first else []

    errors = {
        round(i + 1): s["now"]["position_error_m"]
        for i, s in enumerate(scored(two(), 16.0, tracker))
    }
    assert errors[5] == pytest.approx(30.0, abs=0.2)
    assert errors[8] == pytest.approx(0.0, abs=0.2)
    assert errors[12] is None


def test_of_a_tracker_that_nobody_hears_there_is_no_figure() -> None:
    scores = scored(two(), 8.0, lambda _: [])
    assert {s["reports"] for s in scores} == {0}
    assert {s["problem"] for s in scores} == {"no tracks have come"}
    assert all(value is None for s in scores for k in ("now", "window") for value in s[k].values())

    def late(now_ns: int) -> list[dict[str, Any]]:
        far_m = 2000.0 * np.cos(np.radians(5.0))
        return [track(1, 0.0, far_m, now_ns)] if now_ns >= START_NS + 10 * NS else []

    last = scored(two(), 20.0, late)[-1]
    assert last["problem"] == ""
    assert last["window"]["completeness"] == 0.5  # of the seconds since it is heard


def test_what_is_no_track_is_counted_and_harms_nothing() -> None:
    def tracker(now_ns: int) -> list[dict[str, Any]]:
        return [
            track(1, 0.0, 0.0, now_ns + 60 * NS),  # of the future
            track(2, 0.0, 0.0, now_ns) | {"latitude_deg": 123.0},
            track(3, 0.0, 0.0, now_ns, ended=True),
        ]

    scores = scored(two(), 8.0, tracker)
    assert scores[-1]["unreadable"] == 2 * scores[-1]["reports"]
    assert scores[-1]["tracks"] == 0
    live = LiveScore()
    live.tracked("x", b"\xff\x00garbage", None, START_NS)  # before any session


@pytest.mark.parametrize(
    ("keys", "wrong"), [({}, set()), ({"bias": {"azimuth_offset_deg": 2.0}}, {"azimuth"})]
)
def test_the_feed_is_checked_meanwhile(keys: dict[str, Any], wrong: set[str]) -> None:
    drones = [held(f"d{i}", 60.0 * i, 5.0, 2000.0 + 100 * i, rcs_m2=1.0) for i in range(5)]
    scores = scored(scene([radar(pfa=1e-5, **keys)], drones, seed=6), 31.0, lambda _: [])
    assert len(scores) >= 2 * EVERY_SECONDS
    told = scores[-1]["feed"]
    assert {each["check"] for each in told} >= {"azimuth", "range", "Pd", "false alarms", "time"}
    assert {each["check"] for each in told if each["wrong"]} == wrong
    json.dumps(scores[-1], allow_nan=False)


def test_of_a_sensor_that_changes_checks_begin_anew() -> None:
    event = {"from_s": 15.0, "to_s": 60.0, "set": {"bias": {"azimuth_offset_deg": 2.0}}}
    drones = [held(f"d{i}", 60.0 * i, 5.0, 2000.0 + 100 * i, rcs_m2=1.0) for i in range(5)]
    scores = scored(scene([radar(event=[event])], drones, seed=7), 41.0, lambda _: [])
    named = [{each["check"] for each in s["feed"] if each["wrong"]} for s in scores]
    assert not any(named[:14])
    assert named[-1] == {"azimuth"}
    (azimuth,) = (each for each in scores[-1]["feed"] if each["check"] == "azimuth")
    assert abs(azimuth["found"] - 2.0) < 0.2  # of the new keys alone
