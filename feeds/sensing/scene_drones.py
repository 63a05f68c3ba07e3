"""The drones that a scene flies by itself, by waypoints or a recording, and what they report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.scene.drones import COOPERATIVE, CooperativeKeys, Drone, FlightFile
from plotfeed.feeds.scene.fields import Site, geodetic
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.feeds.telemetry.position_report import LATEST_UTC_NS, AltitudeDatum, PositionReport
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import LocalFrame, ecef_to_geodetic, geodetic_to_ecef
from plotfeed.models.state import Emitter, Floats, Signature
from plotfeed.models.truth import Trajectories
from plotfeed.proto.asterix.cat129 import TargetEncoder129
from plotfeed.proto.content_types import asterix_content_type
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

MAX_LEG_M = 500.0
"""A straight line this long leaves the curve of constant height by 5 mm."""


HALF_OF_POSITIONS = (2 * np.log(2)) ** 0.5
"""Radius that holds half of a circular normal distribution, in standard deviations."""


def trajectories_of(scene: Scene) -> Trajectories:
    """Trajectories as the scene wants its telemetry to be taken, of no drone yet."""
    settings = scene.telemetry
    return Trajectories(stale_after_s=settings.stale_after_s, max_speed_m_s=settings.max_speed_m_s)


def launch(scene: Scene, trajectories: Trajectories, start_utc_ns: int) -> None:
    """Put the scene's own drones on their way; raises `PlotfeedError` for a flight without use."""
    for drone in scene.drone:
        begin_ns = start_utc_ns + round(drone.start_s * NS)
        if drone.flight is not None:
            _fly(trajectories, scene, drone, drone.flight, begin_ns)
            continue
        times_s, positions = knots(scene.scene.site, drone)
        if begin_ns + times_s[-1] * NS > LATEST_UTC_NS:
            raise PlotfeedError(f"drone {drone.id!r}: path: it ends after the year 2262")
        trajectories.add_path(
            drone.id,
            [begin_ns + round(t * NS) for t in times_s],
            positions,
            signature=signature_of(scene, drone),
            repeat=drone.repeat,
        )


def _fly(
    trajectories: Trajectories, scene: Scene, drone: Drone, flight: FlightFile, begin_ns: int
) -> None:
    """Put a recorded flight on its way."""
    reports, heights_m, starts = _recorded(scene, flight, begin_ns)
    accuracies = [(r.horizontal_accuracy_m, r.vertical_accuracy_m) for r in reports]
    trajectories.add_flight(
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


def knots(site: Site, drone: Drone) -> tuple[list[float], Floats]:
    """Times from the start of a path, and ECEF positions (k, 3), on the curved Earth."""
    places = [geodetic(site, waypoint) for waypoint in drone.path]
    speeds = [w.speed_m_s or drone.speed_m_s or 0.0 for w in drone.path]
    if drone.repeat:
        places.append(places[0])
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


def _recorded(
    scene: Scene, recorded: FlightFile, begin_ns: int
) -> tuple[list[PositionReport], Floats, Sequence[int]]:
    """The reports of a flight that begins then, and their heights above the ellipsoid.

    And to which of them no flight leads from before.
    """
    from plotfeed.feeds.telemetry.flights import read, smoothed
    from plotfeed.feeds.telemetry.flights.flight import FlightOptions

    options = FlightOptions(
        columns=recorded.columns,
        altitude_reference=recorded.altitude_reference,
        gps_order=recorded.gps_order,
        utc_offset_h=recorded.utc_offset_h,
        start_utc_ns=begin_ns,
        max_speed_m_s=scene.telemetry.max_speed_m_s,
    )
    flight = smoothed(read(scene.file(recorded.file), options))
    takeoff_height_m = recorded.takeoff_height_m
    if takeoff_height_m is None:
        takeoff_height_m = scene.telemetry.takeoff_height_m
    sea_level = SeaLevel.of(scene, stated_m=recorded.geoid_undulation_m)
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
    )


class CooperativeDrones:
    """What the cooperative drones say at the k-th period since 1970."""

    def __init__(self, scene: Scene, settings: CooperativeKeys, trajectories: Trajectories) -> None:
        self.period_ns = round(settings.period_s * NS)
        self._accuracy_m = settings.accuracy_m
        self._sea_level = SeaLevel.of(scene)
        self._trajectories = trajectories
        names = settings.those_of([drone.id for drone in scene.drone])
        self._chances = {
            trajectories.names.index(name): Chance(scene.scene.seed, f"{COOPERATIVE}/{name}")
            for name in dict.fromkeys(names)
        }
        self._drones = np.array(sorted(self._chances), np.int64)
        self._encoder = TargetEncoder129(settings.sac, settings.sic, country=settings.country)
        self._root = f"{scene.mqtt.prefix}/{COOPERATIVE}"
        self._qos = scene.mqtt.qos

    def messages(self, number: int) -> list[Message]:
        """One a drone that is there, due when it says it is."""
        t_utc_ns = number * self.period_ns
        state = self._trajectories.state_at(t_utc_ns, self._drones)
        if not len(state):
            return []
        names = [self._trajectories.names[drone] for drone in state.drone]
        latitude_deg, longitude_deg, height_m = ecef_to_geodetic(state.position_ecef_m)
        velocity_m_s = np.zeros((len(state), 3))
        for i, drone in enumerate(state.drone):
            frame = LocalFrame(latitude_deg[i], longitude_deg[i], height_m[i])
            error_m = self._error_m(int(drone), number)
            said = frame.to_geodetic(error_m)
            latitude_deg[i], longitude_deg[i], height_m[i] = (float(x) for x in said)
            velocity_m_s[i] = frame.rotate_from_ecef(state.velocity_ecef_m_s[i])
        blocks = self._encoder.blocks(
            names,
            state.t_utc_ns,
            latitude_deg,
            longitude_deg,
            altitude_m=height_m - self._sea_level.undulation_m(latitude_deg, longitude_deg),
            accuracy_m=self._radius_m(len(state)),
            velocity_m_s=velocity_m_s,
        )
        return [
            self._message(number, name, block) for name, block in zip(names, blocks, strict=True)
        ]

    def _error_m(self, drone: int, number: int) -> Floats:
        if not self._accuracy_m:
            return np.zeros(3)
        rng = self._chances[drone].rng(Purpose.COOPERATION, number)
        return self._accuracy_m * rng.standard_normal(3)

    def _radius_m(self, n: int) -> Floats | None:
        """Accuracy as the drones state it: the radius that holds half of their positions."""
        if not self._accuracy_m:
            return None
        return np.full(n, self._accuracy_m * HALF_OF_POSITIONS)

    def _message(self, number: int, drone: str, block: bytes) -> Message:
        t_utc_ns = number * self.period_ns
        return Message(
            topic=f"{self._root}/asterix/129",
            payload=block,
            content_type=asterix_content_type(129),
            due_utc_ns=t_utc_ns,
            qos=self._qos,
            properties=attributes(
                self._root, "asterix/129", f"{number}-{drone}", t_utc_ns, drone=drone
            ),
        )
