"""What all sensors of a scene have in common: keys, and the traits that tell their kinds apart.

A sensor is added in two files: its model, and its keys, which derive from `SensorKeys` and are
registered (`feeds.scene.sensors`). Everything that formats, the page and the chart have to
know of its kind is a trait, a class attribute of the keys; one that is missing is an error when the
class is defined.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import Field, GetJsonSchemaHandler, ValidationError, field_validator, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails
from pydantic_core.core_schema import definitions_schema

from plotfeed.feeds.scene.fields import (
    Azimuth,
    Elevation,
    Enu,
    Height,
    Location,
    Name,
    NotNegative,
    SceneTable,
    Site,
    enu_from,
    frame_at,
)
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.sensors.effect_keys import BiasKeys, DegradationKeys, DriftKeys
from plotfeed.feeds.scene.sensors.scan_keys import AnyScan, Event
from plotfeed.feeds.scene.world_keys import JammerKeys, WeatherKeys
from plotfeed.models.beam import AzimuthCover
from plotfeed.models.sensors.sensor_model import SensorModel
from plotfeed.models.tracks import MAX_TRACKS
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.feeds.scene.sensors.illuminator_keys import IlluminatorKeys


class SensorGeometry(Enum):
    """Along which path a sensor measures range, if it does."""

    MONOSTATIC = "there and back"
    BISTATIC = "from a transmitter elsewhere to the target and on to the sensor, less the baseline"
    BEARINGS = "none: it measures no range"


TRAITS = ("label", "geometry", "sapient_type", "formats")
# Formats, by the names that `report_formats` has for them; of a sensor, those of its trait.
Reports = Annotated[tuple[Any, ...], Field(strict=False, min_length=1)]


class SensorKeys(SceneTable):
    """A [[sensor]] of the scene."""

    label: ClassVar[str]
    """What people call such a sensor."""
    geometry: ClassVar[SensorGeometry]
    sapient_type: ClassVar[Literal["RADAR", "ACOUSTIC", "PASSIVE_RF", "CAMERA", "OTHER"]]
    """What it is to SAPIENT."""
    formats: ClassVar[tuple[str, ...]]
    """Those that a scene may ask of it, by name."""
    usual: ClassVar[tuple[str, ...]] = ("plots",)
    """Those in which it reports where a scene asks for none."""
    tells_models: ClassVar[bool] = False
    """Whether it names models of drones, beside its own `classes`."""
    makes: ClassVar[type[SensorModel]]
    """Its model, whose fields have the keys and properties of the same names."""

    if TYPE_CHECKING:  # keys of every sensor, which stand where each of them has them
        type: str
        """Which model."""
        report: tuple[str, ...]
        scan: AnyScan
        """How it scans."""
        range_max_m: float

    id: Name
    """A level of its topics, so without `/`, `+`, `#` or space."""
    preset: str | None = None
    """A commercial sensor whose keys stand where the scene gives none: `plotfeed sensors`."""
    sac: Annotated[int, Field(ge=0, le=255)] = 0
    """System area code of its ASTERIX."""
    sic: Annotated[
        int, Field(ge=0, le=255, json_schema_extra=lambda schema: schema.pop("default", None))
    ] = 1
    """System identification code; without it, the first from 1 on that is free under that `sac`."""
    position_enu_m: Enu = (0.0, 0.0, 0.0)
    """Of the antenna or microphone: east, north and up of the site."""
    height_msl_m: Height | None = None
    """Above mean sea level, in place of the third of position_enu_m."""
    enabled: bool = True
    """Whether it is at work; if not, it reports its status alone."""
    link: LinkSettings | None = None
    """Between the sensor and whoever hears it; without it, no delay and no loss."""
    event: Annotated[tuple[Event, ...], Field(strict=False)] = ()
    """What happens to it while the scene runs."""
    bias: BiasKeys | None = None
    """Systematic errors; without it, none."""
    drift: DriftKeys | None = None
    """Errors that change slowly; without it, none."""
    degradation: DegradationKeys | None = None
    """What it does worse than it takes itself to do; without it, nothing."""
    weather: WeatherKeys | None = None
    """About it, if a radar or microphone; [[weather]] is that of all sensors."""
    jamming: dict[Name, JammerKeys] = Field(default={})
    """What drowns a radar's or RF sensor's signals, by a name; [[jammer]] is for all."""

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Refuse a sensor whose traits do not say what it is."""
        super().__pydantic_init_subclass__(**kwargs)
        if "type" not in cls.model_fields:
            return  # what several sensors have in common
        missing = [name for name in TRAITS if not hasattr(cls, name)]
        if missing:
            raise TypeError(f"{cls.__name__} lacks the traits {', '.join(missing)}")
        if (cls.geometry is SensorGeometry.BISTATIC) == (cls.illuminators is NO_ILLUMINATORS):
            raise TypeError(f"{cls.__name__}: bistatic sensors have illuminators, others none")
        for name in cls.formats:
            if REPORT_FORMATS[name].tells_tracks and not issubclass(cls, TrackingSensorKeys):
                raise TypeError(f"{cls.__name__} reports tracks without being TrackingSensorKeys")

    @classmethod
    def type_name(cls) -> str:
        """The `type` that tells such a sensor from others."""
        return str(get_args(cls.model_fields["type"].annotation)[0])

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler, /
    ) -> JsonSchemaValue:
        """JSON schema of the keys, with the formats that may be asked for.

        The keys of every sensor stand in one definition. What names there are is said by
        `propertyNames`, which older validators know too, unlike `unevaluatedProperties`.
        """
        schema = super().__get_pydantic_json_schema__(core_schema, handler)
        table = handler.resolve_ref_schema(schema)
        keys = table["properties"]
        if "report" in keys:
            keys["report"]["items"] = {"enum": list(cls.formats), "type": "string"}
        if cls is SensorKeys:
            del table["additionalProperties"]
            return schema
        SensorKeys.model_rebuild()
        # Wrapped, because `handler` would leave out what the class itself says of its schema.
        of_every = handler(definitions_schema(SensorKeys.__pydantic_core_schema__, []))
        shared = handler.resolve_ref_schema(of_every)["properties"]
        if shared.items() <= keys.items():
            del table["additionalProperties"]
            table["propertyNames"] = {"enum": list(keys)}
            table["properties"] = {name: key for name, key in keys.items() if name not in shared}
            table["allOf"] = [of_every]
        return schema

    @field_validator("report", check_fields=False)
    @classmethod
    def _can_report(cls, report: tuple[Any, ...]) -> tuple[str, ...]:
        named = [repr(name) for name in cls.formats]
        expected = f"{', '.join(named[:-1])} or {named[-1]}" if named[1:] else named[0]
        wrong = [
            InitErrorDetails(type="literal_error", loc=(i,), input=name, ctx={"expected": expected})
            for i, name in enumerate(report)
            if name not in cls.formats
        ]
        if wrong:
            raise ValidationError.from_exception_data("report", wrong)
        return report

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
        return cls.usual

    def model(self, site: Site, /) -> SensorModel:
        """The model that these keys make, at that site."""
        return self.made(self.makes, **self.following(site))

    def following(self, _site: Site, /) -> dict[str, Any]:
        """Fields of the model that have not just the key of the same name."""
        return {}

    def offset_enu_m(self, site: Site, place: Location) -> tuple[float, float, float]:
        """A place seen from the sensor, metres east, north and up."""
        frame = frame_at(site, self.position_enu_m)
        east_m, north_m, up_m = enu_from(frame, site, place).tolist()
        return east_m, north_m, up_m

    @property
    def believed(self) -> Self:
        """The sensor as it takes itself to be: not degraded."""
        return self if self.degradation is None else self.model_copy(update={"degradation": None})

    @property
    def illuminators(self) -> tuple[IlluminatorKeys, ...]:
        """The transmitters elsewhere whose echoes a bistatic sensor receives."""
        return ()

    @property
    def band_hz(self) -> tuple[float, float] | None:
        """Lowest and highest frequency that a receiver of emissions takes in."""
        return None

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of what the sensor finds, if it classifies."""
        classifier = getattr(self, "classifier", None)
        return () if classifier is None else classifier.claims

    @property
    def class_codes(self) -> Mapping[str, int]:
        """Numbers of its classes in I015/300, if it has agreed on any with a receiver."""
        classifier = getattr(self, "classifier", None)
        return {} if classifier is None else classifier.codes or {}

    @property
    def tells_kinds(self) -> bool:
        """Whether it names whatever kind of emission it finds, beside its own `classes`."""
        return getattr(self, "classifies", False)

    def categories(self, report: str) -> list[int]:
        """The categories of ASTERIX that a format brings from this sensor, its own first."""
        return [
            number
            for number, sent in REPORT_FORMATS[report].categories.items()
            if (self.scan.rotates or not sent.rotates)
            and (self.illuminators or not sent.has_illuminators)
        ]

    @property
    def false_alarm_probability(self) -> float | None:
        """Probability of a false alarm in a cell, if the sensor decides by that."""
        return getattr(self, "pfa", None)

    @property
    def clock_ahead_ns(self) -> int:
        """Nanoseconds by which the clock is ahead that stamps all that it sends."""
        return 0 if self.bias is None else round(self.bias.time_offset_s * NS)

    def warnings(self, _site: Site, /) -> Iterable[str]:
        """What is legal and still looks wrong; for `check`."""
        return ()


NO_ILLUMINATORS = SensorKeys.illuminators


class AzimuthCoverKeys(SensorKeys):
    """A sensor that looks or listens in some directions, clockwise from one to another."""

    azimuth_min_deg: Azimuth = -180.0
    """Where cover begins, from true north."""
    azimuth_max_deg: Azimuth = 180.0
    """Where it ends, clockwise of azimuth_min_deg."""

    def _refusals(self) -> Iterator[str]:
        if not 0 < self.azimuth_max_deg - self.azimuth_min_deg <= 360:
            yield "azimuth_max_deg: must be above azimuth_min_deg, by at most 360"

    @property
    def azimuth_cover(self) -> AzimuthCover:
        """The directions for a model."""
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

    def _refusals(self) -> Iterator[str]:
        if not self.range_min_m < self.range_max_m:
            yield "range_min_m: must be less than range_max_m"
        if not self.elevation_min_deg < self.elevation_max_deg:
            yield "elevation_min_deg: must be less than elevation_max_deg"


TrackNumber = Annotated[int, Field(ge=1, le=MAX_TRACKS)]


class TracksKeys(SceneTable):
    """Which tracks a sensor reports in formats of tracks, and how they begin and end."""

    kind: Literal["smoothed-truth", "plain"] = "smoothed-truth"
    """The truth with a filter's errors, or a plain tracker of the sensor's plots, with misses,
    swaps and false tracks."""
    confirm_hits: Annotated[int, Field(ge=1, le=50)] = 3
    """Detections among the last `confirm_window` looks (of a plain tracker: plots from the first
    on) with which a track begins."""
    confirm_window: Annotated[int, Field(ge=1, le=50)] = 5
    """Looks among which they are counted."""
    drop_misses: Annotated[int, Field(ge=1, le=1000)] = 5
    """Looks in a row without a detection after which it ends."""
    smoothing_scans: Annotated[float, Field(ge=0.1, le=1000)] = 3.0
    """Memory of the filter of smoothed truth: scans until a plot weighs 1/e."""
    acceleration_m_s2: Annotated[float, Field(gt=0, le=1000)] = 3.0
    """That a plain tracker expects of drones along each axis at most, anew every scan."""
    initial_speed_m_s: Annotated[float, Field(gt=0, le=1000)] = 15.0
    """Standard deviation along each axis of the velocity with which its tracks begin."""
    gate_probability: Annotated[float, Field(ge=0.5, le=0.999999)] = 0.999
    """That the right plot lies within the gate of its tracks."""
    numbers: Annotated[tuple[TrackNumber, TrackNumber], Field(strict=False)] = (1, MAX_TRACKS)
    """First and last number of its tracks; without it, all, or an even share where several sensors
    report tracks other than ASTERIX."""

    def _refusals(self) -> Iterator[str]:
        if self.confirm_hits > self.confirm_window:
            yield "confirm_hits: must not exceed confirm_window"
        if self.numbers[0] > self.numbers[1]:
            yield "numbers: the first must not exceed the last"


class TrackingSensorKeys(SensorKeys):
    """A sensor that may report tracks."""

    tracks: TracksKeys = TracksKeys()
    """For asterix-062 and the other formats of tracks."""


def long_integration(integration_s: float, scan: AnyScan) -> Iterator[str]:
    """Warnings of an integration that is longer than a scan."""
    if integration_s > scan.period_s:
        yield (
            f"integration_s is {integration_s:g}, but a scan lasts "
            f"{scan.period_s:g} s: integrate less, or scan slower"
        )
