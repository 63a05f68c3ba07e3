"""The keys of telemetry: how it is taken, live sources, and JSON of other systems."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import Field

from plotfeed.feeds.console.printed import bracketed
from plotfeed.feeds.scene.fields import (
    Decibels,
    Height,
    Latitude,
    Longitude,
    Name,
    NotNegative,
    Positive,
    SceneTable,
    Size,
    parsed_by,
    split_address,
)
from plotfeed.models.state import AltitudeReference

LOOPBACK_4 = "127.0.0.1"
USUAL_BAUD = 57_600
OCTETS = frozenset({"udpin", "udpout", "tcp", "tcpin", "serial", "file", "stdin"})
# By the names that users know; mcast is a group to join.
_TRANSPORTS = {
    "udp": "udpin",
    "mcast": "udpin",
    "tcpout": "tcp",
    "http": "http",
    "https": "http",
    **{name: name for name in OCTETS - {"stdin"}},
}
MCAST_USUAL = "239.255.145.50:14550"  # Group of MAVLink's own `mcast:`, where none is named


@dataclass(frozen=True, slots=True)
class SourceKind:
    """A protocol that is understood: over what, how drones are called, and what a name may hold."""

    usual_name: str
    fields: frozenset[str]
    transports: frozenset[str] = OCTETS
    is_traffic: bool = False
    """Whether it tells of aircraft in general, which fly faster than drones."""


KINDS: Mapping[str, SourceKind] = {
    "mavlink": SourceKind("mav-{system}", frozenset({"system", "component", "host", "port"})),
    "remote-id": SourceKind("{id}", frozenset({"id"}), frozenset({"udpin", "udpout", "http"})),
    **{
        name: SourceKind("{icao}", frozenset({"icao", "callsign"}), is_traffic=True)
        for name in ("sbs1", "beast", "asterix-021")
    },
}


@dataclass(frozen=True, slots=True)
class SourceAddress:
    """A live source: its protocol, and the socket, serial port or file that it is heard at."""

    kind: str
    transport: str
    host: str = ""
    port: int = 0
    path: str = ""
    baud: int = USUAL_BAUD

    @classmethod
    def parse(cls, text: str) -> SourceAddress:
        """The source in mavlink:udpin:127.0.0.1:14550 and the like; raises `ValueError`."""
        kind, _, where = text.partition(":")
        if kind not in KINDS:
            kinds = ", ".join(KINDS)
            raise ValueError(f"expected KIND:TRANSPORT:PLACE, of the kinds {kinds}, not {text!r}")
        if where == "-" and "stdin" in KINDS[kind].transports:
            return cls(kind, "stdin")
        if where.startswith(("/", "COM")):
            where = f"serial:{where}"
        scheme, _, place = where.partition(":")
        transport = _TRANSPORTS.get(scheme)
        if transport == "http" and transport in KINDS[kind].transports:
            parts = urlsplit(where)
            secret = parts.username or parts.password or parts.query  # or what might be one
            if not parts.hostname or secret or parts.fragment:
                raise ValueError("expected http://HOST/PATH or https://, without user, ? and #")
            return cls(kind, transport, path=where)
        if transport is None or transport not in KINDS[kind].transports:
            known = sorted(n for n, t in _TRANSPORTS.items() if t in KINDS[kind].transports)
            serial = " or a serial port" if "serial" in known else ""
            raise ValueError(
                f"expected one of {', '.join(known)}{serial} after {kind}, not {text!r}"
            )
        place = place.removeprefix("//")
        if transport == "serial":
            path, baud = _serial(place, text)
            return cls(kind, transport, path=path, baud=baud)
        if transport == "file":
            if not place:
                raise ValueError(f"expected the path of a file after {text!r}")
            return cls(kind, transport, path=place)
        if scheme == "mcast" and not place:
            place = MCAST_USUAL
        if place.startswith(":") and transport in ("udpin", "tcpin"):
            place = LOOPBACK_4 + place
        host, port = split_address(place.rstrip("/"))
        return cls(kind, transport, _checked_host(transport, host), port)

    def __str__(self) -> str:
        if self.transport == "stdin":
            return f"{self.kind}:-"
        if self.transport == "serial":
            return f"{self.kind}:{self.path},{self.baud}"
        if self.transport == "file":
            return f"{self.kind}:file:{self.path}"
        if self.transport == "http":
            return f"{self.kind}:{self.path}"
        return f"{self.kind}:{self.transport}:{bracketed(self.host)}:{self.port}"

    @property
    def is_multicast(self) -> bool:
        """Whether it is a group that has to be joined."""
        try:
            return ipaddress.ip_address(self.host).is_multicast
        except ValueError:
            return False


def looks_like_source(text: str) -> bool:
    """Whether that is meant as the address of a live source, and not as the name of a file."""
    return text.partition(":")[0] in KINDS and ":" in text


def _serial(place: str, text: str) -> tuple[str, int]:
    """Path and baud rate of /dev/ttyACM0 or COM3, with ,57600 or :57600 behind it or not."""
    path, comma, rate = place.rpartition("," if "," in place else ":")
    if not comma:
        return place, USUAL_BAUD
    if not path or not (rate.isascii() and rate.isdigit() and 0 < int(rate) < 10_000_000):
        raise ValueError(f"expected a serial port such as /dev/ttyACM0,57600, not {text!r}")
    return path, int(rate)


def _checked_host(transport: str, host: str) -> str:
    """The host, of which sockets that listen need the number."""
    if transport == "tcp":
        return host
    if host == "localhost":
        return LOOPBACK_4
    try:
        return str(ipaddress.ip_address(host))
    except ValueError:
        raise ValueError(f"expected a numeric address, not {host!r}") from None


View = tuple[Latitude, Longitude, Latitude, Longitude]


class TelemetrySource(SceneTable):
    """A live source that the session itself listens to: autopilots, receivers, other systems."""

    url: Annotated[str, parsed_by(SourceAddress.parse)]
    """KIND:TRANSPORT:PLACE, such as mavlink:udpin:127.0.0.1:14550 or mavlink:/dev/ttyACM0,57600;
    without a host, this machine alone."""
    drone: Annotated[str, Field(min_length=1, max_length=64)] | None = None
    """What drones are called, with fields in braces, such as mav-{system}."""
    rcs_m2: Positive | None = None
    """Of what it tells of; without it, by an aircraft's category, else telemetry.rcs_m2."""
    target_class: Name | None = None
    """Their class to sensors; without it, aircraft where ADS-B says so, else drone."""
    altitude: Literal["mean_sea_level", "above_takeoff"] = "mean_sea_level"
    """Which of an autopilot's altitudes is taken: above the sea, or above home."""
    qnh_hpa: Annotated[float, Field(ge=850, le=1100)] | None = None
    """Pressure at sea level, for the pressure altitudes of ADS-B; without it, the standard
    atmosphere's."""
    interface: str | None = None
    """Interface, by name or IPv4 address, at which a multicast group is joined; without it, by the
    system's route."""
    view: Annotated[View, Field(strict=False)] | None = None
    """Of network Remote ID: two corners, latitude, longitude and again."""
    poll_s: Annotated[float, Field(ge=0.2, le=60)] = 1.0
    """How often a service of network Remote ID is asked."""
    ask_hz: Annotated[float, Field(ge=0.1, le=50)] | None = None
    """How often autopilots are asked for positions; without it, nothing is sent but over udpout."""

    def _refusals(self) -> Iterator[str]:
        kind = self.address.kind
        named = {part.partition("}")[0] for part in (self.drone or "").split("{")[1:]}
        unknown = sorted(named - KINDS[kind].fields)
        if unknown:
            known = ", ".join(f"{{{name}}}" for name in sorted(KINDS[kind].fields))
            yield f"drone: {{{unknown[0]}}} is not known of {kind}; expected {known}"
        if (self.address.transport == "http") != (self.view is not None):
            yield "view: network Remote ID is asked for one, and nothing else"
        if self.qnh_hpa is not None and not KINDS[kind].is_traffic:
            yield "qnh_hpa: only for ADS-B"
        if self.interface is not None:
            if self.address.transport != "udpin" or not self.address.is_multicast:
                yield f"interface: only for a multicast group, which {self.url} is not"
            if not self.interface or "\0" in self.interface:
                yield "interface: expected the name of one, or its address"
        for key in ("ask_hz", "altitude"):
            if kind != "mavlink" and getattr(self, key) != type(self).model_fields[key].default:
                yield f"{key}: only for mavlink"

    @property
    def address(self) -> SourceAddress:
        """The place at which it is heard."""
        return SourceAddress.parse(self.url)

    @property
    def template(self) -> str:
        """How its drones are called."""
        return self.drone or KINDS[self.address.kind].usual_name


PLACE = "{drone}"  # The level of a topic that is the drone's name


def _check_topic(text: str) -> None:
    levels = text.split("/")
    if not text.isprintable() or not text or any(PLACE in x and x != PLACE for x in levels):
        raise ValueError(f"expected levels of a topic, of which one may be {PLACE}, not {text!r}")
    if any(("+" in x and x != "+") or "#" in x for x in levels) or levels.count(PLACE) > 1:
        raise ValueError(f"expected + and {PLACE} as whole levels, {PLACE} once and no #: {text!r}")


def _check_path(text: str) -> None:
    if not re.fullmatch(r"[^.\s]+(\.[^.\s]+)*", text):
        raise ValueError(f"expected keys with dots between them, such as pos.lat, not {text!r}")


KeyPath = Annotated[str, Field(max_length=200), parsed_by(_check_path)]


class TelemetryMapping(SceneTable):
    """JSON of another system on the session's broker; keys are paths such as pos.lat or list.0."""

    topic: Annotated[str, Field(max_length=200), parsed_by(_check_topic)]
    """Such as fleet/{drone}/state; + is any level, {drone} the drone's name."""
    drone: KeyPath | None = None
    """Key of the drone's name, where the topic does not tell it."""
    latitude: KeyPath
    """Key of it; WGS-84, north."""
    longitude: KeyPath
    """Key of it; WGS-84, east."""
    angle_unit: Literal["deg", "rad", "1e-7deg"] = "deg"
    """Of latitude and longitude."""
    altitude: KeyPath
    """Key of it."""
    altitude_unit: Literal["m", "ft", "mm", "cm"] = "m"
    """Of what stands there."""
    altitude_reference: Annotated[AltitudeReference, Field(strict=False)]
    """What altitudes are above: ellipsoid, mean_sea_level or above_takeoff."""
    time: KeyPath | None = None
    """Key of it; without it, positions are of when they come."""
    time_format: Literal["iso", "s", "ms", "us", "ns"] = "iso"
    """ISO 8601 with a zone, or a number since 1970."""
    velocity_east: KeyPath | None = None
    """Key of it; without velocities, they are fitted to positions."""
    velocity_north: KeyPath | None = None
    """Key of it."""
    velocity_up: KeyPath | None = None
    """Key of it."""
    velocity_down: KeyPath | None = None
    """Key of it, in place of velocity_up."""
    speed: KeyPath | None = None
    """Key of it: over ground, with course, in place of velocity_east and velocity_north."""
    course: KeyPath | None = None
    """Key of it, degrees clockwise from true north."""
    speed_unit: Literal["m/s", "km/h", "kn", "mph", "cm/s"] = "m/s"
    """Of all velocities."""
    horizontal_accuracy_m: KeyPath | None = None
    """Key of one standard deviation on the ground."""
    vertical_accuracy_m: KeyPath | None = None
    """Key of one standard deviation of the altitude."""
    rcs_m2: Positive | None = None
    """Of its drones; without it, telemetry.rcs_m2."""

    def _refusals(self) -> Iterator[str]:
        if (PLACE in self.topic) == (self.drone is not None):
            yield (f"drone: either the topic has {PLACE}, or drone is the key of its name")
        if (self.speed is None) != (self.course is None):
            yield "speed: it and course belong together"
        if self.speed is not None and (self.velocity_east or self.velocity_north):
            yield "speed: either speed and course, or velocity_east and velocity_north"
        if self.velocity_up is not None and self.velocity_down is not None:
            yield "velocity_down: either it or velocity_up"

    @property
    def filter(self) -> str:
        """What is subscribed to."""
        return self.topic.replace(PLACE, "+")


Undulation = Annotated[float, Field(ge=-150, le=150)]  # Of the sea above the ellipsoid, metres
FlownSpeed = Annotated[float, Field(gt=0, le=1000)]  # Of a drone at most


class Telemetry(SceneTable):
    """How telemetry is taken, from MQTT, from files and from live sources."""

    stale_after_s: Positive = 3.0
    """A drone without news flies on for this long, and is then gone."""
    takeoff_height_m: Height | None = None
    """Above the ellipsoid; added to altitudes above take-off, which are refused without it."""
    geoid_undulation_m: Undulation | None = None
    """Height of mean sea level above the ellipsoid; without it, by EGM96 at each place."""
    geoid_grid: str | None = None
    """A finer geoid, GeoTIFF or GTX, that PROJ reads (extra geoid); relative to the scene."""
    max_ahead_s: NotNegative = 2.0
    """Telemetry from further in the future is refused."""
    max_age_s: Positive = 60.0
    """Telemetry older than this is refused."""
    max_speed_m_s: FlownSpeed = 150.0
    """Positions that a drone cannot have reached at this speed, with 30 m of grace, are refused.
    Multicopters reach 60 m/s, jets 150."""
    max_drones: Annotated[int, Field(ge=1, le=1_000_000)] = 10_000
    """Known at a time."""
    max_new_drones_per_s: Annotated[int, Field(ge=1, le=1_000_000)] = 500
    """That become known in a second; as many again of those refused before."""
    forget_after_s: Annotated[float, Field(ge=1, le=86_400)] = 60.0
    """A drone without news for so long is forgotten, one that reported once as soon as no sensor
    can see it."""
    rcs_m2: Positive = 0.01
    """Radar cross-section of a drone that states none."""
    sound_power_db: Decibels = 80.0
    """Sound power level, re 1 pW, of a drone that states none."""
    size_m: Size = 0.35
    """Size across of a drone that states none."""
    source: Annotated[tuple[TelemetrySource, ...], Field(strict=False, max_length=64)] = ()
    """Live sources that the session listens to itself, beside what comes by MQTT."""
    mapping: Annotated[tuple[TelemetryMapping, ...], Field(strict=False, max_length=64)] = ()
    """JSON of other systems on the session's broker, as telemetry."""

    def _refusals(self) -> Iterator[str]:
        is_traffic = any(KINDS[source.address.kind].is_traffic for source in self.source)
        if is_traffic and "max_speed_m_s" not in self.model_fields_set:
            yield (
                "max_speed_m_s: must be stated beside ADS-B, since aircraft fly faster than 150 "
                "m/s; 350 takes airliners"
            )
        if self.geoid_grid is not None and self.geoid_undulation_m is not None:
            yield "geoid_grid: either it or geoid_undulation_m says where sea level is"
