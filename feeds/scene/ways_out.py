"""Where a session sends, by a scene's keys or by whoever names others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import Field

from plotfeed.feeds.scene.fields import SceneTable
from plotfeed.feeds.scene.output_keys import (
    EmbeddedBrokerKeys,
    Mqtt,
    SapientKeys,
    UdpDestination,
)
from plotfeed.feeds.scene.source_keys import TelemetrySource
from plotfeed.feeds.scene.track_output_keys import (
    HttpDestination,
    QueuedDestination,
    RemoteIdService,
    TakServer,
    WebSocketKeys,
)

FILES = ("ca_file", "client_certificate_file", "client_key_file")
Q = TypeVar("Q", bound=QueuedDestination)


@dataclass(frozen=True, slots=True, kw_only=True)
class WaysOut:
    """Where a session sends, what opens the doors there, and whom it lets in and listens to."""

    broker: str | None = None
    """URL; None is the embedded broker."""
    waits: bool = False
    """Whether a broker that is not up yet is waited for."""
    port: int | None = None
    """Of the embedded broker, if it must be that one."""
    embedded: EmbeddedBrokerKeys = field(default_factory=EmbeddedBrokerKeys)
    """Whom it lets in, and what it bears."""
    ca_file: Path | None = None
    certificate_file: Path | None = None
    key_file: Path | None = None
    credentials_file: Path | None = None
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

    def check_senders(self, reports: Mapping[str, Sequence[str]]) -> None:
        """Raise `ValueError` if a destination names no sensor, or one that has nothing for it.

        `reports` are the formats of whoever sends, by name.
        """
        for kind in DestinationTables.model_fields:
            for n, each in enumerate(getattr(self, kind)):
                for name in each.sensors:
                    if name not in reports:
                        raise ValueError(f"{kind}[{n}].sensors: no sensor has the id {name!r}")
                wanted = each.format
                theirs = [formats for name, formats in reports.items() if each.takes(name)]
                if wanted is not None and not any(wanted in formats for formats in theirs):
                    raise ValueError(
                        f"{kind}[{n}]: none of its sensors has {wanted!r} in its report, and "
                        "nothing else goes there"
                    )


def outgoing_of(
    mqtt: Mqtt,
    sapient: SapientKeys,
    destinations: DestinationTables,
    sources: tuple[TelemetrySource, ...],
    file: Callable[[str], Path],
) -> WaysOut:
    """What a scene's keys say; `file` finds the files that they name."""
    names = (
        mqtt.ca_file,
        mqtt.client_certificate_file,
        mqtt.client_key_file,
        mqtt.credentials_file,
    )
    ca, certificate, key, credentials = (None if n is None else file(n) for n in names)
    return WaysOut(
        broker=mqtt.broker,
        port=mqtt.port if "port" in mqtt.model_fields_set else None,
        embedded=mqtt.embedded,
        ca_file=ca,
        certificate_file=certificate,
        key_file=key,
        credentials_file=credentials,
        udp=destinations.udp,
        tak=_found(destinations.tak, file),
        http=_found(destinations.http, file),
        websocket=destinations.websocket,
        remote_id_service=destinations.remote_id_service,
        middleware=sapient.middleware,
        sources=sources,
    )


def _found(destinations: Iterable[Q], file: Callable[[str], Path]) -> tuple[Q, ...]:
    """DestinationTables whose files are named by where they are."""
    found = []
    for each in destinations:
        named = {name: getattr(each, name, None) for name in FILES}
        paths = {name: str(file(value)) for name, value in named.items() if value is not None}
        found.append(each.model_copy(update=paths))
    return tuple(found)
