"""The drones that a scene flies by itself: along waypoints, or as a file recorded them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from plotfeed.feeds.scene.drones import Drone, FlightFile
from plotfeed.feeds.scene.fields import Site
from plotfeed.feeds.scene.geometry import geodetic
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.telemetry.position_report import LATEST_UTC_NS, AltitudeDatum, PositionReport
from plotfeed.feeds.telemetry.receiver import add_report
from plotfeed.models.frames import geodetic_to_ecef
from plotfeed.models.state import Emitter, Floats, Signature
from plotfeed.models.truth import Trajectories
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

MAX_LEG_M = 500.0
"""A straight line this long leaves the curve of constant height by 5 mm."""


def launch(scene: Scene, trajectories: Trajectories, start_utc_ns: int) -> None:
    """Put the scene's own drones on their way; raises `PlotfeedError` for a flight without use."""
    for drone in scene.drone:
        begin_ns = start_utc_ns + round(drone.start_s * NS)
        if drone.flight is not None:
            for report, height_m in _recorded(scene, drone.flight, begin_ns):
                add_report(
                    trajectories,
                    drone.id,
                    report,
                    height_m,
                    signature_of(scene, drone),
                    keep_history=True,
                )
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


def knots(site: Site, drone: Drone) -> tuple[list[float], Floats]:
    """Times from the start of a path, and ECEF positions (k, 3), on the curved Earth."""
    places = [geodetic(site, waypoint) for waypoint in drone.path]
    speeds = [w.speed_m_s or drone.speed_m_s or 0.0 for w in drone.path]
    if drone.repeat:
        places.append(places[0])
        speeds.append(drone.speed_m_s or speeds[-1])
    times_s, positions = [0.0], [geodetic_to_ecef(*places[0])]
    for (a, b), speed_m_s in zip(pairwise(places), speeds[1:], strict=True):
        for place in _along(a, b):
            positions.append(geodetic_to_ecef(*place))
            leg_m = float(np.linalg.norm(positions[-1] - positions[-2]))
            times_s.append(times_s[-1] + max(leg_m / speed_m_s, 1e-6))
    return times_s, np.array(positions)


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
) -> Iterator[tuple[PositionReport, float]]:
    """The reports of a flight that begins then, with their heights above the ellipsoid."""
    from plotfeed.feeds.telemetry.flights import read, smoothed
    from plotfeed.feeds.telemetry.flights.flight import FlightOptions

    options = FlightOptions(
        columns=recorded.columns,
        altitude_reference=recorded.altitude_reference,
        gps_order=recorded.gps_order,
        utc_offset_h=recorded.utc_offset_h,
        start_utc_ns=begin_ns,
    )
    flight = smoothed(read(scene.folder / recorded.file, options))
    datum = AltitudeDatum(
        _first_known(recorded.takeoff_height_m, scene.telemetry.takeoff_height_m),
        _first_known(recorded.geoid_undulation_m, scene.telemetry.geoid_undulation_m),
    )
    shift_ns = begin_ns - flight.reports[0].t_utc_ns
    for report in flight.reports:
        yield replace(report, t_utc_ns=report.t_utc_ns + shift_ns), datum.height_m(report)


def signature_of(scene: Scene, drone: Drone) -> Signature:
    """What there is of a drone to sense, by the scene where the drone states nothing."""
    settings = scene.telemetry
    return Signature(
        rcs_m2=settings.rcs_m2 if drone.rcs_m2 is None else drone.rcs_m2,
        sound_power_db=(
            settings.sound_power_db if drone.sound_power_db is None else drone.sound_power_db
        ),
        emitters=tuple(Emitter(**e.model_dump()) for e in drone.emitters),
    )


def _first_known(*values: float | None) -> float | None:
    return next((v for v in values if v is not None), None)
