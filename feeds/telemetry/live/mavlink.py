"""Drones from MAVLink 1 and 2, as autopilots and simulators send it, and what these are asked.

Aircraft that an autopilot has heard are those of ADSB_VEHICLE: common message 246 and the
enumerations ADSB_FLAGS, ADSB_ALTITUDE_TYPE, ADSB_EMITTER_TYPE.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

from plotfeed.feeds.telemetry.flights.autopilot_logs import mavlink_decoder
from plotfeed.feeds.telemetry.live.aircraft import OF_EMITTER_MAVLINK, SMALL, as_reported
from plotfeed.feeds.telemetry.live.heard import HeardReport, Listener, named, remember
from plotfeed.feeds.telemetry.live.remote_id import RemoteIdReports
from plotfeed.feeds.telemetry.position_report import (
    UNKNOWN_VELOCITY,
    PositionReport,
    Reason,
    Refused,
    over_ground,
)
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.mavlink_frames import FrameSplitter
from plotfeed.proto.open_drone_id import (
    EDGE_95,
    HORIZONTAL_M,
    MESSAGE_OCTETS,
    RADIUS_95,
    SPEED_M_S,
    UNKNOWN_ALTITUDE_M,
    UNKNOWN_CLIMB_M_S,
    UNKNOWN_SPEED_M_S,
    VERTICAL_M,
    OdidIdentity,
    OdidLocation,
    accuracy,
    identity_text,
    known,
)
from plotfeed.proto.utc import NS

TRUSTED_WITHIN_NS = NS  # A sender's UTC that is further from ours than this, is off
LOOK_BACK_NS = 5 * NS
# A clock that goes back by more than this has begun anew; by less, messages passed each other.
RESTART_NS = NS


class SenderClock:
    """The clock of a sender beside ours, by when its messages come.

    No message comes before it is sent: the one that took least of late shows how far the clocks
    are apart, to that least delay. Where the sender says its UTC and is not off, that is taken.
    """

    def __init__(self, declared_ns: int | None = None) -> None:
        """`declared_ns` is the sender's UTC less what its messages count; 0 if they count UTC."""
        self.declared_ns = declared_ns
        self.is_off = False  # Whether the sender says a UTC that is not taken
        self._apart_ns: int | None = None
        self._recent_ns: int | None = None
        self._until_ns = 0
        self._last_ns: int | None = None

    def declare(self, declared_ns: int, count_ns: int) -> None:
        """Take what the sender said its UTC less its count is, at that count."""
        self._begin_anew_before(count_ns)
        self.declared_ns = declared_ns

    @property
    def off_s(self) -> float:
        """How far the sender's UTC is behind ours, seconds; 0 where it says none."""
        if self.declared_ns is None or self._apart_ns is None:
            return 0.0
        return (self._apart_ns - self.declared_ns) / NS

    def utc_ns(self, count_ns: int, now_utc_ns: int) -> int:
        """The UTC of a message that bears this count of the sender's clock and has come now."""
        self._begin_anew_before(count_ns)
        self._last_ns = count_ns
        apart_ns = now_utc_ns - count_ns
        left_ns = self._until_ns - now_utc_ns
        # Nothing was heard for long, or our own clock has jumped: what was known is worth nothing.
        jumped = not -LOOK_BACK_NS <= left_ns <= LOOK_BACK_NS
        if self._apart_ns is None or self._recent_ns is None or jumped:
            self._apart_ns = self._recent_ns = apart_ns
            self._until_ns = now_utc_ns + LOOK_BACK_NS
        elif left_ns < 0:
            # The least of the last stretch and of this one: so clocks may drift.
            self._apart_ns, self._recent_ns = self._recent_ns, apart_ns
            self._until_ns = now_utc_ns + LOOK_BACK_NS
        self._recent_ns = min(self._recent_ns, apart_ns)
        self._apart_ns = min(self._apart_ns, apart_ns)
        if self.declared_ns is None:
            return count_ns + self._apart_ns
        self.is_off = abs(self.declared_ns - self._apart_ns) > TRUSTED_WITHIN_NS
        return count_ns + (self._apart_ns if self.is_off else self.declared_ns)

    def _begin_anew_before(self, count_ns: int) -> None:
        """Forget everything if the clock has begun anew; its UTC, unless it counts that."""
        if self._last_ns is not None and count_ns < self._last_ns - RESTART_NS:
            self._apart_ns = self._recent_ns = self._last_ns = None
            if self.declared_ns != 0:
                self.declared_ns = None


ADSB_VEHICLE = 246
HAS_PLACE, HAS_ALTITUDE, HAS_COURSE, HAS_SPEED, HAS_CLIMB = 1, 2, 4, 8, 128
HAS_ALL_OF_PLACE = HAS_PLACE | HAS_ALTITUDE
HAS_VELOCITY = HAS_COURSE | HAS_SPEED
# By altitude type: of pressure with the QNH of the autopilot, and of GNSS.
REFERENCES = {0: AltitudeReference.MEAN_SEA_LEVEL, 1: AltitudeReference.ELLIPSOID}
OLD_S = 5  # What was heard that long ago says no more where an aircraft is


def aircraft_in(message: Any, now_utc_ns: int) -> Iterator[HeardReport]:
    """The report of an ADSB_VEHICLE; none where it has no place, no altitude, or is old.

    The aircraft is called by its ICAO address, as other sources of ADS-B have it.
    """
    reference = REFERENCES.get(message.altitude_type)
    has_place = message.flags & HAS_ALL_OF_PLACE == HAS_ALL_OF_PLACE
    if not has_place or reference is None or message.tslc > OLD_S:
        return
    climb_m_s = message.ver_velocity * 0.01 if message.flags & HAS_CLIMB else math.nan
    velocity = UNKNOWN_VELOCITY
    if message.flags & HAS_VELOCITY == HAS_VELOCITY:
        velocity = over_ground(message.hor_velocity * 0.01, message.heading * 0.01, climb_m_s)
    report = PositionReport(
        t_utc_ns=now_utc_ns - message.tslc * NS,
        latitude_deg=message.lat * 1e-7,
        longitude_deg=message.lon * 1e-7,
        altitude_m=message.altitude * 1e-3,
        altitude_reference=reference,
        velocity_enu_m_s=velocity,
        **as_reported(OF_EMITTER_MAVLINK.get(message.emitter_type, SMALL)),
    )
    yield HeardReport.checked(f"{message.ICAO_address:06x}", report)


SYSTEM_TIME, GPS_RAW_INT, GLOBAL_POSITION_INT, HOME_POSITION = 2, 24, 33, 242
ODID_BASIC_ID, ODID_LOCATION, ODID_PACK = 12900, 12901, 12915
WANTED = frozenset(
    {SYSTEM_TIME, GPS_RAW_INT, GLOBAL_POSITION_INT, HOME_POSITION}
    | {ODID_BASIC_ID, ODID_LOCATION, ODID_PACK, ADSB_VEHICLE}
)
FIX_3D = 3
UNKNOWN_U16 = 0xFFFF
EPOCH_LEAST_US = 10**15  # 2001 by UTC, 31 years since a boot: a greater count is of UTC
MS_NS, US_NS = 1_000_000, 1000
# A system is not followed by what is less for so long after it sent its estimate, or came.
PREFERRED_FOR_NS = 3 * NS
MAX_PEERS = 256
MAX_SYSTEMS = 1000  # That are remembered; the one that has been silent longest gives way

AltitudeKind = Literal["mean_sea_level", "above_takeoff"]


@dataclass(slots=True)
class _System:
    """What is remembered of one that sends."""

    boot: SenderClock = field(default_factory=SenderClock)
    utc: SenderClock = field(default_factory=lambda: SenderClock(0))
    home_msl_m: float = math.nan
    # Rank of the message by which it is followed; at first there may be the best of all.
    best: int = 0
    best_until_ns: int = 0


class MavlinkReports(Listener):
    """Hears MAVLink from several peers, of each several systems, each a drone.

    A drone is followed by GLOBAL_POSITION_INT, what its autopilot estimates; where it sends none,
    by GPS_RAW_INT, else by its own Remote ID. Remote ID and ADS-B of others is theirs.
    """

    def __init__(self, template: str, altitude: AltitudeKind = "mean_sea_level") -> None:
        """`template` is that of names: {system}, {component}, {host}, {port}, {id}.

        `altitude` says whether the autopilot's altitude above the sea is taken, or that above home.
        Raises `PlotfeedError` without pymavlink.
        """
        self._template, self._altitude = template, altitude
        self._decode = mavlink_decoder()
        self._peers: dict[str, FrameSplitter[Any]] = {}
        self._systems: dict[str, _System] = {}
        self._others = RemoteIdReports("{id}")
        self._notes: list[str] = []
        self._take: dict[int, Callable[[str, _System, Any, int], Iterator[HeardReport]]] = {
            GLOBAL_POSITION_INT: self._global_position,
            GPS_RAW_INT: self._gps_raw,
            ODID_LOCATION: self._location,
            ODID_PACK: self._pack,
            ADSB_VEHICLE: lambda _peer, _system, message, now: aircraft_in(message, now),
        }

    def hear(self, peer: str, data: bytes, now_utc_ns: int) -> Iterator[HeardReport]:
        """The reports in octets of a peer; octets that are no frames are refused in one."""
        splitter = self._peers.get(peer) or FrameSplitter[Any](WANTED, self._decode)
        remember(self._peers, peer, splitter, MAX_PEERS)
        damaged = splitter.damaged
        for message in splitter.split(data):
            system = self._system(peer, message.get_srcSystem(), now_utc_ns)
            if (take := self._take.get(message.get_msgId())) is not None:
                yield from take(peer, system, message, now_utc_ns)
            else:
                self._note(system, message)
        if splitter.damaged > damaged:
            detail = f"{splitter.damaged - damaged} octets that are no MAVLink frame"
            yield HeardReport("", Refused(Reason.UNDECODABLE, detail))

    def forget(self, peer: str) -> None:
        """Drop the beginning of a frame."""
        self._peers.pop(peer, None)

    def notes(self) -> list[str]:
        """Which systems' clocks are off."""
        notes, self._notes = self._notes, []
        return notes

    def _system(self, peer: str, number: int, now_utc_ns: int) -> _System:
        key = f"{peer} {number}"
        system = self._systems.get(key) or _System(best_until_ns=now_utc_ns + PREFERRED_FOR_NS)
        remember(self._systems, key, system, MAX_SYSTEMS)
        return system

    def _name(self, peer: str, message: Any) -> str:
        host, _, port = peer.rpartition(":")
        values = {"system": message.get_srcSystem(), "component": message.get_srcComponent()}
        return named(self._template, {**values, "host": host, "port": port})

    def _note(self, system: _System, message: Any) -> None:
        """Keep what is no position by itself: a clock, where home is, whose a transmitter is."""
        kind = message.get_msgId()
        if kind == HOME_POSITION:
            system.home_msl_m = message.altitude * 1e-3
        elif kind == ODID_BASIC_ID:
            if whose := _whose(message):
                identity = identity_text(bytes(message.uas_id))
                self._others.identify(whose, OdidIdentity(message.id_type, identity))
        elif message.time_unix_usec >= EPOCH_LEAST_US:  # of SYSTEM_TIME; 0 before there is GPS time
            boot_ns = message.time_boot_ms * MS_NS
            system.boot.declare(message.time_unix_usec * US_NS - boot_ns, boot_ns)

    def _is_best(self, system: _System, rank: int, now_utc_ns: int) -> bool:
        """Whether the system is followed by messages of that rank, the least of late."""
        # Where our clock has jumped back, what was preferred until later is so no more.
        holds = 0 < system.best_until_ns - now_utc_ns <= PREFERRED_FOR_NS
        if holds and rank > system.best:
            return False
        system.best, system.best_until_ns = rank, now_utc_ns + PREFERRED_FOR_NS
        return True

    def _global_position(
        self, peer: str, system: _System, message: Any, now_utc_ns: int
    ) -> Iterator[HeardReport]:
        name = self._name(peer, message)
        if message.lat == 0 and message.lon == 0:
            yield _no_position(name)
            return
        if not self._is_best(system, 0, now_utc_ns):
            return
        above = self._altitude == "above_takeoff"
        report = PositionReport(
            t_utc_ns=self._time_ns(name, system.boot, message.time_boot_ms * MS_NS, now_utc_ns),
            latitude_deg=message.lat * 1e-7,
            longitude_deg=message.lon * 1e-7,
            altitude_m=(message.relative_alt if above else message.alt) * 1e-3,
            altitude_reference=AltitudeReference(self._altitude),
            # vx is north, vy east, vz down, cm/s
            velocity_enu_m_s=(message.vy * 0.01, message.vx * 0.01, -message.vz * 0.01),
        )
        yield HeardReport.checked(name, report)

    def _gps_raw(
        self, peer: str, system: _System, message: Any, now_utc_ns: int
    ) -> Iterator[HeardReport]:
        name = self._name(peer, message)
        if not self._is_best(system, 1, now_utc_ns):
            return
        if message.fix_type < FIX_3D or (message.lat == 0 and message.lon == 0):
            yield _no_position(name)
            return
        altitude_m = message.alt * 1e-3
        if self._altitude == "above_takeoff":
            if math.isnan(system.home_msl_m):
                detail = "no altitude above home: HOME_POSITION has not come yet"
                yield HeardReport(name, Refused(Reason.ALTITUDE, detail))
                return
            altitude_m -= system.home_msl_m
        is_utc = message.time_usec >= EPOCH_LEAST_US
        clock = system.utc if is_utc else system.boot
        report = PositionReport(
            t_utc_ns=self._time_ns(name, clock, message.time_usec * US_NS, now_utc_ns),
            latitude_deg=message.lat * 1e-7,
            longitude_deg=message.lon * 1e-7,
            altitude_m=altitude_m,
            altitude_reference=AltitudeReference(self._altitude),
            velocity_enu_m_s=UNKNOWN_VELOCITY
            if UNKNOWN_U16 in (message.vel, message.cog)
            else over_ground(message.vel * 0.01, message.cog * 0.01),
            # Absent in version 1, and read as 0 then.
            horizontal_accuracy_m=message.h_acc * 1e-3 or math.nan,
            vertical_accuracy_m=message.v_acc * 1e-3 or math.nan,
            velocity_accuracy_m_s=message.vel_acc * 1e-3 or math.nan,
        )
        yield HeardReport.checked(name, report)

    def _time_ns(self, name: str, clock: SenderClock, count_ns: int, now_utc_ns: int) -> int:
        was_off = clock.is_off
        t_utc_ns = clock.utc_ns(count_ns, now_utc_ns)
        if clock.is_off and not was_off:
            off = f"{abs(clock.off_s):.3f} s {'behind' if clock.off_s > 0 else 'ahead'}"
            self._notes.append(f"{name}: its clock is {off}: positions are of when they come")
        return t_utc_ns

    def _location(
        self, peer: str, system: _System, message: Any, now_utc_ns: int
    ) -> Iterator[HeardReport]:
        location, whose = _odid_location(message), _whose(message)
        if whose:
            yield self._others.located(whose, location, now_utc_ns)
        elif self._is_best(system, 2, now_utc_ns):
            heard = self._others.located("", location, now_utc_ns)
            yield HeardReport(self._name(peer, message), heard.said)

    def _pack(
        self, peer: str, system: _System, message: Any, now_utc_ns: int
    ) -> Iterator[HeardReport]:
        number = min(message.msg_pack_size, len(message.messages) // MESSAGE_OCTETS)
        octets = bytes(message.messages)[: number * MESSAGE_OCTETS]
        whose = _whose(message)
        if not whose and not self._is_best(system, 2, now_utc_ns):
            return
        pack = bytes([0xF2, message.single_message_size, number]) + octets
        for heard in self._others.said(whose or self._name(peer, message), pack, now_utc_ns):
            yield heard if whose else HeardReport(self._name(peer, message), heard.said)


def _whose(message: Any) -> str:
    """The transmitter of another aircraft that was heard; empty for the sender itself."""
    return bytes(message.id_or_mac).rstrip(bytes(1)).hex()


def _no_position(name: str) -> HeardReport:
    return HeardReport(
        name, Refused(Reason.NO_POSITION, "it has no position yet: no 3-D fix, or 0, 0")
    )


def _odid_location(message: Any) -> OdidLocation:
    """OPEN_DRONE_ID_LOCATION, in its units, as the same message off the air."""
    is_fixed = (message.latitude, message.longitude) != (0, 0)
    direction_deg = message.direction * 0.01
    return OdidLocation(
        latitude_deg=message.latitude * 1e-7 if is_fixed else math.nan,
        longitude_deg=message.longitude * 1e-7 if is_fixed else math.nan,
        ellipsoid_height_m=known(message.altitude_geodetic, UNKNOWN_ALTITUDE_M),
        pressure_altitude_m=known(message.altitude_barometric, UNKNOWN_ALTITUDE_M),
        height_m=known(message.height, UNKNOWN_ALTITUDE_M),
        is_over_ground=message.height_reference == 1,
        course_deg=direction_deg if direction_deg <= 360 else math.nan,
        speed_m_s=known(message.speed_horizontal * 0.01, UNKNOWN_SPEED_M_S),
        climb_m_s=known(message.speed_vertical * 0.01, UNKNOWN_CLIMB_M_S),
        horizontal_accuracy_m=accuracy(HORIZONTAL_M, message.horizontal_accuracy, RADIUS_95),
        vertical_accuracy_m=accuracy(VERTICAL_M, message.vertical_accuracy, EDGE_95),
        speed_accuracy_m_s=accuracy(SPEED_M_S, message.speed_accuracy, EDGE_95),
        past_hour_s=message.timestamp if 0 <= message.timestamp <= 3600 else math.nan,
    )


GROUND_STATION, ITS_COMPONENT = 255, 190
SLOW_US = 1_000_000  # Between two of what hardly changes
ALL_SYSTEMS, AUTOPILOT = 0, 1


@cache
def _station() -> tuple[Any, Any]:
    from pymavlink.dialects.v20 import common

    return common, common.MAVLink(None, srcSystem=GROUND_STATION, srcComponent=ITS_COMPONENT)


def heartbeat() -> bytes:
    """The sign that a ground station is there: some autopilots send to nobody else."""
    common, station = _station()
    message = station.heartbeat_encode(
        common.MAV_TYPE_GCS, common.MAV_AUTOPILOT_INVALID, 0, 0, common.MAV_STATE_ACTIVE
    )
    return bytes(message.pack(station))


def requests(every_us: int) -> Iterator[bytes]:
    """SET_MESSAGE_INTERVAL, command 511, for each message that is wanted, to all autopilots."""
    common, station = _station()
    intervals = {
        GLOBAL_POSITION_INT: every_us,
        GPS_RAW_INT: every_us,
        SYSTEM_TIME: SLOW_US,
        HOME_POSITION: SLOW_US,
    }
    for number, interval_us in intervals.items():
        message = station.command_long_encode(
            ALL_SYSTEMS,
            AUTOPILOT,
            common.MAV_CMD_SET_MESSAGE_INTERVAL,
            0,
            *(number, interval_us, 0, 0, 0, 0, 0),
        )
        yield bytes(message.pack(station))
