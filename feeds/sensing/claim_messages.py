"""What drones say of themselves as messages: ASTERIX 129, and telemetry in JSON or protobuf."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.scene.claim_keys import CLAIMED, COOPERATIVE, CooperativeKeys
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.telemetry.decode_reports import encode_json, encode_protobuf
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.models.state import AltitudeReference, Floats
from plotfeed.proto.asterix.cat129 import TargetEncoder129
from plotfeed.proto.content_types import (
    JSON,
    TELEMETRY,
    asterix_content_type,
    protobuf_content_type,
)

HALF_OF_POSITIONS = (2 * np.log(2)) ** 0.5
"""Radius that holds half of a circular normal distribution, in standard deviations."""
AS_TELEMETRY: dict[str, tuple[str, Callable[[PositionReport], bytes]]] = {
    "json": (JSON, encode_json),
    "protobuf": (protobuf_content_type(TELEMETRY), encode_protobuf),
}
"""Content type and encoder of what is said as telemetry is."""


@dataclass(frozen=True, slots=True)
class DroneClaim:
    """What one drone says once: where it was, when, and how it flew; height over the ellipsoid."""

    drone: str
    t_utc_ns: int
    latitude_deg: float
    longitude_deg: float
    height_m: float
    velocity_enu_m_s: Floats


class ClaimMessages:
    """Messages of claims, in the formats that the scene names."""

    def __init__(self, scene: Scene, settings: CooperativeKeys) -> None:
        """Encode as [cooperative] says; raises `PlotfeedError` where sea level is not known."""
        self._formats = settings.report
        self._accuracy_m = settings.accuracy_m
        self._sea_level = scene.sea_level()
        self._encoder = TargetEncoder129(settings.sac, settings.sic, country=settings.country)
        self._prefix, self._qos = scene.mqtt.prefix, scene.mqtt.qos
        self._source = f"{self._prefix}/{COOPERATIVE}"

    def messages(self, number: int, due_utc_ns: int, claims: Sequence[DroneClaim]) -> list[Message]:
        """All of one time, in the order of drones; `number` is that of the period."""
        by_format = [
            self._as_129(claims) if name == "asterix-129" else self._as_telemetry(name, claims)
            for name in self._formats
        ]
        found = []
        for claim, *said in zip(claims, *by_format, strict=True):
            for kind, topic, content_type, payload in said:
                what = attributes(
                    self._source, kind, f"{number}-{claim.drone}", due_utc_ns, drone=claim.drone
                )
                found.append(Message(topic, payload, content_type, due_utc_ns, what, qos=self._qos))
        return found

    def _as_129(self, claims: Sequence[DroneClaim]) -> list[tuple[str, str, str, bytes]]:
        if not claims:
            return []
        places = [(c.latitude_deg, c.longitude_deg, c.height_m) for c in claims]
        latitude_deg, longitude_deg, height_m = np.array(places).T
        accuracy_m = np.full(len(claims), self._accuracy_m * HALF_OF_POSITIONS)
        blocks = self._encoder.blocks(
            [claim.drone for claim in claims],
            np.array([claim.t_utc_ns for claim in claims], np.int64),
            latitude_deg,
            longitude_deg,
            altitude_m=height_m - self._sea_level.undulation_m(latitude_deg, longitude_deg),
            accuracy_m=accuracy_m if self._accuracy_m else None,
            velocity_m_s=np.array([claim.velocity_enu_m_s for claim in claims]),
        )
        head = "asterix/129", f"{self._source}/asterix/129", asterix_content_type(129)
        return [(*head, block) for block in blocks]

    def _as_telemetry(
        self, name: str, claims: Sequence[DroneClaim]
    ) -> list[tuple[str, str, str, bytes]]:
        content_type, encode = AS_TELEMETRY[name]
        accuracy_m = self._accuracy_m or None
        found = []
        for claim in claims:
            east, north, up = claim.velocity_enu_m_s.tolist()
            report = PositionReport(
                t_utc_ns=claim.t_utc_ns,
                latitude_deg=claim.latitude_deg,
                longitude_deg=claim.longitude_deg,
                altitude_m=claim.height_m,
                altitude_reference=AltitudeReference.ELLIPSOID,
                velocity_enu_m_s=(east, north, up),
                horizontal_accuracy_m=accuracy_m,
                vertical_accuracy_m=accuracy_m,
            )
            topic = f"{self._prefix}/{CLAIMED}/{claim.drone}"
            found.append((CLAIMED, topic, content_type, encode(report)))
        return found
