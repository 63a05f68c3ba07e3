"""What happens to a sensor while a scene runs: outages and degradations, by its own script."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from plotfeed.feeds.parts import NotNegative, Part, Positive
from plotfeed.feeds.times import NS


class Event(Part):
    """A [[sensor.event]] of the scene: the sensor is otherwise for a while."""

    from_s: NotNegative
    """When it begins, after the session has."""
    to_s: Positive | None = None
    """When it is over; without it, never."""
    set: Annotated[dict[str, Any], Field(min_length=1)]
    """Keys of the sensor that have other values meanwhile: { enabled = false }, or
    { link = { down = true } }, or { pfa_factor = 10 } for ten times its own pfa."""

    @model_validator(mode="after")
    def _ends_after_it_began(self) -> Self:
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError("to_s: must be above from_s")
        return self


def in_force(events: tuple[Event, ...], elapsed_ns: int) -> list[Mapping[str, Any]]:
    """What the events of a sensor change so long after the beginning, later ones last."""
    return [
        event.set
        for event in events
        if round(event.from_s * NS) <= elapsed_ns
        and (event.to_s is None or elapsed_ns < round(event.to_s * NS))
    ]


def instants_ns(events: tuple[Event, ...]) -> list[int]:
    """When anything begins or ends, after the session has, in order."""
    edges_s = [e.from_s for e in events] + [e.to_s for e in events if e.to_s is not None]
    return sorted({round(edge_s * NS) for edge_s in edges_s})
