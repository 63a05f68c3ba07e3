"""The drones that a scene flies by itself: put on their way, and off it by what comes between."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from operator import attrgetter

import numpy as np

from plotfeed.feeds.scene.drones import (
    Contingency,
    Drone,
    FlightFile,
    FlyAway,
    GeofenceKeys,
    Hold,
    HoverLeg,
    LandLeg,
    LostLink,
    LowBattery,
    OrbitLeg,
    PlaceLeg,
    Resume,
    Stray,
    TakeOffLeg,
    echoes_of,
)
from plotfeed.feeds.scene.fields import Enu, Location, Site, geodetic, site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.telemetry.position_report import LATEST_UTC_NS, AltitudeDatum
from plotfeed.models.flight_plan import FlightPlan, level_from_ecef, level_velocity, to_ecef
from plotfeed.models.frames import LocalFrame, geodetic_to_ecef
from plotfeed.models.state import DRONE, Bools, Emitter, Floats, Ints, Signature
from plotfeed.models.truth import (
    FOREVER_NS,
    MAX_TRACKS,
    FlightSamples,
    KnownTrack,
    Stretches,
    Trajectories,
)
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

MAX_LEG_M = 500.0  # A straight line this long leaves the curve of constant height by 5 mm


@dataclass(frozen=True, slots=True)
class DroneRoute:
    """What a drone of a scene flies if nothing comes in between, from 0 ns on."""

    track: KnownTrack
    # Of each leg or way between waypoints when it ends, and where who has left it meanwhile goes
    # on; none of a recorded flight, which goes on where it was left.
    rejoined_ns: tuple[tuple[int, int], ...] = ()

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
        return level_from_ecef(self.frame, geodetic_to_ecef(*moved))

    def track(self, plan: FlightPlan, begin_ns: int = 0, *, repeat: bool = False) -> KnownTrack:
        """A plan as it is flown from then on."""
        t_s, position_m, velocity_m_s = to_ecef(self.frame, plan.knots())
        times_ns = [begin_ns + round(t * NS) for t in t_s.tolist()]
        return KnownTrack.smooth(times_ns, position_m, velocity_m_s, repeat=repeat)


def planned(space: SceneSpace, drone: Drone) -> DroneRoute:
    """A drone's way along its waypoints, on the curved Earth, or by its legs."""
    if drone.leg:
        return _by_legs(space, drone)
    places = [geodetic(space.site, waypoint, drone.offset_enu_m) for waypoint in drone.path]
    speeds_m_s = [w.speed_m_s or drone.speed_m_s or 0.0 for w in drone.path]
    if drone.repeat:
        places.append(places[0])
        speeds_m_s.append(drone.speed_m_s or speeds_m_s[-1])
    ways = [list(_along(a, b)) for a, b in pairwise(places)]
    positions = geodetic_to_ecef(*np.array([places[0], *(p for way in ways for p in way)]).T)
    lengths_m = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    at_m_s = np.repeat(speeds_m_s[1:], [len(way) for way in ways])
    times_s = np.cumsum(np.maximum(lengths_m / at_m_s, 1e-6))
    times_ns = [0, *(round(t * NS) for t in times_s.tolist())]
    ends_ns = [times_ns[k] for k in accumulate(map(len, ways))]
    track = KnownTrack.straight(times_ns, positions, repeat=drone.repeat)
    return DroneRoute(track, tuple((end_ns, end_ns) for end_ns in ends_ns))


def _by_legs(space: SceneSpace, drone: Drone) -> DroneRoute:
    offset_m = drone.offset_enu_m
    home_m = np.zeros(3) if drone.home is None else space.level_m(drone.home, offset_m)
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


def fly_recorded(
    trajectories: Trajectories, scene: Scene, drone: Drone, recorded: FlightFile, begin_ns: int
) -> KnownTrack:
    """Put a recorded flight on its way; its track from 0 ns on. Raises `PlotfeedError`."""
    from plotfeed.feeds.telemetry.flights import read, smoothed
    from plotfeed.feeds.telemetry.flights.flight import FlightOptions

    settings = scene.telemetry
    options = recorded.made(
        FlightOptions, start_utc_ns=begin_ns, max_speed_m_s=settings.max_speed_m_s
    )
    flight = smoothed(read(scene.file(recorded.file), options))
    takeoff_height_m = recorded.takeoff_height_m
    if takeoff_height_m is None:
        takeoff_height_m = settings.takeoff_height_m
    datum = AltitudeDatum(takeoff_height_m, scene.sea_level(stated_m=recorded.geoid_undulation_m))
    reports = flight.reports
    references = [report.altitude_reference for report in reports]
    for reference in dict.fromkeys(references):
        datum.check(reference)
    latitude_deg = [report.latitude_deg for report in reports]
    longitude_deg = [report.longitude_deg for report in reports]
    altitude_m = [report.altitude_m for report in reports]
    shift_ns = begin_ns - reports[0].t_utc_ns
    samples = FlightSamples(
        t_utc_ns=np.array([report.t_utc_ns + shift_ns for report in reports], np.int64),
        latitude_deg=np.array(latitude_deg),
        longitude_deg=np.array(longitude_deg),
        height_m=datum.heights_m(latitude_deg, longitude_deg, altitude_m, references),
        velocity_enu_m_s=np.array([report.velocity_enu_m_s for report in reports]),
        sigma_m=np.array([report.sigma_m for report in reports]),
    )
    track = trajectories.add_flight(drone.id, samples, signature_of(scene, drone), flight.starts)
    return track.later(-begin_ns)


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
    usual = usual_signature(scene)
    told = {name: getattr(drone, name) for name in ("rcs_m2", "sound_power_db", "size_m")}
    if usual.echoes is not None:
        told["echoes"] = echoes_of(scene.target, drone.target_class, drone.swerling)
    return replace(
        usual,
        emitters=tuple(Emitter(**e.model_dump()) for e in drone.emitters),
        target_class=drone.target_class,
        model=drone.model,
        **{name: value for name, value in told.items() if value is not None},
    )


FENCE_LOOKS = 33  # At so many places of each stretch it is asked whether they are within a geofence
NS_IN_US = 1000
STILL_M_S = 0.1  # Slower, a drone heads nowhere
# What a drone does that has left its geofence.
WITHIN: dict[str, Contingency] = {
    "return": LostLink(kind="lost-link", hold_s=0.0),
    "land": LowBattery(kind="low-battery"),
    "hold": Hold(kind="hold"),
}


def trajectories_of(scene: Scene) -> Trajectories:
    """Trajectories as the scene wants its telemetry to be taken, of no drone yet."""
    settings = scene.telemetry
    return Trajectories(
        stale_after_s=settings.stale_after_s,
        max_speed_m_s=settings.max_speed_m_s,
        tells_echoes=tells_echoes(scene),
    )


def launch(scene: Scene, trajectories: Trajectories, start_utc_ns: int) -> SceneDrones:
    """Put the scene's own drones on their way, and all else that moves.

    Raises `PlotfeedError` for a flight without use.
    """
    drones = SceneDrones(scene, trajectories, start_utc_ns)
    if scene.birds or scene.road or scene.turbine:
        from plotfeed.feeds.engine.other_movers import launch_others

        # After them: what is drawn for drones goes by their rows.
        launch_others(scene, trajectories, start_utc_ns)
    return drones


class SceneDrones:
    """The drones of a scene in their flights, and what happens to them."""

    def __init__(self, scene: Scene, trajectories: Trajectories, start_utc_ns: int) -> None:
        """Put all on their way, and let happen what the scene wants; raises `PlotfeedError`."""
        self._scene, self._trajectories = scene, trajectories
        self._space = SceneSpace(scene.scene.site)
        self._flying = {
            drone.id: _FlyingDrone(scene, drone, self._space, trajectories, start_utc_ns)
            for drone in scene.fleet.drones
        }
        self._gone: set[str] = set()  # Who joined and is not there any more

    @property
    def names(self) -> list[str]:
        """Ids of all."""
        return list(self._flying)

    def put_off(self, by_ns: int) -> None:
        """Have everything so much later."""
        self._trajectories.put_off(by_ns)
        for flying in self._flying.values():
            flying.start_ns += by_ns

    def join(self, drones: Iterable[Drone], at_utc_ns: int) -> None:
        """Put others on their way then; raises `PlotfeedError` where a name is somebody else's."""
        drones = list(drones)
        for drone in drones:
            if drone.id in self._trajectories.names and drone.id not in self._gone:
                raise PlotfeedError(f"drone {drone.id!r}: there is one of that name")
        for drone in drones:
            flying = _FlyingDrone(self._scene, drone, self._space, self._trajectories, at_utc_ns)
            self._flying[drone.id] = flying
            self._gone.discard(drone.id)

    def part_with(self, drones: Iterable[str], at_utc_ns: int) -> None:
        """Have those that joined be gone from then on."""
        for drone in drones:
            nowhere = KnownTrack.straight([at_utc_ns - 2, at_utc_ns - 1], np.zeros((2, 3)))
            self._trajectories.divert(drone, at_utc_ns, nowhere)
            del self._flying[drone]
            self._gone.add(drone)

    def happen(self, drone: str, contingency: Contingency, at_utc_ns: int) -> None:
        """Let something happen to a drone then; raises `PlotfeedError` where it cannot."""
        flying = self._flying[drone]
        flying.happen(contingency, at_utc_ns - flying.start_ns)

    def doing(self, drone: str, t_utc_ns: int) -> str:
        """What had last happened to a drone by then, until it is on its way again, or empty."""
        flying = self._flying[drone]
        return flying.doing(t_utc_ns - flying.start_ns)


@dataclass(frozen=True, slots=True)
class _Conduct:
    """How a drone flies from a time on."""

    from_ns: int
    base_ns: int  # When 0 of its route is or would have been
    fence: GeofenceKeys | None  # The geofence that it obeys
    doing: str = ""  # What has happened to it
    left_ns: int = 0  # Of its route, when it left it
    back_ns: int = -FOREVER_NS  # When it is on its route again


class _FlyingDrone:
    """One drone: the way that it was to fly, and what it does instead, by the time since a start.

    The start is UTC, and may be put off; trajectories are told of all by UTC.
    """

    def __init__(
        self,
        scene: Scene,
        drone: Drone,
        space: SceneSpace,
        trajectories: Trajectories,
        start_ns: int,
    ) -> None:
        self.start_ns = start_ns
        self._drone, self._space, self._trajectories = drone, space, trajectories
        begin_ns = round(drone.start_s * NS)
        self._conduct = [_Conduct(begin_ns, begin_ns, drone.geofence)]
        if drone.flight is not None:
            first_ns = start_ns + begin_ns
            track = fly_recorded(trajectories, scene, drone, drone.flight, first_ns)
            self._route = DroneRoute(track)
        else:
            self._route = planned(space, drone)
            if start_ns + begin_ns + self._route.track.t_utc_ns[-1] > LATEST_UTC_NS:
                raise PlotfeedError(f"drone {drone.id!r}: path: it ends after the year 2262")
            track = self._route.track.later(start_ns + begin_ns)
            trajectories.add_track(drone.id, track, signature_of(scene, drone))
        self._script = [(round((c.at_s or 0.0) * NS), c) for c in drone.contingency]
        self._mind_fence(begin_ns)
        for n, (at_ns, happening) in enumerate(self._script):
            try:
                self._leave(happening, at_ns)
            except PlotfeedError as error:
                raise PlotfeedError(f"{error} (contingency[{n}])") from None

    def doing(self, t_ns: int) -> str:
        """What had last happened to it by then, until it is on its way again."""
        conduct = self._conduct_at(t_ns)
        return conduct.doing if t_ns < conduct.back_ns else ""

    def happen(self, happening: Contingency, at_ns: int) -> None:
        """Let something happen that its scene did not foresee, and then what it did."""
        self._leave(happening, at_ns)
        for later_ns, foreseen in self._script:
            if later_ns > at_ns:
                with suppress(PlotfeedError):  # it may be gone by then, or on its way
                    self._leave(foreseen, later_ns)

    def _conduct_at(self, t_ns: int) -> _Conduct:
        return self._conduct[
            max(bisect_right(self._conduct, t_ns, key=attrgetter("from_ns")) - 1, 0)
        ]

    def _leave(self, happening: Contingency, at_ns: int, doing: str = "") -> None:
        """Leave its way then, or whatever it does instead."""
        name, before = self._drone.id, self._conduct_at(at_ns)
        at_utc_ns = self.start_ns + at_ns
        stretch = self._trajectories.stretch_at(name, at_utc_ns)
        if not stretch.alive:
            raise PlotfeedError(f"drone {name!r}: {happening.kind}: it is not there then")
        is_on_route = at_ns >= before.back_ns
        if is_on_route and isinstance(happening, Resume):
            raise PlotfeedError(f"drone {name!r}: resume: it is on its way")
        now = replace(
            before,
            from_ns=at_ns,
            doing=doing or happening.kind,
            left_ns=at_ns - before.base_ns if is_on_route else before.left_ns,
            back_ns=FOREVER_NS,
        )
        if doing or isinstance(happening, FlyAway):
            now = replace(now, fence=None)
        position_m, velocity_m_s, *_ = stretch.between(at_utc_ns, FOREVER_NS).coefficients[:, :, 0]
        frame = self._space.frame
        plan = FlightPlan(
            self._drone.limits.model(),
            level_from_ecef(frame, position_m),
            level_velocity(frame, position_m, velocity_m_s),
        )
        self._plan(plan, happening)
        if isinstance(happening, Stray | Resume):
            back_ns = self._route.rejoined(now.left_ns)
            plan.fly_to(self._on_route_m(back_ns), getattr(happening, "speed_m_s", None))
            end_ns = at_ns + round(plan.end_s * NS)
            now = replace(now, back_ns=end_ns, base_ns=end_ns - back_ns)
        self._trajectories.divert(name, at_utc_ns, self._space.track(plan, at_utc_ns))
        if now.back_ns < FOREVER_NS:
            route = self._route.track.later(self.start_ns + now.base_ns)
            self._trajectories.divert(name, self.start_ns + now.back_ns, route)
        while self._conduct and self._conduct[-1].from_ns >= at_ns:
            del self._conduct[-1]
        self._conduct = [*self._conduct[1 - MAX_TRACKS :], now]
        self._mind_fence(at_ns)

    def _plan(self, plan: FlightPlan, happening: Contingency) -> None:
        """What the drone does of itself."""
        match happening:
            case LostLink():
                plan.hover(happening.hold_s)
                home_m = self._home_m()
                height_m = plan.place_m[2]
                if happening.return_height_m is not None:
                    height_m = max(height_m, home_m[2] + happening.return_height_m)
                plan.fly_to([*plan.place_m[:2], height_m])
                plan.fly_to([*home_m[:2], height_m], happening.speed_m_s)
                plan.fly_to([*home_m[:2], min(home_m[2], height_m)])
            case FlyAway():
                course = self._course_rad(plan, happening)
                speed_m_s = happening.speed_m_s or self._drone.limits.speed_m_s
                level = speed_m_s * np.array([np.sin(course), np.cos(course)])
                plan.drift([*level, happening.climb_m_s], happening.for_s)
            case Stray():
                place_m = self._space.level_m(happening, self._drone.offset_enu_m)
                plan.fly_to(place_m, happening.speed_m_s)
                plan.hover(happening.hold_s)
            case LowBattery():
                self._land(plan)
            case Hold():
                plan.hover(happening.for_s)
                self._land(plan)

    def _land(self, plan: FlightPlan) -> None:
        plan.stop()
        plan.fly_to([*plan.place_m[:2], min(plan.place_m[2], self._home_m()[2])])

    @staticmethod
    def _course_rad(plan: FlightPlan, happening: FlyAway) -> float:
        if happening.course_deg is not None:
            return float(np.radians(happening.course_deg))
        east, north, _ = plan.knots().velocity_m_s[-1]
        return float(np.arctan2(east, north)) if np.hypot(east, north) > STILL_M_S else 0.0

    def _home_m(self) -> Floats:
        """The place where a drone lands when it comes home, as one of its scene."""
        if self._drone.home is not None:
            return self._space.level_m(self._drone.home, self._drone.offset_enu_m)
        first_m = level_from_ecef(self._space.frame, self._route.track.position_ecef_m[0])
        return np.array([*first_m[:2], min(first_m[2], 0.0)])

    def _on_route_m(self, t_ns: int) -> Floats:
        """Where its route is after so long; at its end, the last place."""
        stretch = self._route.track.stretch_at(t_ns)
        if not stretch.alive:
            stretch = self._route.track.stretch_at(t_ns - 1)
        return level_from_ecef(self._space.frame, stretch.places_m(np.array(t_ns))[0])

    def _mind_fence(self, from_ns: int) -> None:
        """Let it do from then on what it does when it has left its geofence, if it does."""
        conduct = self._conduct_at(from_ns)
        if conduct.fence is None:
            return
        t_ns, until_ns = self.start_ns + from_ns, FOREVER_NS
        if period_ns := self._route.track.period_ns:
            last_ns = max(from_ns, conduct.base_ns, conduct.back_ns)
            until_ns = self.start_ns + last_ns + period_ns
        while t_ns < until_ns:
            stretch = self._trajectories.stretch_at(self._drone.id, t_ns)
            end_ns = int(stretch.end_ns[0])
            if end_ns == FOREVER_NS and not stretch.alive:
                return
            if stretch.alive:
                crossed_ns = self._crossing_ns(stretch.between(t_ns, until_ns), conduct.fence)
                if crossed_ns is not None:
                    crossed_ns -= self.start_ns
                    self._leave(WITHIN[conduct.fence.does], crossed_ns, "geofence")
                    return
            t_ns = end_ns

    def _crossing_ns(self, stretch: Stretches, fence: GeofenceKeys) -> int | None:
        """The time of leaving the fence in that stretch, to the microsecond; None if there is none.

        Looked for at places along it: a straight way does not leave a cylinder twice.
        """
        # Counted from its start, so that it is the same whenever the session begins.
        after_ns = np.linspace(0, int(stretch.end_ns[0] - stretch.start_ns[0]), FENCE_LOOKS)
        times_ns = stretch.start_ns + after_ns.astype(np.int64)
        within = self._is_within(stretch, times_ns, fence)
        leaves = np.flatnonzero(within[:-1] & ~within[1:])
        if not len(leaves):
            return None
        inside_ns, outside_ns = (int(times_ns[leaves[0] + i]) for i in (0, 1))
        while outside_ns - inside_ns > NS_IN_US:
            middle_ns = (inside_ns + outside_ns) // 2
            if self._is_within(stretch, np.array([middle_ns]), fence)[0]:
                inside_ns = middle_ns
            else:
                outside_ns = middle_ns
        return outside_ns

    def _is_within(self, stretch: Stretches, times_ns: Ints, fence: GeofenceKeys) -> Bools:
        away_m = level_from_ecef(self._space.frame, stretch.places_m(times_ns)) - self._home_m()
        within: Bools = np.hypot(away_m[:, 0], away_m[:, 1]) <= fence.radius_m
        if fence.above_home_m is not None:
            within &= away_m[:, 2] <= fence.above_home_m
        return within
