"""Reports of drones from network Remote ID: what a service provider answers (ASTM F3411-22a)."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

from plotfeed.feeds.telemetry.live.heard import HeardReport, named
from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.open_drone_id import (
    EDGE_95,
    HORIZONTAL_CLASSES_M,
    RADIUS_95,
    SPEED_CLASSES_M_S,
    UNKNOWN_ALTITUDE_M,
    UNKNOWN_CLIMB_M_S,
    UNKNOWN_DIRECTION_DEG,
    UNKNOWN_SPEED_M_S,
    VERTICAL_CLASSES_M,
)
from plotfeed.proto.utc import utc_ns

MAX_FLIGHTS = 10_000
# Of 95 % of errors, metres and m/s, by name.
BOUNDS = HORIZONTAL_CLASSES_M | VERTICAL_CLASSES_M | SPEED_CLASSES_M_S


class NetworkRemoteIdReports:
    """Hears answers to GET /uss/flights, each whole; of a flight what is new."""

    def __init__(self, template: str) -> None:
        """`template` is that of names, in which {id} is that of the flight."""
        self._template = template
        self._latest: dict[str, int] = {}

    def hear(self, peer: str, data: bytes, now_utc_ns: int) -> Iterator[HeardReport]:
        """The reports of flights that have moved since the last answer."""
        del peer, now_utc_ns
        try:
            flights = json.loads(data)["flights"]
            if not isinstance(flights, list):
                raise TypeError("no list of flights")
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            detail = f"an answer that is no list of flights: {error}"
            yield HeardReport("", Refused(Reason.UNDECODABLE, detail))
            return
        before, self._latest = self._latest, {}
        for flight in flights[:MAX_FLIGHTS]:
            name = ""
            try:
                name = named(self._template, {"id": str(_at(flight, "id"))})
                report = report_of_flight(flight)
            except Refused as refused:
                yield HeardReport(name, refused)
                continue
            self._latest[name] = report.t_utc_ns
            if before.get(name) != report.t_utc_ns:  # it says the same until something new comes
                yield HeardReport.checked(name, report)

    def forget(self, peer: str) -> None:
        """Nothing waits."""

    def notes(self) -> list[str]:
        """Nothing."""
        return []


def report_of_flight(flight: Any) -> PositionReport:
    """The report that a flight's current_state is; raises `Refused` that names the key."""
    state = _at(flight, "current_state")
    position = _at(state, "position")
    stamp = _at(state, "timestamp", "value")
    t_utc_ns = utc_ns(stamp) if isinstance(stamp, str) else None
    if t_utc_ns is None:
        detail = f"timestamp.value is {ascii(stamp)[:40]}; expected RFC 3339"
        raise Refused(Reason.UNDECODABLE, detail)
    latitude_deg, longitude_deg = _number(position, "lat"), _number(position, "lng")
    altitude_m = _number(position, "alt")
    if math.isnan(latitude_deg) or math.isnan(longitude_deg):
        raise Refused(Reason.MISSING, "position.lat or position.lng is missing")
    if math.isnan(altitude_m) or altitude_m == UNKNOWN_ALTITUDE_M:
        raise Refused(Reason.ALTITUDE, "position.alt is missing or unknown")
    speed, track = _number(state, "speed"), _number(state, "track")
    climb = _number(state, "vertical_speed")
    is_known = speed != UNKNOWN_SPEED_M_S and track != UNKNOWN_DIRECTION_DEG
    course = math.radians(track)
    velocity = (
        speed * math.sin(course) if is_known else math.nan,
        speed * math.cos(course) if is_known else math.nan,
        climb if climb != UNKNOWN_CLIMB_M_S else math.nan,
    )
    return PositionReport(
        t_utc_ns=t_utc_ns,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        altitude_m=altitude_m,
        altitude_reference=AltitudeReference.ELLIPSOID,
        velocity_enu_m_s=None if all(map(math.isnan, velocity)) else velocity,
        horizontal_accuracy_m=_accuracy(position, "accuracy_h", RADIUS_95),
        vertical_accuracy_m=_accuracy(position, "accuracy_v", EDGE_95),
        velocity_accuracy_m_s=_accuracy(state, "speed_accuracy", EDGE_95),
    )


def _at(tree: Any, *keys: str) -> Any:
    for key in keys:
        if not isinstance(tree, dict) or tree.get(key) is None:
            raise Refused(Reason.MISSING, f"{'.'.join(keys)} is missing")
        tree = tree[key]
    return tree


def _number(tree: Any, key: str) -> float:
    """NaN where there is none."""
    value = tree.get(key) if isinstance(tree, dict) else None
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise Refused(Reason.UNDECODABLE, f"{key} is {ascii(value)[:40]}; expected a number")
    return float(value)


def _accuracy(tree: Any, key: str, scale: float) -> float | None:
    """One standard deviation of a class such as HA3m, HA05NM, VA10m, SA03mps; None if unknown."""
    value = tree.get(key) if isinstance(tree, dict) else None
    bound = BOUNDS.get(value, math.nan) if isinstance(value, str) else math.nan
    return None if math.isnan(bound) else bound / scale
