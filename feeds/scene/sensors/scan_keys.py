"""How a sensor scans, and a scripted event that makes it otherwise while the scene runs."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import NotNegative, Positive, SceneTable
from plotfeed.proto.utc import NS


class Event(SceneTable):
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


class _Periodic(SceneTable):
    """What all scans have in common."""

    period_s: Annotated[float, Field(ge=0.02, le=3600)]
    """Of a scan."""
    jitter_ms: NotNegative = 0.0
    """Standard deviation of a scan's beginning from its time; at most a fiftieth of the period."""

    @model_validator(mode="after")
    def _scans_keep_their_order(self) -> Self:
        if self.jitter_ms * 50 > self.period_s * 1000:
            raise ValueError("jitter_ms: at most a fiftieth of period_s")
        return self

    @property
    def period_ns(self) -> int:
        """Nanoseconds of a scan."""
        return round(self.period_s * NS)


class RotatingScan(_Periodic):
    """A beam that turns clockwise, through true north at whole multiples of its period."""

    kind: Literal["rotating"]
    """Which way of scanning."""
    sectors: Annotated[int, Field(ge=4, le=256)] = 32
    """Reports a turn; a divisor of 256 makes their edges exact in CAT034."""

    @property
    def rotates(self) -> bool:
        """Whether a beam turns."""
        return True


class StaringScan(_Periodic):
    """A sensor that looks everywhere at once, at whole multiples of its period."""

    kind: Literal["staring"]
    """Which way of scanning."""

    @property
    def rotates(self) -> bool:
        """Whether a beam turns."""
        return False

    @property
    def sectors(self) -> int:
        """Reports a scan."""
        return 1


Scan = Annotated[RotatingScan | StaringScan, Field(discriminator="kind")]
