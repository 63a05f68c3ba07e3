"""The keys of what tracks leave by: TAK servers, HTTP, and a WebSocket for maps."""

from __future__ import annotations

from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, model_validator

from plotfeed.feeds.scene.fields import Name, SceneTable
from plotfeed.feeds.scene.output_keys import Origin
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS

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


def _server(text: str) -> str:
    split_server(text)
    return text


def _url(text: str) -> str:
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
    return text


class TrackDestination(SceneTable):
    """What destinations of tracks have in common."""

    sensors: Annotated[tuple[Name, ...], Field(strict=False)] = ()
    """Whose messages go there; all sensors' if it is left out."""

    def takes(self, sensor: str) -> bool:
        """Whether that sensor's messages go there."""
        return not self.sensors or sensor in self.sensors

    @property
    def format(self) -> str:
        """The format that goes there, as a sensor's `report` names it."""
        raise NotImplementedError

    @property
    def content_type(self) -> str:
        """The content type of what goes there."""
        return REPORT_FORMATS[self.format].content_type


class QueuedDestination(TrackDestination):
    """A server that may be away, slow, or refuse what it is sent."""

    queue_messages: Annotated[int, Field(ge=1, le=100_000)] = 100
    """That wait for it; of more the oldest are dropped."""
    timeout_s: Annotated[float, Field(ge=0.1, le=60)] = 5.0
    """A server that takes longer to connect, to read or to answer is given up, and tried anew."""
    ca_file: str | None = None
    """Of who vouches for it, where TLS is spoken; relative to the scene, as the files below."""


class TakServer(QueuedDestination):
    """A [[tak]] of the scene: a TAK server to which events of Cursor on Target go."""

    server: Annotated[str, AfterValidator(_server)]
    """tcp://HOST:PORT, or tls://HOST:PORT; without a port 8087, or 8089."""
    client_certificate_file: str | None = None
    """What the server asks of its clients, a PEM file."""
    client_key_file: str | None = None
    """Of that certificate, where it is a file of its own."""
    server_name: str | None = None
    """In the server's certificate, where that is not the host."""

    @property
    def format(self) -> str:
        """Cursor on Target."""
        return "cot"

    @model_validator(mode="after")
    def _certificates_need_tls(self) -> Self:
        given = (self.ca_file, self.client_certificate_file, self.client_key_file, self.server_name)
        if any(each is not None for each in given) and not self.server.startswith("tls://"):
            raise ValueError("server: certificates and names of theirs need tls://")
        return self


class HttpDestination(QueuedDestination):
    """A [[http]] of the scene: an address to which messages are posted, one after the other."""

    url: Annotated[str, AfterValidator(_url)]
    """http:// or https://, with path and query; {session} in it stands for a UUID of the run."""
    carries: Literal["air-traffic", "f3411", "geojson"] = "air-traffic"
    """Format of the messages, which the sensors must have in their `report`."""
    token: Annotated[str, Field(pattern=r"^[A-Z0-9_]{1,64}$")] | None = None
    """Which bearer token to send: NAME is that in the environment variable
    PLOTFEED_HTTP_TOKEN_NAME; a scene itself never holds one."""
    retries: Annotated[int, Field(ge=0, le=100)] = 3
    """Of a message that found no server, or one that is busy or broken; one that the server refuses
    is not sent again."""

    @property
    def format(self) -> str:
        """Format that it carries."""
        return self.carries


class ListeningDestination(TrackDestination):
    """A port of this machine at which others connect."""

    host: Literal["127.0.0.1", "::1", "0.0.0.0", "::"] = "127.0.0.1"  # noqa: S104 - if asked for
    """Address to listen on; the last two let in who can reach this machine."""
    port: Annotated[int, Field(ge=1, le=65535)]
    """To listen on."""


class WebSocketKeys(ListeningDestination):
    """A [[websocket]] of the scene: a server to which maps connect, and are told of tracks."""

    carries: Literal["geojson", "air-traffic", "f3411", "foxglove-geojson"] = "geojson"
    """Format of the messages, which the sensors must have in their `report`."""
    origins: Annotated[tuple[Origin, ...], Field(strict=False)] = ()
    """Web pages that may connect, each as its browser names it, such as http://localhost:5173;
    programs that are no browsers always may."""
    max_clients: Annotated[int, Field(ge=1, le=1000)] = 50
    """At a time."""
    queue_messages: Annotated[int, Field(ge=1, le=100_000)] = 100
    """That wait for a client that is slow; of more the oldest are dropped."""

    @property
    def format(self) -> str:
        """Format that it carries."""
        return self.carries


class RemoteIdService(ListeningDestination):
    """A [[remote_id_service]] of the scene: where others ask for tracks as network Remote ID."""

    token: Annotated[str, Field(pattern=r"^[A-Z0-9_]{1,64}$")] | None = None
    """Which bearer token whoever asks must send: NAME is that in the environment variable
    PLOTFEED_HTTP_TOKEN_NAME; without this key all who reach the port are answered."""

    @property
    def format(self) -> str:
        """Flights of ASTM F3411."""
        return "f3411"
