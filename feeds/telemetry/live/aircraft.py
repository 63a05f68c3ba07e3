"""Aircraft from ADS-B, as receivers hand it on: SBS-1, Beast, and ASTERIX 021; and what they are.

The sets A and B of their categories are those of DO-260B, 2.2.3.2.5.2; MAVLink counts through both.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from plotfeed.feeds.telemetry.live.heard import HeardReport, Listener, named, remember
from plotfeed.feeds.telemetry.position_report import (
    UNKNOWN_VELOCITY,
    PositionReport,
    Reason,
    Refused,
    Velocity,
    over_ground,
)
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.asterix.decode_cooperative import AircraftReport, read_021
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.mode_s import (
    BeastSplitter,
    CprPosition,
    GroundVelocity,
    Said,
    global_position,
    local_position,
    read_squitter,
)
from plotfeed.proto.units import FOOT_M, KNOT_M_S
from plotfeed.proto.utc import NS, nearest_utc_ns

AIRCRAFT = "aircraft"  # The class of what is no drone


class AircraftKind(NamedTuple):
    """Radar cross-section and size across of a kind of aircraft."""

    rcs_m2: float
    size_m: float


LIGHT = AircraftKind(1.0, 11.0)
SMALL = AircraftKind(2.0, 14.6)
LARGE = AircraftKind(20.0, 35.8)
HEAVY = AircraftKind(100.0, 60.9)
FAST = AircraftKind(6.0, 13.1)
ROTORCRAFT = AircraftKind(3.0, 13.6)
GLIDER = AircraftKind(0.5, 15.0)
# Cross-sections: Skolnik, Introduction to Radar Systems, 3rd edition, table 2.2; that of a glider
# is assumed. Sizes: spans of a Cessna 172, Learjet 45, Boeing 737-800, 777-200ER and F-15, the
# length of an H145 with its rotor, and the span of the standard class.
UNMANNED = None

OF_CATEGORY: Mapping[str, AircraftKind | None] = {
    "A1": LIGHT,
    "A2": SMALL,
    "A3": LARGE,
    "A4": LARGE,
    "A5": HEAVY,
    "A6": FAST,
    "A7": ROTORCRAFT,
    "B1": GLIDER,
    "B4": GLIDER,
    "B6": UNMANNED,
}
# I021/020 counts set A from 1 on up to its sixth, and has others for the rest.
OF_EMITTER_021: Mapping[int, AircraftKind | None] = {
    number: OF_CATEGORY[f"A{number}"] for number in range(1, 7)
} | {10: ROTORCRAFT, 11: GLIDER, 13: UNMANNED, 16: GLIDER}
OF_EMITTER_MAVLINK: Mapping[int, AircraftKind | None] = {
    int(name[1]) + (8 if name[0] == "B" else 0): kind for name, kind in OF_CATEGORY.items()
}


def as_reported(kind: AircraftKind | None) -> dict[str, Any]:
    """The fields of a report of one; what is unmanned is a drone as the scene has it."""
    if kind is None:
        return {}
    return {"rcs_m2": kind.rcs_m2, "size_m": kind.size_m, "target_class": AIRCRAFT}


FOOT_MIN_M_S = FOOT_M / 60
# For how long halves make a pair, a place helps to find the next, and a velocity holds.
PAIR_NS, KNOWN_NS, VELOCITY_NS = 10 * NS, 30 * NS, 5 * NS
OFF_NS = 5 * NS  # A time of the day that is further from now is of a clock that is off
MAX_AIRCRAFT, MAX_PEERS = 20_000, 256
MAX_LINE_OCTETS = 1024
STANDARD_HPA = 1013.25
METRES_PER_HPA = 8.23  # At sea level in the standard atmosphere


@dataclass(slots=True)
class _Aircraft:
    """What is remembered of one, which says one thing at a time."""

    callsign: str = ""
    kind: AircraftKind | None = SMALL  # That of one that tells none is the usual one
    halves: dict[bool, tuple[int, CprPosition]] = field(default_factory=dict)
    place: tuple[float, float] | None = None
    place_ns: int = 0
    velocity: Velocity = UNKNOWN_VELOCITY
    velocity_ns: int = 0
    geometric_less_pressure_m: float = math.nan


class AircraftReports(Listener):
    """Hears one of three protocols, of several receivers; an aircraft is one, whoever heard it."""

    def __init__(self, kind: str, template: str, qnh_hpa: float | None = None) -> None:
        """`kind` is sbs1, beast or asterix-021; names have {icao} and {callsign}.

        `qnh_hpa` is the pressure at sea level, by which altitudes of pressure become such above it.
        """
        by_kind = {"sbs1": self._hear_lines, "beast": self._hear_frames}
        self._hear = by_kind.get(kind, self._hear_blocks)
        self._template = template
        # What the pressure altitude 0 is above the sea.
        self._over_sea_m = ((qnh_hpa or STANDARD_HPA) - STANDARD_HPA) * METRES_PER_HPA
        self._aircraft: dict[str, _Aircraft] = {}
        self._lines: dict[str, bytes] = {}
        self._frames: dict[str, BeastSplitter] = {}

    def hear(self, peer: str, data: bytes, now_utc_ns: int) -> Iterator[HeardReport]:
        """The reports in octets of a receiver."""
        return self._hear(peer, data, now_utc_ns)

    def forget(self, peer: str) -> None:
        """Drop the beginning of a line, frame or block."""
        self._lines.pop(peer, None)
        self._frames.pop(peer, None)

    def _of(self, icao: str) -> _Aircraft:
        found = self._aircraft.get(icao) or _Aircraft()
        remember(self._aircraft, icao, found, MAX_AIRCRAFT)
        return found

    def _hear_lines(self, peer: str, data: bytes, now_utc_ns: int) -> Iterator[HeardReport]:
        *lines, rest = (self._lines.pop(peer, b"") + data).split(b"\n")
        if len(rest) <= MAX_LINE_OCTETS:
            remember(self._lines, peer, rest, MAX_PEERS)
            rest = b""
        for line in (*lines, rest):
            if len(line) > MAX_LINE_OCTETS:
                detail = f"a line of more than {MAX_LINE_OCTETS} octets"
                yield HeardReport("", Refused(Reason.OVERSIZED, detail))
            elif line.strip():  # an empty one says that the receiver is there
                yield from self._line(line.decode("latin-1").strip().split(","), now_utc_ns)

    def _line(self, cells: list[str], now_utc_ns: int) -> Iterator[HeardReport]:
        """A line of SBS-1; its dates are local times without a zone, so it is of when it comes."""
        if cells[0] != "MSG" or len(cells) < 17:
            if cells[0] not in ("SEL", "ID", "AIR", "STA", "CLK", "MSG"):
                detail = f"a line {','.join(cells)[:60]!a}; expected SBS-1"
                yield HeardReport("", Refused(Reason.UNDECODABLE, detail))
            return
        icao = cells[4].strip().lower()
        aircraft = self._of(icao)
        aircraft.callsign = cells[10].strip() or aircraft.callsign
        speed, track, climb = (_number(cells[n]) for n in (12, 13, 16))
        if not math.isnan(speed) and not math.isnan(track):
            aircraft.velocity = over_ground(speed * KNOT_M_S, track, climb * FOOT_MIN_M_S)
            aircraft.velocity_ns = now_utc_ns
        place = _number(cells[14]), _number(cells[15])
        if not any(map(math.isnan, place)):
            pressure_m = _number(cells[11]) * FOOT_M
            yield self._report(icao, aircraft, now_utc_ns, place, (math.nan, pressure_m))

    def _hear_frames(self, peer: str, data: bytes, now_utc_ns: int) -> Iterator[HeardReport]:
        splitter = self._frames.get(peer) or BeastSplitter()
        remember(self._frames, peer, splitter, MAX_PEERS)
        damaged = splitter.damaged
        for message in splitter.split(data):
            found = read_squitter(message)
            if found is not None:
                yield from self._said(*found, now_utc_ns)
        if splitter.damaged > damaged:
            detail = f"{splitter.damaged - damaged} octets that are no frame of Beast"
            yield HeardReport("", Refused(Reason.UNDECODABLE, detail))

    def _said(self, icao: str, said: Said, now_utc_ns: int) -> Iterator[HeardReport]:
        aircraft = self._of(icao)
        if isinstance(said, CprPosition):
            aircraft.halves[said.is_odd] = now_utc_ns, said
            place = _place(aircraft, said, now_utc_ns)
            if place is not None:
                aircraft.place, aircraft.place_ns = place, now_utc_ns
                altitude_m = said.altitude_ft * FOOT_M
                geometric_m = altitude_m
                if not said.is_geometric:
                    geometric_m += aircraft.geometric_less_pressure_m
                yield self._report(icao, aircraft, now_utc_ns, place, (geometric_m, altitude_m))
        elif isinstance(said, GroundVelocity):
            aircraft.velocity = (
                *(said.east_kt * KNOT_M_S, said.north_kt * KNOT_M_S),
                said.climb_ft_min * FOOT_MIN_M_S,
            )
            aircraft.velocity_ns = now_utc_ns
            aircraft.geometric_less_pressure_m = said.geometric_less_pressure_ft * FOOT_M
        else:
            aircraft.callsign = said.callsign or aircraft.callsign
            aircraft.kind = OF_CATEGORY.get(said.category, aircraft.kind)

    def _hear_blocks(self, peer: str, data: bytes, now_utc_ns: int) -> Iterator[HeardReport]:
        """Data blocks: of a datagram, or of a stream that is cut anywhere."""
        buffer = self._lines.pop(peer, b"") + data
        end = 0
        while end + 3 <= len(buffer) and buffer[end] == 21:
            octets = int.from_bytes(buffer[end + 1 : end + 3], "big")
            if octets <= 3 or end + octets > len(buffer):
                break
            end += octets
        rest = buffer[end:]
        try:
            reports = read_021(buffer[:end])
        except DecodeError as error:
            reports = []
            detail = f"no ASTERIX 021 of editions 2.1 to 2.7: {error}"
            yield HeardReport("", Refused(Reason.UNDECODABLE, detail))
        if rest[:1] == b"\x15" and rest[1:3] != b"\0\0":
            remember(self._lines, peer, rest, MAX_PEERS)
        elif rest:
            detail = f"{len(rest)} octets that are no block of ASTERIX 021"
            yield HeardReport("", Refused(Reason.UNDECODABLE, detail))
        for report in reports:
            yield self._of_block(report, now_utc_ns)

    def _of_block(self, said: AircraftReport, now_utc_ns: int) -> HeardReport:
        aircraft = self._of(said.icao)
        aircraft.callsign = said.callsign or aircraft.callsign
        aircraft.kind = OF_EMITTER_021.get(said.emitter, aircraft.kind)
        velocity = said.velocity_east_m_s, said.velocity_north_m_s, said.climb_m_s
        if not all(map(math.isnan, velocity)):
            aircraft.velocity, aircraft.velocity_ns = velocity, now_utc_ns
        t_utc_ns = now_utc_ns
        if not math.isnan(said.t_of_day_s):
            t_utc_ns = nearest_utc_ns(round(said.t_of_day_s * NS), now_utc_ns)
            t_utc_ns = t_utc_ns if abs(t_utc_ns - now_utc_ns) <= OFF_NS else now_utc_ns
        place = said.latitude_deg, said.longitude_deg
        heights_m = said.height_m, said.flight_level_m
        return self._report(said.icao, aircraft, t_utc_ns, place, heights_m)

    def _report(
        self,
        icao: str,
        aircraft: _Aircraft,
        t_utc_ns: int,
        place: tuple[float, float],
        heights_m: tuple[float, float],
    ) -> HeardReport:
        names: Mapping[str, str] = {"icao": icao, "callsign": aircraft.callsign or icao}
        name = named(self._template, names)
        (altitude_m, pressure_m), reference = heights_m, AltitudeReference.ELLIPSOID
        if math.isnan(altitude_m):  # by pressure, where it does not say it above the ellipsoid
            altitude_m, reference = pressure_m + self._over_sea_m, AltitudeReference.MEAN_SEA_LEVEL
        if math.isnan(altitude_m):
            return HeardReport(name, Refused(Reason.ALTITUDE, "it says no altitude"))
        has_velocity = abs(t_utc_ns - aircraft.velocity_ns) <= VELOCITY_NS
        report = PositionReport(
            t_utc_ns=t_utc_ns,
            latitude_deg=place[0],
            longitude_deg=place[1],
            altitude_m=altitude_m,
            altitude_reference=reference,
            velocity_enu_m_s=aircraft.velocity if has_velocity else UNKNOWN_VELOCITY,
            **as_reported(aircraft.kind),
        )
        return HeardReport.checked(name, report)


def _place(aircraft: _Aircraft, half: CprPosition, now_utc_ns: int) -> tuple[float, float] | None:
    """The place of an aircraft: near the one that is known, else by halves of both kinds."""
    if aircraft.place is not None and 0 <= now_utc_ns - aircraft.place_ns <= KNOWN_NS:
        return local_position(half, aircraft.place)
    other_ns, other = aircraft.halves.get(not half.is_odd, (0, half))
    if other is half or not 0 <= now_utc_ns - other_ns <= PAIR_NS:
        return None
    even, odd = (other, half) if half.is_odd else (half, other)
    return global_position(even, odd, latest_is_odd=half.is_odd)


def _number(cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
