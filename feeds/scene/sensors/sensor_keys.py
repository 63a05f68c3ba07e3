"""What all sensors of a scene have in common."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import (
    Azimuth,
    Elevation,
    Enu,
    Name,
    NotNegative,
    Positive,
    SceneTable,
    Site,
)
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.sensors.effect_keys import BiasKeys, DriftKeys
from plotfeed.models.beam.cover import AzimuthCover
from plotfeed.models.sensors.sensor_model import SensorModel
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


class _Periodic(SceneTable):
    """What ways of scanning have in common."""

    period_s: Annotated[float, Field(ge=0.02, le=3600)]
    """Of a scan."""
    jitter_ms: NotNegative = 0.0
    """Standard deviation of a scan's beginning from its time; at most a fiftieth of the period."""

    @model_validator(mode="after")
    def _scans_keep_their_order(self) -> Self:
        if self.jitter_ms * 50 > self.period_s * 1000:
            raise ValueError("jitter_ms: at most a fiftieth of period_s")
        return self


class RotatingScan(_Periodic):
    """A beam that turns clockwise, through true north at whole multiples of its period."""

    kind: Literal["rotating"]
    """Which way of scanning."""
    sectors: Annotated[int, Field(ge=4, le=256)] = 32
    """Reports a turn; a divisor of 256 makes their edges exact in CAT034."""


class StaringScan(_Periodic):
    """A sensor that looks everywhere at once, at whole multiples of its period."""

    kind: Literal["staring"]
    """Which way of scanning."""


Scan = Annotated[RotatingScan | StaringScan, Field(discriminator="kind")]


class SensorKeys(SceneTable):
    """A [[sensor]] of the scene."""

    id: Name
    """A level of its topics, so without `/`, `+`, `#` or space."""
    preset: str | None = None
    """A commercial sensor whose keys stand where the scene gives none: `plotfeed sensors`."""
    sac: Annotated[int, Field(ge=0, le=255)] = 0
    """System area code of its ASTERIX."""
    sic: Annotated[int, Field(ge=0, le=255)] = 1
    """The sensor's name in ASTERIX: system area and identification codes."""
    position_enu_m: Enu = (0.0, 0.0, 0.0)
    """Of the antenna or microphone: east, north and up of the site."""
    enabled: bool = True
    """Whether it is at work; a sensor that is not reports nothing but its status."""
    link: LinkSettings | None = None
    """Between the sensor and whoever hears it; without one, messages leave when they are due."""
    event: Annotated[tuple[Event, ...], Field(strict=False)] = ()
    """What happens to it while the scene runs."""
    bias: BiasKeys | None = None
    """Systematic errors; without it, none."""
    drift: DriftKeys | None = None
    """Errors that change slowly; without it, none."""

    @model_validator(mode="before")
    @classmethod
    def _reports_as_usual(cls, keys: Any) -> Any:
        """A sensor whose formats are not given reports as its kind usually does."""
        if not isinstance(keys, dict) or "report" in keys:
            return keys
        return {**keys, "report": cls.usual_report(keys)}

    @classmethod
    def usual_report(cls, _keys: dict[str, Any], /) -> tuple[str, ...]:
        """The formats of such a sensor, given its other keys, not validated yet."""
        return ("plots",)

    def model(self, site: Site, /) -> SensorModel:
        """The model that these keys make, at that site."""
        raise NotImplementedError

    def warnings(self, _site: Site, /) -> list[str]:
        """What is legal and still looks wrong; for `check`."""
        return []


class AzimuthCoverKeys(SensorKeys):
    """A sensor that looks or listens in some directions, clockwise from one to another."""

    azimuth_min_deg: Azimuth = -180.0
    """Where cover begins, from true north."""
    azimuth_max_deg: Azimuth = 180.0
    """Where it ends, clockwise of azimuth_min_deg."""

    @model_validator(mode="after")
    def _looks_somewhere(self) -> Self:
        if not 0 < self.azimuth_max_deg - self.azimuth_min_deg <= 360:
            raise ValueError("azimuth_max_deg: must be above azimuth_min_deg, by at most 360")
        return self

    @property
    def azimuth_cover(self) -> AzimuthCover:
        """The same for the model."""
        return AzimuthCover(self.azimuth_min_deg, self.azimuth_max_deg)


class VolumeKeys(AzimuthCoverKeys):
    """A radar's cover in range, azimuth and elevation."""

    range_min_m: NotNegative = 0.0
    """The blind range: nothing nearer is reported."""
    range_max_m: Annotated[float, Field(gt=0, le=470_000)]
    """Instrumented: nothing further is reported."""
    elevation_min_deg: Elevation
    """Lowest elevation of cover."""
    elevation_max_deg: Elevation
    """Highest elevation of cover."""

    @model_validator(mode="after")
    def _covers_something(self) -> Self:
        if not self.range_min_m < self.range_max_m:
            raise ValueError("range_min_m: must be less than range_max_m")
        if not self.elevation_min_deg < self.elevation_max_deg:
            raise ValueError("elevation_min_deg: must be less than elevation_max_deg")
        return self
