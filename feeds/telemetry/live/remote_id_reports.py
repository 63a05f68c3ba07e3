"""Reports of drones from Remote ID messages: Open Drone ID, by radio or in MAVLink."""

from __future__ import annotations

import math
from collections.abc import Iterator

from plotfeed.feeds.telemetry.live.heard import HeardReport, named
from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.open_drone_id import OdidIdentity, OdidLocation, messages_in
from plotfeed.proto.utc import NS

HOUR_NS = 3600 * NS
# A position that would be older, or as far ahead, is of a clock that is off: it is of now.
OFF_NS = 60 * NS
MAX_TRANSMITTERS = 1000  # Whose identities are remembered; the one that was heard first gives way


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
    course = math.radians(location.course_deg)
    east, north = location.speed_m_s * math.sin(course), location.speed_m_s * math.cos(course)
    if location.speed_m_s == 0:
        east = north = 0.0
    velocity = (east, north, location.climb_m_s)
    return PositionReport(
        t_utc_ns=past_hour_ns(location.past_hour_s, now_utc_ns),
        latitude_deg=location.latitude_deg,
        longitude_deg=location.longitude_deg,
        altitude_m=altitude_m,
        altitude_reference=reference,
        velocity_enu_m_s=None if all(map(math.isnan, velocity)) else velocity,
        horizontal_accuracy_m=_or_none(location.horizontal_accuracy_m),
        vertical_accuracy_m=_or_none(location.vertical_accuracy_m),
        velocity_accuracy_m_s=_or_none(location.speed_accuracy_m_s),
    )


def past_hour_ns(past_hour_s: float, now_utc_ns: int) -> int:
    """UTC of so many seconds past an hour: the nearest; now where it is unknown or far off."""
    if math.isnan(past_hour_s):
        return now_utc_ns
    half = HOUR_NS // 2
    since_ns = (round(past_hour_s * NS) - now_utc_ns + half) % HOUR_NS - half
    return now_utc_ns + since_ns if abs(since_ns) <= OFF_NS else now_utc_ns


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


class RemoteIdReports:
    """Hears Open Drone ID messages and packs; each peer is a transmitter."""

    def __init__(self, template: str) -> None:
        """`template` is that of names, in which {id} is the identity, else the transmitter."""
        self._template = template
        self._identities: dict[str, str] = {}

    def hear(self, peer: str, data: bytes, now_utc_ns: int) -> Iterator[HeardReport]:
        """The reports in a datagram."""
        yield from self.said(peer, data, now_utc_ns)

    def forget(self, peer: str) -> None:
        """Nothing: a datagram is whole."""

    def notes(self) -> list[str]:
        """Nothing."""
        return []

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
        if not said.identity:
            return
        if transmitter not in self._identities and len(self._identities) >= MAX_TRANSMITTERS:
            del self._identities[next(iter(self._identities))]
        self._identities[transmitter] = said.identity

    def located(self, transmitter: str, location: OdidLocation, now_utc_ns: int) -> HeardReport:
        """The report of a location."""
        identity = self._identities.get(transmitter, transmitter)
        name = named(self._template, {"id": identity})
        try:
            return HeardReport.checked(name, report_of(location, now_utc_ns))
        except Refused as refused:
            return HeardReport(name, refused)
