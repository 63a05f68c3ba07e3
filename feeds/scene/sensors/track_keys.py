"""The keys of a sensor that tracks on board."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import SceneTable
from plotfeed.feeds.scene.sensors.sensor_keys import SensorKeys


class TracksKeys(SceneTable):
    """How tracks begin and end, and how smooth they are: used by asterix-062 alone."""

    confirm_hits: Annotated[int, Field(ge=1, le=50)] = 3
    """Detections of a drone with which a track begins, among its last `confirm_window` looks."""
    confirm_window: Annotated[int, Field(ge=1, le=50)] = 5
    """Looks among which they are counted."""
    drop_misses: Annotated[int, Field(ge=1, le=1000)] = 5
    """Looks in a row without a detection after which it ends."""
    smoothing_scans: Annotated[float, Field(ge=0.1, le=1000)] = 3.0
    """Memory of the filter: a plot that is so many scans old weighs 1/e."""

    @model_validator(mode="after")
    def _can_begin(self) -> Self:
        if self.confirm_hits > self.confirm_window:
            raise ValueError("confirm_hits: must not exceed confirm_window")
        return self


class TrackingSensorKeys(SensorKeys):
    """A sensor that may report tracks."""

    tracks: TracksKeys = TracksKeys()
    """For asterix-062."""
