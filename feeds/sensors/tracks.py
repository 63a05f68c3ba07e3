"""The keys of a sensor that tracks on board."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from plotfeed.feeds.parts import Part
from plotfeed.feeds.sensors.base import SensorPart


class TracksPart(Part):
    """How tracks begin and end, and how smooth they are: used by asterix-062 alone."""

    confirm_hits: Annotated[int, Field(ge=1, le=50)] = 3
    """A track begins with so many detections of a drone,"""
    confirm_window: Annotated[int, Field(ge=1, le=50)] = 5
    """among so many looks at it."""
    drop_misses: Annotated[int, Field(ge=1, le=1000)] = 5
    """It ends after so many looks in a row without a detection."""
    smoothing_scans: Annotated[float, Field(ge=0.1, le=1000)] = 3.0
    """Within so many scans the weight of a plot in a track falls to 1/e."""

    @model_validator(mode="after")
    def _can_begin(self) -> Self:
        if self.confirm_hits > self.confirm_window:
            raise ValueError("confirm_hits: must not exceed confirm_window")
        return self


class TrackingSensorPart(SensorPart):
    """A sensor that may report tracks."""

    tracks: TracksPart = TracksPart()
