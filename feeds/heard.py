"""A message that a broker has passed on, with all that came with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Heard:
    """As it came, over MQTT 5 or, without content type and properties, 3.1.1."""

    topic: str
    payload: bytes
    content_type: str | None
    properties: tuple[tuple[str, str], ...]
    """User properties."""
    retain: bool
    """Whether it was published so; over MQTT 3.1.1, whether it was there before we were."""
    qos: int
    """The lower one of what it was published with and 1."""


OnHeard = Callable[[Heard], None]
