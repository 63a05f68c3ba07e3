"""The [sapient] table of the scene: what SAPIENT messages say, and where they go besides MQTT."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from plotfeed.feeds.parts import Part

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


class Sapient(Part):
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
