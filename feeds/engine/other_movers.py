"""The birds, cars and wind turbines of a scene, put on their ways beside its drones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plotfeed.feeds.scene.fields import Location, Site, geodetic
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.world_keys import BirdsKeys, RoadKeys, TurbineKeys
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import LocalFrame, geodetic_to_ecef
from plotfeed.models.movers import Wander, airspeed_m_s, cars_on, other_name, rotor_knots
from plotfeed.models.state import Floats, Signature
from plotfeed.models.truth import KnownTrack, Trajectories
from plotfeed.proto.utc import NS

STEPS_A_MEMORY = 5  # Knots of a bird's way in the time that it remembers a velocity
MAX_KNOTS = 100_000  # Of all birds of a flock: beyond, they are further apart in time
ROTOR_KNOTS = 48  # Of a turn: the cubics between them leave the circle by a millionth of the radius
STILL_M = 1e-3


def launch_others(scene: Scene, trajectories: Trajectories, start_utc_ns: int) -> None:
    """Put all that a scene names beside drones on its way."""
    for birds in scene.birds:
        _launch_birds(scene, birds, trajectories, start_utc_ns)
    for road in scene.road:
        _launch_cars(scene, road, trajectories, start_utc_ns)
    for turbine in scene.turbine:
        _launch_turbine(scene, turbine, trajectories, start_utc_ns)


def _chance(scene: Scene, name: str) -> np.random.Generator:
    """Draws of a mover's own, whatever else is in the scene."""
    return Chance(scene.scene.seed, name).rng(Purpose.MOVERS, 0)


def _along(site: Site, path: Sequence[Location], speed_m_s: float) -> tuple[Floats, Floats]:
    """Times from 0, seconds, and ECEF positions (k, 3), along a way at that speed."""
    places = geodetic_to_ecef(*np.array([geodetic(site, place) for place in path]).T)
    lengths_m = np.linalg.norm(np.diff(places, axis=0), axis=1)
    return np.append(0.0, np.cumsum(np.maximum(lengths_m, STILL_M))) / speed_m_s, places


def _launch_birds(
    scene: Scene, birds: BirdsKeys, trajectories: Trajectories, start_utc_ns: int
) -> None:
    """A flock about its leader; one that repeats ends where it began."""
    speed_m_s = birds.speed_m_s or float(airspeed_m_s(birds.mass_kg))
    path = [*birds.path, birds.path[0]] if birds.repeat else birds.path
    times_s, places = _along(scene.scene.site, path, speed_m_s)
    most = max(MAX_KNOTS // birds.count, len(path))
    steps = int(np.clip(times_s[-1] * STEPS_A_MEMORY / birds.wander_s, len(path), most))
    step_s = float(times_s[-1]) / steps
    at_s = np.linspace(0.0, times_s[-1], steps + 1)
    leg = np.clip(np.searchsorted(times_s, at_s, side="right") - 1, 0, len(times_s) - 2)
    leg_velocity = np.diff(places, axis=0) / np.diff(times_s)[:, None]
    leader = places[leg] + leg_velocity[leg] * (at_s - times_s[leg])[:, None]
    rng = _chance(scene, f"bird/{birds.id}")
    wander = Wander(sigma_m_s=birds.wander_m_s, time_constant_s=birds.wander_s)
    way_m, velocity_m_s = wander.walk(step_s, steps, (birds.count, 3), rng)
    if birds.repeat:  # what is left of a way at its end is taken back evenly
        way_m = way_m - np.linspace(0, 1, steps + 1)[:, None, None] * way_m[-1]
        velocity_m_s[-1] = velocity_m_s[0]
    way_m = way_m + birds.spread_m * rng.standard_normal((birds.count, 3))
    begin_ns = start_utc_ns + round(birds.start_s * NS)
    t_utc_ns = [begin_ns + round(t * NS) for t in at_s.tolist()]
    signature = Signature(rcs_m2=birds.rcs_m2, size_m=birds.size_m, target_class="bird")
    for n in range(birds.count):
        track = KnownTrack.smooth(
            t_utc_ns,
            leader + way_m[:, n],
            leg_velocity[leg] + velocity_m_s[:, n],
            repeat=birds.repeat,
        )
        trajectories.add_track(other_name("bird", birds.id, n + 1), track, signature)


def _launch_cars(
    scene: Scene, road: RoadKeys, trajectories: Trajectories, start_utc_ns: int
) -> None:
    """Cars that go to the end and back for ever, a Poisson number of them, anywhere on the loop."""
    there_and_back = [*road.path, *reversed(road.path[:-1])]
    times_s, places = _along(scene.scene.site, there_and_back, road.speed_m_s)
    rng = _chance(scene, f"vehicle/{road.id}")
    loop_m = float(times_s[-1]) * road.speed_m_s
    cars = cars_on(road.cars_per_h, road.speed_m_s, loop_m, rng)
    signature = Signature(rcs_m2=road.rcs_m2, size_m=road.size_m, target_class="vehicle")
    for n, share in enumerate(rng.random(cars).tolist()):
        begin_ns = start_utc_ns - round(share * float(times_s[-1]) * NS)
        t_utc_ns = [begin_ns + round(t * NS) for t in times_s.tolist()]
        track = KnownTrack.straight(t_utc_ns, places, repeat=True)
        trajectories.add_track(other_name("vehicle", road.id, n + 1), track, signature)


def _launch_turbine(
    scene: Scene, turbine: TurbineKeys, trajectories: Trajectories, start_utc_ns: int
) -> None:
    """The tower, which stands, and a point at the tip of each blade, which goes round."""
    hub = LocalFrame(*(float(x) for x in geodetic(scene.scene.site, turbine)))
    still = hub.origin_ecef_m + np.array([[0.0] * 3, [STILL_M, 0.0, 0.0]])
    tower = KnownTrack.straight([start_utc_ns, start_utc_ns + 3600 * NS], still, repeat=True)
    name = other_name("turbine", turbine.id)
    trajectories.add_track(
        name,
        tower,
        Signature(rcs_m2=turbine.tower_rcs_m2, size_m=turbine.radius_m, target_class="turbine"),
    )
    blade = Signature(rcs_m2=turbine.blade_rcs_m2, size_m=1.0, target_class="turbine")
    first = float(_chance(scene, name).random())
    for n in range(turbine.blades):
        at_s, place_enu_m, velocity_enu_m_s = rotor_knots(
            turbine.axis_azimuth_deg,
            turbine.radius_m,
            turbine.tip_speed_m_s,
            first + n / turbine.blades,
            ROTOR_KNOTS,
        )
        track = KnownTrack.smooth(
            [start_utc_ns + round(t * NS) for t in at_s.tolist()],
            hub.to_ecef(place_enu_m),
            hub.rotate_to_ecef(velocity_enu_m_s),
            repeat=True,
        )
        trajectories.add_track(other_name("turbine", turbine.id, n + 1), track, blade)
