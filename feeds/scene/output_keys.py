"""The keys of where messages go: MQTT, UDP, SAPIENT, tracks, the page, and all ways out."""

from __future__ import annotations

import contextlib
import ipaddress
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field

from plotfeed.feeds.scene.fields import (
    Latitude,
    Longitude,
    Name,
    Positive,
    SceneTable,
    address_parts,
    parsed_by,
    split_address,
)
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.telemetry_keys import TelemetrySource

USUAL_MESSAGES = (0, 10_000)  # Of QoS 0, of which a late one is worth nothing, and of QoS 1


class MqttQueueKeys(SceneTable):
    """What waits for a broker that is away or slow; for each sensor."""

    policy: Literal["drop-oldest", "drop-newest", "wait"] = "drop-oldest"
    """What gives way when it is full: the oldest, the newest, or the session, which waits for room.
    """
    messages: Annotated[int, Field(ge=0, le=1_000_000)] | None = None
    """How many may wait, of each sensor and QoS; without it, 10,000 of QoS 1 and none of QoS 0."""
    max_age_s: Positive | None = None
    """What has waited longer is dropped; without it, nothing is for its age."""

    def limit(self, qos: int) -> int:
        """How many messages of a QoS may wait."""
        return USUAL_MESSAGES[qos] if self.messages is None else self.messages


def _check_origin(text: str) -> None:
    parts = urlsplit(text)
    if parts.scheme not in ("http", "https") or f"{parts.scheme}://{parts.netloc}" != text:
        raise ValueError(f"expected http://HOST:PORT, or https://, not {text!r}")


Origin = Annotated[str, parsed_by(_check_origin)]


def _ip_address(value: str) -> str:
    try:
        return str(ipaddress.ip_address(value))
    except ValueError:
        raise ValueError("expected an address such as 127.0.0.1 or 0.0.0.0") from None


class EmbeddedBrokerKeys(SceneTable):
    """The broker that a session brings, for MQTT 3.1.1 and 5, and what it bears."""

    host: Annotated[str, AfterValidator(_ip_address)] = "127.0.0.1"
    """Where it is heard; 0.0.0.0 for every address of the machine. Beyond loopback it asks for
    names and passwords."""
    users: bool = False
    """Whether it asks for them on loopback too."""
    websocket_origins: Annotated[tuple[Origin, ...], Field(strict=False)] | None = None
    """Web pages that may use MQTT over WebSocket, as http://localhost:5173; without this key there
    is no WebSocket."""
    max_memory_mib: Annotated[int, Field(ge=1, le=1_048_576)] = 512
    """Of messages that it keeps: what is retained, and what waits for slow clients."""
    max_connections: Annotated[int, Field(ge=10, le=100_000)] = 1000
    """At a time."""
    max_payload_octets: Annotated[int, Field(ge=65_536, le=256 << 20)] = 1 << 20
    """Of a message; who sends a larger one is cut off."""
    max_messages_per_s: Annotated[int, Field(ge=10, le=1_000_000)] = 50_000
    """Of a client; what it publishes beyond that is read later."""


def _check_prefix(value: str) -> None:
    if not value.isprintable() or value.startswith("$"):  # brokers keep $ for themselves
        raise ValueError("expected printable characters, of which the first is not $")


class Mqtt(SceneTable):
    """Where messages go."""

    prefix: Annotated[
        str, Field(pattern=r"^[^+#\s/]+(/[^+#\s/]+)*$", max_length=200), parsed_by(_check_prefix)
    ] = "plotfeed"
    """First level or levels of every topic."""
    broker: str | None = None
    """mqtt://HOST:PORT, or mqtts:// for TLS; without it, the embedded one on loopback."""
    port: Annotated[int, Field(ge=1, le=65534)] = 1883
    """Of the embedded broker; WebSocket is on the next. If it is taken: an error, or without this
    key another port."""
    version: Literal["5", "3.1.1", "any"] = "any"
    """Of MQTT, with a broker of your own; any tries 5 first."""
    qos: Literal[0, 1] = 0
    """Of what sensors report; status messages always have 1."""
    ca_file: str | None = None
    """Authorities for mqtts://; relative to the scene, as the files below."""
    client_certificate_file: str | None = None
    client_key_file: str | None = None
    credentials_file: str | None = None
    """TOML with username and password, and the keys of certificates and version if they are not
    here; PLOTFEED_MQTT_USERNAME and PLOTFEED_MQTT_PASSWORD override it."""
    queue: MqttQueueKeys = MqttQueueKeys()
    """What waits for the broker."""
    embedded: EmbeddedBrokerKeys = EmbeddedBrokerKeys()
    """What the embedded broker bears."""
    truth: bool = True
    """Whether the ledger is published on {prefix}/truth. A tracker under test must not read it."""


Confidence = Annotated[float, Field(ge=0, le=1)]
Class = Annotated[str, Field(min_length=1, max_length=200)]


class SapientPriorKeys(SceneTable):
    """Drones as sensors expect them: anywhere within range, up to 120 m above."""

    expected_drones: Annotated[float, Field(gt=0, le=10_000)] = 1.0
    """How many there are within a sensor's directions and range, on average."""
    rcs_m2: Annotated[float, Field(gt=0, le=1000)] = 0.01
    """Radar cross-section, mean over fluctuation."""
    sound_power_db: Annotated[float, Field(ge=0, le=200)] = 80.0
    """Re 1 pW."""
    size_m: Annotated[float, Field(gt=0, le=1000)] = 0.35
    """Across, as cameras see it."""
    eirp_dbm: Annotated[float, Field(ge=-100, le=100)] = 20.0
    """Of one emission, in the middle of an RF sensor's band."""


class SapientKeys(SceneTable):
    """Concerns the sensors whose `report` names sapient."""

    middleware: Annotated[str, parsed_by(split_address)] | None = None
    """HOST:PORT of a SAPIENT middleware, to which each sensor connects over TCP."""
    give_up_after_s: Annotated[float, Field(ge=0.5, le=600)] = 5.0
    """A middleware that reads nothing for so long is connected to anew."""
    max_messages_per_s: Annotated[int, Field(ge=1, le=100_000)] = 1000
    """That are taken from the middleware, of all sensors; with more, it has to wait."""
    max_octets_per_s: Annotated[int, Field(ge=1000, le=1_000_000_000)] = 1_000_000
    """Likewise, of these messages."""
    status_interval_s: Annotated[float, Field(ge=0.1, le=3600)] = 5.0
    """From one StatusReport to the next."""
    location: Literal["range-bearing", "location"] = "range-bearing"
    """How detections say where: location, of sensors of three dimensions, is latitude, longitude
    and height."""
    default_class: Class | None = None
    """What every detection is called; a class that was found goes below it."""
    default_class_confidence: Confidence = 1.0
    """Of any class that is stated: no sensor of plotfeed works one out."""
    late: Literal["drop", "restamp", "send"] = "drop"
    """What becomes of a message that its link delays by more than 0.8 s, which a middleware would
    refuse: dropped, stamped anew when it leaves, or sent as it is."""
    detection_confidence: Confidence | None = None
    """Of every detection; without it, by its SNR."""
    prior: SapientPriorKeys = SapientPriorKeys()
    """What drones are expected before anything is detected."""


Corner = Annotated[tuple[Latitude, Longitude], Field(strict=False)]


class BasemapImage(SceneTable):
    """A picture of the ground, such as a chart or aerial photograph."""

    image: str
    """PNG, JPEG or WebP; relative to the scene."""
    corners: Annotated[
        tuple[Corner, Corner, Corner, Corner], Field(strict=False, min_length=4, max_length=4)
    ]
    """Latitude and longitude from top left clockwise."""


class PageKeys(SceneTable):
    """The [page] of a scene."""

    basemap: Annotated[str | BasemapImage | None, Field(union_mode="smart")] = None
    """GeoJSON (RFC 7946), relative to the scene, or an image with its corners."""
    tracks_topic: str | None = None
    """Topic of the tracker under test: ASTERIX 062 or JSON."""
    afterglow_s: Annotated[float, Field(ge=1, le=60)] = 10.0
    """For how long plots fade."""

    def _refusals(self) -> Iterator[str]:
        topic = self.tracks_topic
        if topic is not None and (
            not 1 <= len(topic) <= 200 or not topic.isprintable() or any(c in topic for c in "+# ")
        ):
            yield "tracks_topic: expected one topic, without +, # or space"


MIN_OCTETS, USUAL_OCTETS, MAX_OCTETS = 64, 1400, 65_000


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A numeric address and a port."""

    address: ipaddress.IPv4Address | ipaddress.IPv6Address
    port: int

    @classmethod
    def parse(cls, text: str) -> Endpoint:
        """The endpoint in 239.1.2.3:8600 or [ff02::1]:8600; raises `ValueError`."""
        host, number, bracketed = address_parts(text)
        with contextlib.suppress(ValueError):
            address = ipaddress.IPv6Address(host) if bracketed else ipaddress.IPv4Address(host)
            if number:
                return cls(address, number)
        raise ValueError(
            f"expected ADDRESS:PORT such as 239.255.0.1:8600 or [ff15::1]:8600, not {text!r}"
        )


def _check_endpoint(text: str) -> None:
    address = Endpoint.parse(text).address
    if address.is_unspecified:
        raise ValueError(f"expected the address of one host or a multicast group, not {address}")
    if (
        isinstance(address, ipaddress.IPv6Address)
        and address.is_link_local
        and not address.scope_id
    ):
        raise ValueError(f"a link-local address needs its interface, such as {address}%eth0")


class UdpDestination(SceneTable):
    """Where ASTERIX, or Cursor on Target, goes besides MQTT."""

    destination: Annotated[str, parsed_by(_check_endpoint)]
    """ADDRESS:PORT, numeric; a multicast group or one host."""
    carries: Literal["asterix", "cot"] = "asterix"
    """All ASTERIX, or the events of sensors that report in cot, as TAK takes them from
    239.2.3.1:6969."""
    sensors: Annotated[tuple[Name, ...], Field(strict=False)] = ()
    """Whose messages go there; all sensors' if it is left out."""
    ttl: Annotated[int, Field(ge=0, le=255)] = 1
    """Of multicast datagrams: 1 stays in the local network."""
    interface: str | None = None
    """By which multicast leaves, by name or IPv4 address."""
    max_octets: Annotated[int, Field(ge=MIN_OCTETS, le=MAX_OCTETS)] = USUAL_OCTETS
    """Of a datagram; data blocks are cut to fit, and an event is one."""

    def _refusals(self) -> Iterator[str]:
        if self.interface is None:
            return
        if not self.is_multicast:
            yield f"interface: only for multicast, which {self.destination} is not"
        if not self.interface or "\0" in self.interface:
            yield "interface: expected the name of one, or its address"

    @property
    def is_multicast(self) -> bool:
        """Whether it goes to a group."""
        return Endpoint.parse(self.destination).address.is_multicast

    def takes(self, sensor: str) -> bool:
        """Whether that sensor's messages go there."""
        return not self.sensors or sensor in self.sensors

    @property
    def format(self) -> str | None:
        """The format that goes there, as a sensor's `report` names it; None for all ASTERIX."""
        return None if self.carries == "asterix" else self.carries


TOKEN_VARIABLE = "PLOTFEED_HTTP_TOKEN_"  # noqa: S105 - how its name begins  # nosec B105
TAK_PORTS = {"tcp": 8087, "tls": 8089}


def split_server(text: str) -> tuple[str, str, int]:
    """Scheme, host and port of tcp://HOST[:PORT] or tls://HOST[:PORT]; raises `ValueError`."""
    expected = ValueError(f"expected tcp://HOST:PORT, or tls://, not {text!r}")
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError:
        raise expected from None
    rest = parts.path + parts.query + parts.fragment
    if parts.scheme not in TAK_PORTS or not parts.hostname or rest or "@" in parts.netloc:
        raise expected
    return parts.scheme, parts.hostname, TAK_PORTS[parts.scheme] if port is None else port


def _check_url(text: str) -> None:
    try:
        parts = urlsplit(text)
        _ = parts.port
    except ValueError:
        parts = urlsplit("")
    if "@" in parts.netloc:
        raise ValueError("expected an address without a user or password: name a token instead")
    plain = text.isascii() and text.isprintable() and " " not in text and not parts.fragment
    if parts.scheme not in ("http", "https") or not parts.hostname or not plain:
        raise ValueError("expected http://HOST:PORT/PATH, or https://")


class TrackDestination(SceneTable):
    """What destinations of tracks have in common."""

    only: ClassVar[str] = ""
    """The format that goes there, where no key `carries` tells it."""

    sensors: Annotated[tuple[Name, ...], Field(strict=False)] = ()
    """Whose messages go there; all sensors' if it is left out."""

    def takes(self, sensor: str) -> bool:
        """Whether that sensor's messages go there."""
        return not self.sensors or sensor in self.sensors

    @property
    def format(self) -> str:
        """The format that goes there, as a sensor's `report` names it."""
        return str(getattr(self, "carries", self.only))

    @property
    def content_type(self) -> str:
        """The content type of what goes there."""
        return REPORT_FORMATS[self.format].content_type


class QueuedDestination(TrackDestination):
    """A server that may be away, slow, or refuse what it is sent."""

    queue_messages: Annotated[int, Field(ge=1, le=100_000)] = 100
    """That wait for it; of more the oldest are dropped."""
    timeout_s: Annotated[float, Field(ge=0.1, le=60)] = 5.0
    """A server that takes longer is given up, and tried anew."""
    ca_file: str | None = None
    """Of who vouches for it, where TLS is spoken; relative to the scene, as the files below."""


class TakServer(QueuedDestination):
    """A TAK server to which events of Cursor on Target go."""

    only = "cot"

    server: Annotated[str, parsed_by(split_server)]
    """tcp://HOST:PORT, or tls://HOST:PORT; without a port 8087, or 8089."""
    client_certificate_file: str | None = None
    """What the server asks of its clients, a PEM file."""
    client_key_file: str | None = None
    """Of that certificate, where it is a file of its own."""
    server_name: str | None = None
    """In the server's certificate, where that is not the host."""

    def _refusals(self) -> Iterator[str]:
        given = (self.ca_file, self.client_certificate_file, self.client_key_file, self.server_name)
        if any(each is not None for each in given) and not self.server.startswith("tls://"):
            yield "server: certificates and names of theirs need tls://"


class HttpDestination(QueuedDestination):
    """An address to which messages are posted, one after the other."""

    url: Annotated[str, parsed_by(_check_url)]
    """http:// or https://, with path and query; {session} in it stands for a UUID of the run."""
    carries: Literal["air-traffic", "f3411", "geojson"] = "air-traffic"
    """Format of the messages, which the sensors must have in their `report`."""
    token: Annotated[str, Field(pattern=r"^[A-Z0-9_]{1,64}$")] | None = None
    """Bearer token to send: NAME for that in the environment variable PLOTFEED_HTTP_TOKEN_NAME."""
    retries: Annotated[int, Field(ge=0, le=100)] = 3
    """Of a message for which there is no server, or a busy or broken one; what it refuses is not
    sent again."""


class ListeningDestination(TrackDestination):
    """A port of this machine at which others connect."""

    host: Literal["127.0.0.1", "::1", "0.0.0.0", "::"] = "127.0.0.1"  # noqa: S104 - if asked for
    """Address to listen on; the last two let in other machines."""
    port: Annotated[int, Field(ge=1, le=65535)]
    """To listen on."""


class WebSocketKeys(ListeningDestination):
    """A server at which maps connect, and are told of tracks."""

    carries: Literal["geojson", "air-traffic", "f3411", "foxglove-geojson"] = "geojson"
    """Format of the messages, which the sensors must have in their `report`."""
    origins: Annotated[tuple[Origin, ...], Field(strict=False)] = ()
    """Web pages that may connect, as http://localhost:5173; programs always may."""
    max_clients: Annotated[int, Field(ge=1, le=1000)] = 50
    """At a time."""
    queue_messages: Annotated[int, Field(ge=1, le=100_000)] = 100
    """That wait for a slow client; of more the oldest are dropped."""


class RemoteIdService(ListeningDestination):
    """Where others ask for tracks as network Remote ID."""

    only = "f3411"

    token: Annotated[str, Field(pattern=r"^[A-Z0-9_]{1,64}$")] | None = None
    """Bearer token that callers must send: NAME for that in the environment variable
    PLOTFEED_HTTP_TOKEN_NAME; without it, none."""


FILES = ("ca_file", "client_certificate_file", "client_key_file")


@dataclass(frozen=True, slots=True, kw_only=True)
class WaysOut:
    """Where a session sends, what opens the doors there, and whom it lets in and listens to."""

    mqtt: Mqtt = field(default_factory=Mqtt)
    """The broker and the keys to it, or what the embedded one bears and whom it lets in."""
    waits: bool = False
    """Whether a broker that is not up yet is waited for."""
    udp: tuple[UdpDestination, ...] = ()
    tak: tuple[TakServer, ...] = ()
    http: tuple[HttpDestination, ...] = ()
    websocket: tuple[WebSocketKeys, ...] = ()
    remote_id_service: tuple[RemoteIdService, ...] = ()
    middleware: str | None = None
    """HOST:PORT of a SAPIENT middleware."""
    sources: tuple[TelemetrySource, ...] = ()
    """Live telemetry that is listened to."""

    @property
    def queued(self) -> tuple[TakServer | HttpDestination, ...]:
        """The servers that may be away or slow."""
        return *self.tak, *self.http


class DestinationTables(SceneTable):
    """The tables of a scene that name destinations beside MQTT."""

    udp: Annotated[tuple[UdpDestination, ...], Field(strict=False)] = ()
    tak: Annotated[tuple[TakServer, ...], Field(strict=False)] = ()
    http: Annotated[tuple[HttpDestination, ...], Field(strict=False)] = ()
    websocket: Annotated[tuple[WebSocketKeys, ...], Field(strict=False)] = ()
    remote_id_service: Annotated[tuple[RemoteIdService, ...], Field(strict=False)] = ()

    def refused_destinations(self, reports: Mapping[str, Sequence[str]]) -> Iterator[str]:
        """Destinations that name no sensor, or ones that have nothing for them.

        `reports` are the formats of whoever sends, by name.
        """
        for kind in DestinationTables.model_fields:
            for n, each in enumerate(getattr(self, kind)):
                for name in each.sensors:
                    if name not in reports:
                        yield f"{kind}[{n}].sensors: no sensor has the id {name!r}"
                wanted = each.format
                theirs = [formats for name, formats in reports.items() if each.takes(name)]
                if wanted is not None and not any(wanted in formats for formats in theirs):
                    yield (
                        f"{kind}[{n}]: none of its sensors has {wanted!r} in its report, and "
                        "nothing else goes there"
                    )

    def destinations(self, file: Callable[[str], Path]) -> dict[str, Any]:
        """What is named, table by table, its files by where they are, which `file` finds."""

        def placed(each: SceneTable) -> SceneTable:
            named = {name: getattr(each, name, None) for name in FILES}
            paths = {name: str(file(value)) for name, value in named.items() if value is not None}
            return each.model_copy(update=paths)

        return {
            name: tuple(map(placed, getattr(self, name))) for name in DestinationTables.model_fields
        }
