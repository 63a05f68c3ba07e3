"""The scene file: TOML in, one frozen and validated `Scene` out, or an error that names the key."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    model_validator,
)

from plotfeed.feeds.report import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

MAX_SCENE_OCTETS = 4 << 20


class SceneError(PlotfeedError):
    """A scene that cannot be run. `problems` are (key, what was expected)."""

    def __init__(self, path: Path, problems: list[tuple[str, str]]) -> None:
        lines = [f"{path}: {key}: {text}" if key else f"{path}: {text}" for key, text in problems]
        super().__init__("\n".join(lines))
        self.path = path
        self.problems = problems


class _Part(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


def _name(value: str) -> str:
    if not value.isprintable() or any(c in value for c in "/+# ") or not 1 <= len(value) <= 64:
        raise ValueError("a name is 1 to 64 printable characters, without space, '/', '+' or '#'")
    return value


Name = Annotated[str, AfterValidator(_name)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Latitude = Annotated[float, Field(ge=-90, le=90)]
Longitude = Annotated[float, Field(ge=-180, le=180)]
Height = Annotated[float, Field(ge=-1000, le=100_000)]
Enu = Annotated[tuple[float, float, float], Field(strict=False)]


class Site(_Part):
    """The point from which positions in the scene are counted."""

    latitude_deg: Latitude
    longitude_deg: Longitude
    height_m: Height
    """Above the WGS-84 ellipsoid."""


class General(_Part):
    """What concerns the whole scene."""

    name: Name
    seed: Annotated[int, Field(ge=0, lt=1 << 63)]
    """Of all random draws."""
    site: Site
    start_utc: datetime | None = None
    """Where the scene's time begins; without it, now. With it, every run gives the same bytes."""
    duration_s: Positive | None = None
    """When to end; without it, on request."""

    @model_validator(mode="after")
    def _start_has_a_zone(self) -> Self:
        if self.start_utc is not None and self.start_utc.tzinfo is None:
            raise ValueError("start_utc: write the zone too, such as 2026-01-01T12:00:00Z")
        return self

    @property
    def start_utc_ns(self) -> int | None:
        """The beginning as nanoseconds since 1970, exact to the microsecond."""
        if self.start_utc is None:
            return None
        since = self.start_utc - datetime(1970, 1, 1, tzinfo=UTC)
        return ((since.days * 86400 + since.seconds) * 1_000_000 + since.microseconds) * 1000


class Telemetry(_Part):
    """How telemetry is taken, from MQTT and from files."""

    stale_after_s: Positive = 3.0
    """A drone without news flies on for this long, and is then gone."""
    takeoff_height_m: Height | None = None
    """Above the ellipsoid; added to altitudes above take-off, which are refused without it."""
    geoid_undulation_m: Annotated[float, Field(ge=-150, le=150)] | None = None
    """Of the geoid above the ellipsoid; without it, pyproj's EGM96 grid or a refusal."""
    max_ahead_s: NotNegative = 2.0
    """Telemetry from further in the future is refused."""
    max_age_s: Positive = 60.0
    """Telemetry older than this is refused."""
    max_drones: Annotated[int, Field(ge=1, le=1_000_000)] = 10_000
    rcs_m2: Positive = 0.01
    """Radar cross-section of a drone that states none."""


class Mqtt(_Part):
    """Where messages go."""

    prefix: Annotated[str, Field(pattern=r"^[^+#\s/]+(/[^+#\s/]+)*$", max_length=200)] = "plotfeed"
    """First level or levels of every topic."""
    broker: str | None = None
    """mqtt://HOST:PORT; without it, the embedded one on loopback."""
    port: Annotated[int, Field(ge=1, le=65533)] = 1883
    """Of the embedded broker: MQTT 3.1.1 here, MQTT 5 on the next, WebSocket on the one after."""
    truth: bool = True
    """Whether the ledger is published on {prefix}/truth. A tracker under test must not read it."""


class RotatingScan(_Part):
    """A beam that turns clockwise, through true north at whole multiples of its period."""

    kind: Literal["rotating"]
    period_s: Annotated[float, Field(ge=0.02, le=3600)]
    sectors: Annotated[int, Field(ge=4, le=256)] = 32
    """Reports a turn; a divisor of 256 makes their edges exact in CAT034."""


class StaringScan(_Part):
    """A sensor that looks everywhere at once, at whole multiples of its period."""

    kind: Literal["staring"]
    period_s: Annotated[float, Field(ge=0.02, le=3600)]


Scan = Annotated[RotatingScan | StaringScan, Field(discriminator="kind")]

ReportFormat = Literal["asterix-048", "plots"]


class ActiveRadarSensor(_Part):
    """A quasi-monostatic active radar. The defaults are the paper's typical values."""

    id: Name
    type: Literal["active_radar"]
    report: Annotated[tuple[ReportFormat, ...], Field(strict=False, min_length=1)] = (
        "asterix-048",
        "plots",
    )
    """asterix-048 brings the service messages of category 034 along for a rotating scan."""
    scan: Scan
    position_enu_m: Enu = (0.0, 0.0, 0.0)
    """Of the antenna: east, north and up of the site."""
    sac: Annotated[int, Field(ge=0, le=255)] = 0
    sic: Annotated[int, Field(ge=0, le=255)] = 1
    power_w: Positive
    """Average."""
    frequency_hz: Annotated[float, Field(ge=1e6, le=1e12)]
    gain_tx_dbi: float
    gain_rx_dbi: float | None = None
    """Without it, 41253 times the efficiency over the product of the beamwidths in degrees."""
    antenna_efficiency: Annotated[float, Field(gt=0, le=1)] = 1.0
    integration_s: Positive
    """Coherent."""
    loss_db: NotNegative = 4.0
    """Of the system; the CFAR loss is in the detector already."""
    noise_figure_db: NotNegative = 5.0
    pfa: Annotated[float, Field(ge=1e-15, le=0.1)] = 1e-6
    """Probability of a false alarm in one resolution cell."""
    n_reference: Annotated[int, Field(ge=1, le=1_000_000)] = 16
    """Reference cells of the CA-CFAR."""
    range_resolution_m: Positive
    range_min_m: NotNegative = 0.0
    """The blind range."""
    range_max_m: Annotated[float, Field(gt=0, le=470_000)]
    """Instrumented."""
    azimuth_beamwidth_deg: Annotated[float, Field(gt=0, le=180)]
    elevation_beamwidth_deg: Annotated[float, Field(gt=0, le=180)]
    receive_beams: Annotated[int, Field(ge=1)] = 1
    """Formed side by side in azimuth: they lengthen the time on target of a rotating radar."""
    azimuth_min_deg: Annotated[float, Field(ge=-360, le=360)] = -180.0
    azimuth_max_deg: Annotated[float, Field(ge=-360, le=360)] = 180.0
    """Cover is clockwise from azimuth_min_deg to azimuth_max_deg, from true north."""
    elevation_min_deg: Annotated[float, Field(ge=-90, le=90)]
    elevation_max_deg: Annotated[float, Field(ge=-90, le=90)]
    doppler_cells: Annotated[int, Field(ge=1)] = 1
    range_floor_m: NotNegative = 0.0
    azimuth_floor_deg: NotNegative = 0.0
    elevation_floor_deg: NotNegative = 0.0
    """Errors that remain however strong the echo; added in quadrature."""
    measures_elevation: bool = True
    """False for a two-dimensional radar, whose plots have neither elevation nor height."""

    @model_validator(mode="after")
    def _covers_something(self) -> Self:
        if not self.range_min_m < self.range_max_m:
            raise ValueError("range_min_m: must be less than range_max_m")
        if not 0 < self.azimuth_max_deg - self.azimuth_min_deg <= 360:
            raise ValueError("azimuth_max_deg: must be above azimuth_min_deg, by at most 360")
        if not self.elevation_min_deg < self.elevation_max_deg:
            raise ValueError("elevation_min_deg: must be less than elevation_max_deg")
        return self


class Waypoint(_Part):
    """A place on a path: from the site in metres, or by latitude and longitude."""

    east_m: float | None = None
    north_m: float | None = None
    above_site_m: float | None = None
    """Difference in height above the ellipsoid."""
    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None
    height_m: Height | None = None
    """Above the ellipsoid."""
    speed_m_s: Positive | None = None
    """On the way here; without it, the drone's."""

    @model_validator(mode="after")
    def _one_way_or_the_other(self) -> Self:
        local = (self.east_m, self.north_m, self.above_site_m)
        geodetic = (self.latitude_deg, self.longitude_deg, self.height_m)
        given = [None not in way for way in (local, geodetic)]
        void = [way == (None, None, None) for way in (local, geodetic)]
        if not ((given[0] and void[1]) or (given[1] and void[0])):
            raise ValueError(
                "a waypoint has east_m, north_m and above_site_m, "
                "or latitude_deg, longitude_deg and height_m"
            )
        return self


class FlightFile(_Part):
    """A recorded flight, flown from the session's start on."""

    file: str
    """DJI SRT, CSV, ArduPilot DataFlash, MAVLink tlog or GPX; relative to the scene."""
    columns: dict[str, str] = {}
    """Of a CSV: the file's name for each of ours, such as latitude_deg = "lat"."""
    altitude_reference: Annotated[AltitudeReference, Field(strict=False)] | None = None
    """Where the file does not say it: ellipsoid, mean_sea_level or above_takeoff."""
    gps_order: Literal["lat-lon", "lon-lat"] | None = None
    """Of an SRT that does not show it."""
    utc_offset_h: Annotated[float, Field(ge=-14, le=14)] = 0.0
    """Of the file's local time."""
    takeoff_height_m: Height | None = None
    geoid_undulation_m: Annotated[float, Field(ge=-150, le=150)] | None = None
    """For this flight alone, in place of those of [telemetry]."""


class Drone(_Part):
    """A drone that the scene itself flies: along waypoints, or as recorded in a file."""

    id: Name
    rcs_m2: Positive | None = None
    start_s: NotNegative = 0.0
    """After the session's start."""
    path: Annotated[tuple[Waypoint, ...], Field(strict=False)] = ()
    speed_m_s: Positive | None = None
    repeat: bool = False
    """Back from the last waypoint to the first, and again; otherwise it is gone at the last."""
    flight: FlightFile | None = None

    @model_validator(mode="after")
    def _flies(self) -> Self:
        if bool(self.path) == bool(self.flight):
            raise ValueError("path: a drone has either a path or a flight")
        if self.path and len(self.path) < 2:
            raise ValueError("path: at least two waypoints are needed")
        if self.path and self.speed_m_s is None and any(w.speed_m_s is None for w in self.path[1:]):
            raise ValueError("speed_m_s: needed, unless every waypoint after the first has one")
        if self.flight and (self.speed_m_s or self.repeat):
            raise ValueError("flight: speed_m_s and repeat belong to a path")
        return self


Sensor = ActiveRadarSensor


class Scene(_Part):
    """Everything that a session models. What is not named here costs nothing."""

    scene: General
    telemetry: Telemetry = Telemetry()
    mqtt: Mqtt = Mqtt()
    sensor: Annotated[tuple[Sensor, ...], Field(strict=False, min_length=1)]
    drone: Annotated[tuple[Drone, ...], Field(strict=False)] = ()

    _folder: Path = PrivateAttr(default=Path())

    @model_validator(mode="after")
    def _names_are_unique(self) -> Self:
        for kind, names in (
            ("sensor", [s.id for s in self.sensor]),
            ("drone", [d.id for d in self.drone]),
        ):
            twice = {n for n in names if names.count(n) > 1}
            if twice:
                raise ValueError(f"{kind}: the id {min(twice)!r} is used twice")
        if {"telemetry", "truth", "errors"} & {s.id for s in self.sensor}:
            raise ValueError(
                "sensor: the ids telemetry, truth and errors are topics of the session"
            )
        return self

    @property
    def folder(self) -> Path:
        """Where the scene's own files are."""
        return self._folder


def load(path: str | Path) -> Scene:
    """The scene in a TOML file; raises `SceneError` with every problem that was found in it."""
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(path, [("", error.strerror or "cannot be read")]) from None
    if len(data) > MAX_SCENE_OCTETS:
        raise SceneError(path, [("", f"larger than {MAX_SCENE_OCTETS} octets: not a scene")])
    try:
        tree = tomllib.loads(data.decode())
    except UnicodeDecodeError as error:
        raise SceneError(path, [("", f"not UTF-8 at octet {error.start}")]) from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise SceneError(path, [("", f"not TOML: {error}")]) from None
    return from_tree(tree, path)


def example(name: str) -> Scene:
    """One of the scenes that come with plotfeed."""
    with as_file(files("plotfeed.feeds.scenes") / f"{name}.toml") as path:
        return load(path)


def from_tree(tree: dict[str, Any], path: Path) -> Scene:
    """The same from what TOML gave; `path` is for messages and for finding flights beside it."""
    try:
        scene = Scene.model_validate(tree)
    except ValidationError as error:
        raise SceneError(path, list(_problems(error, tree))) from None
    scene._folder = path.parent
    return scene


def _problems(error: ValidationError, tree: dict[str, Any]) -> Iterator[tuple[str, str]]:
    for found in error.errors():
        key, text, value = _key(found["loc"], tree), found["msg"], found["input"]
        kind = found["type"]
        if kind == "extra_forbidden":
            yield key, f"no such key{_suggestion(found['loc'])}"
        elif kind == "missing":
            yield key, "missing"
        elif kind == "value_error":
            inner, _, rest = text.removeprefix("Value error, ").partition(": ")
            named = rest and inner.isidentifier()
            yield (f"{key}.{inner}" if key else inner) if named else key, rest if named else inner
        else:
            shown = repr(value) if isinstance(value, str | int | float | bool) else "this"
            yield key, f"{text[0].lower()}{text[1:]}, not {shown}"


def _key(location: tuple[int | str, ...], tree: dict[str, Any]) -> str:
    """sensor[0].scan.period_s; the names of variants that pydantic puts in between are left out."""
    key, here = "", tree
    for i, step in enumerate(location):
        if isinstance(step, int):
            key += f"[{step}]"
            here = here[step] if isinstance(here, list) and step < len(here) else {}
            continue
        is_variant = i and isinstance(here, dict) and step in (here.get("type"), here.get("kind"))
        if is_variant and step not in here:
            continue
        key += f".{step}" if key else str(step)
        here = here.get(step, {}) if isinstance(here, dict) else {}
    return key


def _suggestion(location: tuple[int | str, ...]) -> str:
    known = {name for model in _models() for name in model.model_fields}
    close = difflib.get_close_matches(str(location[-1]), known, 1)
    return f"; did you mean {close[0]}?" if close else ""


def _models() -> Iterator[type[BaseModel]]:
    waiting = list(_Part.__subclasses__())
    while waiting:
        model = waiting.pop()
        yield model
        waiting.extend(model.__subclasses__())
