"""The keys of what messages leave by: the queue for MQTT, SAPIENT, the live page."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from plotfeed.feeds.scene.fields import Latitude, Longitude, Positive, SceneTable

USUAL_MESSAGES = (0, 10_000)
"""Of QoS 0, of which a late one is worth nothing, and of QoS 1."""


class MqttQueueKeys(SceneTable):
    """What waits for a broker that is away, stalled, or slow to acknowledge; for each sensor."""

    policy: Literal["drop-oldest", "drop-newest", "wait"] = "drop-oldest"
    """What gives way when as much waits as may: the oldest, what comes, or the session, which
    stands still until there is room."""
    messages: Annotated[int, Field(ge=0, le=1_000_000)] | None = None
    """How many may wait, of each QoS; without it, 10,000 of QoS 1 and none of QoS 0, since a late
    plot is worth nothing."""
    max_age_s: Positive | None = None
    """What has waited longer is dropped; without it, nothing is for its age."""

    def limit(self, qos: int) -> int:
        """How many messages of a QoS may wait."""
        return USUAL_MESSAGES[qos] if self.messages is None else self.messages


Confidence = Annotated[float, Field(ge=0, le=1)]
Class = Annotated[str, Field(min_length=1, max_length=200)]


def split_address(text: str) -> tuple[str, int]:
    """Host and port of HOST:PORT or [IPv6]:PORT; raises `ValueError`."""
    host, _, port = text.rpartition(":")
    bracketed = host.startswith("[") and host.endswith("]")
    number = int(port) if port.isascii() and port.isdigit() and len(port) <= 5 else 0
    name = host[1:-1] if bracketed else host
    plain = name.isprintable() and not set(name) & set(" /@[]") and (bracketed or ":" not in name)
    if not name or not plain or not 0 < number < 65536:
        raise ValueError(f"expected HOST:PORT such as 127.0.0.1:5000, not {text!r}")
    return name, number


def _address(text: str) -> str:
    split_address(text)
    return text


class SapientKeys(SceneTable):
    """Concerns the sensors whose `report` names sapient."""

    middleware: Annotated[str, AfterValidator(_address)] | None = None
    """HOST:PORT of a SAPIENT middleware, to which each sensor connects over TCP."""
    status_interval_s: Annotated[float, Field(ge=0.1, le=3600)] = 5.0
    """From one StatusReport to the next."""
    location: Literal["range-bearing", "location"] = "range-bearing"
    """How detections say where: location is latitude, longitude and height, of sensors that
    measure in three dimensions; the others keep to range and bearing."""
    default_class: Class | None = None
    """What every detection is called; a class that the sensor found goes below it."""
    default_class_confidence: Confidence = 1.0
    """Of any class that is stated: no sensor of plotfeed works one out."""
    late: Literal["drop", "restamp", "send"] = "drop"
    """What becomes of a message that its link delays by more than 0.8 s, when a middleware that
    takes stamps up to 0.9 s old would refuse it: it is dropped, stamped with the time at which it
    leaves, or sent as it is."""
    detection_confidence: Confidence | None = None
    """Of every detection; without it, one less the sensor's pfa."""


Corner = Annotated[tuple[Latitude, Longitude], Field(strict=False)]


class BasemapImage(SceneTable):
    """A picture of the ground, such as a chart or an aerial photograph, cut out anyhow."""

    image: str
    """PNG, JPEG or WebP; relative to the scene."""
    corners: Annotated[
        tuple[Corner, Corner, Corner, Corner], Field(strict=False, min_length=4, max_length=4)
    ]
    """Latitude and longitude of its top left, top right, bottom right and bottom left corner."""


class PageKeys(SceneTable):
    """The [page] of a scene."""

    basemap: Annotated[str | BasemapImage | None, Field(union_mode="smart")] = None
    """A GeoJSON file (RFC 7946), relative to the scene, or an image with its corners."""
    tracks_topic: str | None = None
    """Where the tracker under test publishes its tracks, as ASTERIX 062 or JSON; no wildcards."""
    afterglow_s: Annotated[float, Field(ge=1, le=60)] = 10.0
    """For how long plots fade."""

    @model_validator(mode="after")
    def _topic_is_one(self) -> Self:
        topic = self.tracks_topic
        if topic is not None and (
            not 1 <= len(topic) <= 200 or not topic.isprintable() or any(c in topic for c in "+# ")
        ):
            raise ValueError("tracks_topic: expected one topic, without +, # or space")
        return self
