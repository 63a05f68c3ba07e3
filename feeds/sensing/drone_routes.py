"""The ways that drones of a scene are to fly: along waypoints, leg by leg, or as recorded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING

import numpy as np

from plotfeed.feeds.scene.drones import (
    Drone,
    FlightFile,
    HoverLeg,
    LandLeg,
    OrbitLeg,
    PlaceLeg,
    TakeOffLeg,
    echoes_of,
)
from plotfeed.feeds.scene.fields import Enu, Location, Site, geodetic, site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.telemetry.position_report import AltitudeDatum, PositionReport
from plotfeed.models.frames import LocalFrame, geodetic_to_ecef
from plotfeed.models.known_track import KnownTrack
from plotfeed.models.state import DRONE, Emitter, Floats, Signature
from plotfeed.models.truth import Trajectories
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.models.flight_plan import FlightPlan

MAX_LEG_M = 500.0
"""A straight line this long leaves the curve of constant height by 5 mm."""


@dataclass(frozen=True, slots=True)
class DroneRoute:
    """What a drone of a scene flies if nothing comes in between, from 0 ns on."""

    track: KnownTrack
    rejoined_ns: tuple[tuple[int, int], ...] = ()
    """Of each leg or way between waypoints when it ends, and where who has left it meanwhile goes
    on; none of a recorded flight, which goes on where it was left."""

    def rejoined(self, t_ns: int) -> int:
        """Where on its way a drone goes on that has left it then."""
        period_ns = self.track.period_ns
        cycle_ns = t_ns // period_ns * period_ns if period_ns else 0
        for end_ns, back_ns in self.rejoined_ns:
            if t_ns - cycle_ns < end_ns:
                return cycle_ns + back_ns
        return t_ns


class SceneSpace:
    """Places of a scene in metres east and north of its site, and above it, on the curved Earth."""

    def __init__(self, site: Site) -> None:
        self.site = site
        self.frame: LocalFrame = site_frame(site)

    def level_m(self, place: Location, offset_enu_m: Enu) -> Floats:
        """A place, moved by so much, as metres on the site's plane and above the site; (3,)."""
        if place.latitude_deg is None:
            at = np.array([place.east_m, place.north_m, place.above_site_m], np.float64)
            return at + offset_enu_m
        moved = geodetic(self.site, place, offset_enu_m)
        from plotfeed.models.flight_plan import level_from_ecef

        return level_from_ecef(self.frame, geodetic_to_ecef(*moved))

    def track(self, plan: FlightPlan, begin_ns: int = 0, *, repeat: bool = False) -> KnownTrack:
        """A plan as it is flown from then on."""
        from plotfeed.models.flight_plan import to_ecef

        t_s, position_m, velocity_m_s = to_ecef(self.frame, plan.knots())
        times_ns = [begin_ns + round(t * NS) for t in t_s.tolist()]
        return KnownTrack.smooth(times_ns, position_m, velocity_m_s, repeat=repeat)


def planned(space: SceneSpace, drone: Drone) -> DroneRoute:
    """A drone's way along its waypoints or by its legs."""
    if drone.leg:
        return _by_legs(space, drone)
    times_s, positions = knots(space.site, drone)
    times_ns = [round(t * NS) for t in times_s]
    places = len(drone.path) - 1 + drone.repeat
    ways = (len(list(_along(a, b))) for a, b in pairwise(_places(space.site, drone)))
    ends = [times_ns[k] for k in accumulate(ways)][:places]
    track = KnownTrack.straight(times_ns, positions, repeat=drone.repeat)
    return DroneRoute(track, tuple((end_ns, end_ns) for end_ns in ends))


def _by_legs(space: SceneSpace, drone: Drone) -> DroneRoute:
    offset_m = drone.offset_enu_m
    home_m = np.zeros(3) if drone.home is None else space.level_m(drone.home, offset_m)
    from plotfeed.models.flight_plan import FlightPlan

    plan = FlightPlan(drone.limits.model(), home_m)
    ends = []
    for leg in drone.leg:
        begin_s = plan.end_s
        match leg:
            case TakeOffLeg():
                plan.fly_to([*plan.place_m[:2], home_m[2] + leg.height_m])
            case PlaceLeg():
                plan.fly_to(space.level_m(leg, offset_m), leg.speed_m_s)
            case HoverLeg():
                plan.hover(leg.for_s)
            case OrbitLeg():
                plan.orbit(
                    space.level_m(leg, offset_m),
                    leg.radius_m,
                    turns=leg.turns,
                    speed_m_s=leg.speed_m_s,
                    is_clockwise=leg.clockwise,
                )
            case LandLeg():
                plan.fly_to([*plan.place_m[:2], home_m[2]])
        anew = isinstance(leg, HoverLeg | OrbitLeg)
        ends.append((round(plan.end_s * NS), round((begin_s if anew else plan.end_s) * NS)))
    if drone.repeat:
        plan.fly_to(home_m)
        ends.append((round(plan.end_s * NS), round(plan.end_s * NS)))
    return DroneRoute(space.track(plan, repeat=drone.repeat), tuple(ends))


def knots(site: Site, drone: Drone) -> tuple[list[float], Floats]:
    """Times from the start of a path, and ECEF positions (k, 3), on the curved Earth."""
    places = _places(site, drone)
    speeds = [w.speed_m_s or drone.speed_m_s or 0.0 for w in drone.path]
    if drone.repeat:
        speeds.append(drone.speed_m_s or speeds[-1])
    legs = [list(_along(a, b)) for a, b in pairwise(places)]
    positions = geodetic_to_ecef(*np.array([places[0], *(p for leg in legs for p in leg)]).T)
    lengths_m = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    leg_speeds_m_s = np.repeat(speeds[1:], [len(leg) for leg in legs])
    times_s = np.cumsum(np.maximum(lengths_m / leg_speeds_m_s, 1e-6))
    return [0.0, *times_s.tolist()], positions


def _along(start: Floats, end: Floats) -> Iterator[Sequence[float]]:
    """The places between two, short legs apart, without the first; the short way in longitude.

    Interpolated in latitude, longitude and height: over the legs that drones fly this is straight.
    """
    change = end - start
    change[1] = (change[1] + 180.0) % 360.0 - 180.0
    distance_m = float(np.linalg.norm(geodetic_to_ecef(*end) - geodetic_to_ecef(*start)))
    legs = max(1, int(np.ceil(distance_m / MAX_LEG_M)))
    for share in np.linspace(0, 1, legs + 1)[1:]:
        yield start + share * change


def _places(site: Site, drone: Drone) -> list[Floats]:
    """Geodetic places of a path, the first once more at the end of one that is repeated."""
    places = [geodetic(site, waypoint, drone.offset_enu_m) for waypoint in drone.path]
    return [*places, places[0]] if drone.repeat else places


def fly_recorded(
    trajectories: Trajectories, scene: Scene, drone: Drone, flight: FlightFile, begin_ns: int
) -> KnownTrack:
    """Put a recorded flight on its way; its track from 0 ns on. Raises `PlotfeedError`."""
    reports, heights_m, starts = _recorded_reports(scene, flight, begin_ns)
    accuracies = [(r.horizontal_accuracy_m, r.vertical_accuracy_m) for r in reports]
    track = trajectories.add_flight(
        drone.id,
        np.array([report.t_utc_ns for report in reports], np.int64),
        latitude_deg=np.array([report.latitude_deg for report in reports]),
        longitude_deg=np.array([report.longitude_deg for report in reports]),
        height_m=heights_m,
        velocity_enu_m_s=np.array([r.velocity_enu_m_s or [np.nan] * 3 for r in reports]),
        sigma_m=np.array(
            [max((a for a in pair if a is not None), default=np.nan) for pair in accuracies]
        ),
        signature=signature_of(scene, drone),
        starts=starts,
    )
    return track.later(-begin_ns)


def _recorded_reports(
    scene: Scene, recorded: FlightFile, begin_ns: int
) -> tuple[list[PositionReport], Floats, Sequence[int]]:
    """The reports of a flight that begins then, and their heights above the ellipsoid.

    And to which of them no flight leads from before.
    """
    from plotfeed.feeds.telemetry.flights.flight import FlightOptions

    options = FlightOptions(
        columns=recorded.columns,
        altitude_reference=recorded.altitude_reference,
        gps_order=recorded.gps_order,
        utc_offset_h=recorded.utc_offset_h,
        height_m=recorded.height_m,
        start_utc_ns=begin_ns,
        max_speed_m_s=scene.telemetry.max_speed_m_s,
    )
    from plotfeed.feeds.telemetry.flights import read, smoothed

    flight = smoothed(read(scene.file(recorded.file), options))
    takeoff_height_m = recorded.takeoff_height_m
    if takeoff_height_m is None:
        takeoff_height_m = scene.telemetry.takeoff_height_m
    sea_level = scene.sea_level(stated_m=recorded.geoid_undulation_m)
    datum = AltitudeDatum(takeoff_height_m, sea_level)
    references = [report.altitude_reference for report in flight.reports]
    for reference in dict.fromkeys(references):
        datum.check(reference)
    heights_m = datum.heights_m(
        [report.latitude_deg for report in flight.reports],
        [report.longitude_deg for report in flight.reports],
        [report.altitude_m for report in flight.reports],
        references,
    )
    shift_ns = begin_ns - flight.reports[0].t_utc_ns
    shifted = [replace(report, t_utc_ns=report.t_utc_ns + shift_ns) for report in flight.reports]
    return shifted, heights_m, flight.starts


def tells_echoes(scene: Scene) -> bool:
    """Whether it is stated of any drone how its echoes are."""
    return bool(scene.target) or any(d.swerling is not None for d in scene.fleet.kinds)


def usual_signature(scene: Scene) -> Signature:
    """What there is to sense of a drone that states nothing of itself; it emits nothing."""
    settings = scene.telemetry
    return Signature(
        rcs_m2=settings.rcs_m2,
        sound_power_db=settings.sound_power_db,
        size_m=settings.size_m,
        echoes=echoes_of(scene.target, DRONE) if tells_echoes(scene) else None,
    )


def signature_of(scene: Scene, drone: Drone) -> Signature:
    """What there is of a drone to sense, by the scene where the drone states nothing."""
    settings = scene.telemetry
    return Signature(
        rcs_m2=settings.rcs_m2 if drone.rcs_m2 is None else drone.rcs_m2,
        sound_power_db=(
            settings.sound_power_db if drone.sound_power_db is None else drone.sound_power_db
        ),
        emitters=tuple(Emitter(**e.model_dump()) for e in drone.emitters),
        size_m=settings.size_m if drone.size_m is None else drone.size_m,
        target_class=drone.target_class,
        model=drone.model,
        echoes=(
            echoes_of(scene.target, drone.target_class, drone.swerling)
            if tells_echoes(scene)
            else None
        ),
    )
