"""Drones from Remote ID: Open Drone ID by radio or in MAVLink, and by network (ASTM F3411-22a)."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

from plotfeed.feeds.telemetry.live.heard import HeardReport, Listener, named, remember
from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused, over_ground
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import DecodeError
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
    OdidIdentity,
    OdidLocation,
    messages_in,
)
from plotfeed.proto.utc import NS, utc_ns

HOUR_NS = 3600 * NS
# A position that would be older, or as far ahead, is of a clock that is off: it is of now.
OFF_NS = 60 * NS
# Whose identities are remembered; the one that has been silent longest gives way.
MAX_TRANSMITTERS = 1000


def report_of(location: OdidLocation, now_utc_ns: int) -> PositionReport:
    """The report that a location is; raises `Refused` without a position or a height."""
    if math.isnan(location.latitude_deg):
        raise Refused(Reason.NO_POSITION, "latitude and longitude are 0: it has no position yet")
    altitude_m, reference = location.ellipsoid_height_m, AltitudeReference.ELLIPSOID
    if math.isnan(altitude_m):
        altitude_m, reference = location.height_m, AltitudeReference.ABOVE_TAKEOFF
        if math.isnan(altitude_m) or location.is_over_ground:
            detail = "no height above the ellipsoid, and none above take-off"
            raise Refused(Reason.ALTITUDE, detail)
    t_utc_ns, half = now_utc_ns, HOUR_NS // 2
    if not math.isnan(location.past_hour_s):  # the nearest, unless that is far off
        past_hour_ns = round(location.past_hour_s * NS)
        since_ns = (past_hour_ns - now_utc_ns + half) % HOUR_NS - half
        t_utc_ns += since_ns if abs(since_ns) <= OFF_NS else 0
    return PositionReport(
        t_utc_ns=t_utc_ns,
        latitude_deg=location.latitude_deg,
        longitude_deg=location.longitude_deg,
        altitude_m=altitude_m,
        altitude_reference=reference,
        velocity_enu_m_s=over_ground(location.speed_m_s, location.course_deg, location.climb_m_s),
        horizontal_accuracy_m=location.horizontal_accuracy_m,
        vertical_accuracy_m=location.vertical_accuracy_m,
        velocity_accuracy_m_s=location.speed_accuracy_m_s,
    )


class RemoteIdReports(Listener):
    """Hears Open Drone ID messages and packs; each peer is a transmitter."""

    def __init__(self, template: str) -> None:
        """`template` is that of names, in which {id} is the identity, else the transmitter."""
        self._template = template
        self._identities: dict[str, str] = {}

    def hear(self, peer: str, data: bytes, now_utc_ns: int) -> Iterator[HeardReport]:
        """The reports in a datagram."""
        yield from self.said(peer, data, now_utc_ns)

    def said(self, transmitter: str, octets: bytes, now_utc_ns: int) -> Iterator[HeardReport]:
        """The reports in a message or pack of a transmitter; an identity in it counts first."""
        try:
            messages = list(messages_in(octets))
        except DecodeError as error:
            detail = f"no message of Open Drone ID: {error}"
            yield HeardReport("", Refused(Reason.UNDECODABLE, detail))
            return
        for message in messages:
            if isinstance(message, OdidIdentity):
                self.identify(transmitter, message)
        for message in messages:
            if isinstance(message, OdidLocation):
                yield self.located(transmitter, message, now_utc_ns)

    def identify(self, transmitter: str, said: OdidIdentity) -> None:
        """Know whose the transmitter is from now on."""
        if said.identity:
            remember(self._identities, transmitter, said.identity, MAX_TRANSMITTERS)

    def located(self, transmitter: str, location: OdidLocation, now_utc_ns: int) -> HeardReport:
        """The report of a location."""
        identity = self._identities.get(transmitter, transmitter)
        name = named(self._template, {"id": identity})
        try:
            return HeardReport.checked(name, report_of(location, now_utc_ns))
        except Refused as refused:
            return HeardReport(name, refused)


MAX_FLIGHTS = 10_000
# Of 95 % of errors, metres and m/s, by name.
BOUNDS = HORIZONTAL_CLASSES_M | VERTICAL_CLASSES_M | SPEED_CLASSES_M_S


class NetworkRemoteIdReports(Listener):
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
    if speed == UNKNOWN_SPEED_M_S or track == UNKNOWN_DIRECTION_DEG:
        speed = math.nan
    climb = math.nan if climb == UNKNOWN_CLIMB_M_S else climb
    return PositionReport(
        t_utc_ns=t_utc_ns,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        altitude_m=altitude_m,
        altitude_reference=AltitudeReference.ELLIPSOID,
        velocity_enu_m_s=over_ground(speed, track, climb),
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
    try:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise TypeError
        number = float(value)  # of a whole number with hundreds of digits, none
    except (TypeError, OverflowError):
        number = math.inf
    if not math.isfinite(number):
        raise Refused(Reason.UNDECODABLE, f"{key} is {ascii(value)[:40]}; expected a number")
    return number


def _accuracy(tree: Any, key: str, scale: float) -> float:
    """One standard deviation of a class such as HA3m, HA05NM, VA10m, SA03mps; NaN if unknown."""
    value = tree.get(key) if isinstance(tree, dict) else None
    return BOUNDS.get(value, math.nan) / scale if isinstance(value, str) else math.nan
