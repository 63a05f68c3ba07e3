"""Reports of drones from Remote ID messages: Open Drone ID, by radio or in MAVLink."""

from __future__ import annotations

import math
from collections.abc import Iterator

from plotfeed.feeds.telemetry.live.heard import HeardReport, named
from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.open_drone_id import (
    MESSAGE_OCTETS,
    PACK,
    OdidIdentity,
    OdidLocation,
    messages_in,
)
from plotfeed.proto.utc import NS

HOUR_NS = 3600 * NS
OFF_NS = 60 * NS
"""A position that would be older, or as far ahead, is of a clock that is off: it is of now."""
MAX_TRANSMITTERS = 1000
"""Whose identities are remembered; the one that was heard first gives way."""
MAX_LINE = 4096
PACK_SIZE = bytes([MESSAGE_OCTETS])


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
    """Hears Open Drone ID messages and packs, each peer a receiver.

    What comes is a message, a pack, or lines of either in hexadecimal, each with the address of its
    transmitter before it if it has several: `60:60:1f:00:00:01 1222…`.
    """

    def __init__(self, template: str) -> None:
        """`template` is that of names, in which {id} is the identity, else the transmitter."""
        self._template = template
        self._identities: dict[str, str] = {}
        self._lines: dict[str, bytes] = {}

    def hear(self, peer: str, data: bytes, now_utc_ns: int) -> Iterator[HeardReport]:
        """The reports in a datagram or in lines."""
        if not self._lines.get(peer) and is_message(data):
            yield from self.said(peer, data, now_utc_ns)
            return
        *lines, rest = (self._lines.pop(peer, b"") + data).split(b"\n")
        if len(rest) <= MAX_LINE:
            self._lines[peer] = rest
        else:
            yield HeardReport(
                "", Refused(Reason.OVERSIZED, f"a line of more than {MAX_LINE} octets")
            )
        for line in lines:
            *whose, octets = line.split() or [b""]
            try:
                message = bytes.fromhex(octets.decode())
            except ValueError:
                text = ascii(line[:80].decode("latin-1"))
                detail = f"a line {text}; expected octets in hexadecimal"
                yield HeardReport("", Refused(Reason.UNDECODABLE, detail))
                continue
            if message:
                of = whose[-1].decode("latin-1") if whose else peer
                yield from self.said(of, message, now_utc_ns)

    def forget(self, peer: str) -> None:
        """Drop the beginning of a line."""
        self._lines.pop(peer, None)

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


def is_message(data: bytes) -> bool:
    """Whether octets look like a message or a pack, and not like digits that write one."""
    if not data.strip(b"0123456789abcdefABCDEF:-_ \r\n"):
        return False
    return len(data) == MESSAGE_OCTETS or (data[0] >> 4 == PACK and data[1:2] == PACK_SIZE)
