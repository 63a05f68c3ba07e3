"""The scene file: TOML in, one frozen and validated `Scene` out, or an error that names the key."""

from __future__ import annotations

import tomllib
from codecs import BOM_UTF8
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from importlib.resources import as_file, files
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    Field,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.scene.changes import ChangeError, changed
from plotfeed.feeds.scene.claim_keys import CLAIMED, COOPERATIVE, CooperativeKeys
from plotfeed.feeds.scene.drones import Drone, Fleet, Swarm, Targets
from plotfeed.feeds.scene.fields import Azimuth, Enu, Name, Positive, SceneTable, Site, used_twice
from plotfeed.feeds.scene.output_keys import DestinationTables, Mqtt, PageKeys, SapientKeys, WaysOut
from plotfeed.feeds.scene.problems import located, problems_of
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.sea_level import SeaLevel, with_ellipsoidal_heights
from plotfeed.feeds.scene.sensors import Sensor, SensorKeys
from plotfeed.feeds.scene.sensors.mount_keys import refused_cues
from plotfeed.feeds.scene.sensors.scan_keys import Event
from plotfeed.feeds.scene.story_keys import Story, usual_stories
from plotfeed.feeds.scene.telemetry_keys import Telemetry
from plotfeed.feeds.scene.world_keys import JammerSpell, WeatherSpell, WorldKeys
from plotfeed.models.tracks import MAX_TRACKS
from plotfeed.proto.errors import PlotfeedError

LAST_CODE = 255
# That a sensor must have for its tracks; where there are too many sensors, none has its own.
FEWEST_NUMBERS = 1000


def numbered(sensors: Iterable[SensorKeys]) -> list[SensorKeys]:
    """The sensors, those that state no `sic` with the first that is free of their `sac`.

    Free are 1 to 255, but for those that any sensor states; a sensor that states no `sac` either
    has 0, or the next that has room. One that finds none keeps the usual.
    """
    found = list(sensors)
    taken = {(s.sac, s.sic) for s in found if "sic" in s.model_fields_set}
    for n, sensor in enumerate(found):
        if "sic" in sensor.model_fields_set:
            continue
        sacs = [sensor.sac] if "sac" in sensor.model_fields_set else range(LAST_CODE + 1)
        codes = ((area, sic) for area in sacs for sic in range(1, LAST_CODE + 1))
        if (source := next((each for each in codes if each not in taken), None)) is not None:
            taken.add(source)
            sac, sic = source
            found[n] = sensor.model_copy(update={"sic": sic, **({"sac": sac} if sac else {})})
    return found


def shared_sources(sensors: Sequence[SensorKeys]) -> Iterator[str]:
    """Refusals of sensors that report in ASTERIX and have another's SAC and SIC.

    All go to the same brokers and files, where nothing else in a record tells them apart.
    """
    known: dict[tuple[int, int], str] = {}
    for n, sensor in enumerate(sensors):
        if not any(REPORT_FORMATS[name].categories for name in sensor.report):
            continue
        other = known.setdefault((sensor.sac, sensor.sic), sensor.id)
        if other != sensor.id:
            yield (
                f"sensor[{n}].sic: {other!r} and {sensor.id!r} both have sac {sensor.sac} and sic "
                f"{sensor.sic}, and both report in ASTERIX, which tells them apart by that alone; "
                "leave out sic, and they are numbered"
            )


def with_track_numbers(sensors: Sequence[SensorKeys]) -> list[SensorKeys]:
    """The sensors, those that report tracks with an even share of their numbers each.

    A sensor that states its own keeps them, one that is alone has all, and so has each where all
    report in ASTERIX, whose records say of whom they are.
    """
    found: list[Any] = list(sensors)
    told = [
        [row for row in map(REPORT_FORMATS.__getitem__, s.report) if row.tells_tracks]
        for s in found
    ]
    tracking = [n for n, rows in enumerate(told) if rows]
    share = MAX_TRACKS // max(len(tracking), 1)
    is_asterix = all(row.categories for rows in told for row in rows)
    if is_asterix or len(tracking) < 2 or share < FEWEST_NUMBERS:
        return found
    for place, n in enumerate(tracking):
        tracks = found[n].tracks
        if "numbers" not in tracks.model_fields_set:
            own = tracks.model_copy(update={"numbers": (place * share + 1, (place + 1) * share)})
            found[n] = found[n].model_copy(update={"tracks": own})
    return found


def _as_event(spell: WeatherSpell | JammerSpell) -> Event:
    """What a spell of weather, or a jammer, of all sensors is to each of them."""
    keys = spell.model_dump(exclude_unset=True, exclude={"from_s", "to_s", "id"})
    named = {"jamming": {spell.id: keys}} if isinstance(spell, JammerSpell) else {"weather": keys}
    return Event(from_s=spell.from_s, to_s=spell.to_s, set=named)


MAX_SCENE_OCTETS = 4 << 20
MAX_FALSE_ALARMS = 100_000  # In a scan, on average: each of them is drawn, encoded and sent
# Levels after the prefix that no sensor can have as its id.
TOPICS_OF_SESSION = frozenset(
    {"telemetry", "truth", "errors", "control", "session", "fleet", COOPERATIVE, CLAIMED}
)
OWNERS = ("sensor", "drone", "swarm")  # Lists of a scene whose entries have ids
MAX_PROBLEMS = 20  # Told of a scene that has many


class SceneError(PlotfeedError):
    """A scene that cannot be run. `problems` are (key, what was expected).

    By `text` and `tree`, what TOML was given and gave, each is `located` as well.
    """

    def __init__(
        self, path: Path, problems: list[tuple[str, str]], tree: Any = None, text: str = ""
    ) -> None:
        self.located = list(located(problems, tree, text))
        super().__init__("\n".join(printable(f"{path}: {each}") for each in self.located))
        self.path = path
        self.problems = problems


class General(SceneTable):
    """What concerns the whole scene."""

    name: Name
    seed: Annotated[int, Field(ge=0, lt=1 << 63)]
    """Of all random draws."""
    site: Site
    start_utc: datetime | None = None
    """When the scene's time begins, so that runs are the same to the byte; without it, now."""
    duration_s: Positive | None = None
    """When to end; without it, on request."""

    def _refusals(self) -> Iterator[str]:
        if self.start_utc is None:
            return
        if self.start_utc.tzinfo is None:
            yield "start_utc: write the zone too, such as 2026-01-01T12:00:00Z"
        if not 1970 < self.start_utc.year < 2200:
            yield "start_utc: must be from 1971 to 2199"

    @property
    def start_utc_ns(self) -> int | None:
        """The beginning as nanoseconds since 1970, exact to the microsecond."""
        if self.start_utc is None:
            return None
        since = self.start_utc - datetime(1970, 1, 1, tzinfo=UTC)
        return ((since.days * 86400 + since.seconds) * 1_000_000 + since.microseconds) * 1000


class Asterix(SceneTable):
    """Where decoders of ASTERIX differ."""

    longitude_025: Literal["full-turn", "half-turn"] = "full-turn"
    """LSB of a sensor's longitude in category 025: 360 or 180 degrees over 2^32. libasterix reads
    half-turn, asterix-decoder and jASTERIX full-turn."""


class SystemKeys(SceneTable):
    """A commercial system, whose sensors are named after it."""

    id: Name
    """Its sensors are `id-radar`, `id-rf`, `id-detector`, `id-audio` and `id-camera`."""
    preset: str
    """Which system: `plotfeed sensors` lists them."""
    position_enu_m: Enu = (0.0, 0.0, 0.0)
    """Of sensors that have none of their own: east, north and up of the site."""
    facing_deg: Azimuth = 0.0
    """Where its sensors that look one way look, clockwise from north."""
    without: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Sensors that are not there: radar, rf, detector, audio or camera."""
    every: dict[str, Any] = Field(default={})
    """Keys that all its sensors have, such as link or report."""
    radar: dict[str, Any] = Field(default={})
    """Keys of the radar, in place of its preset's; another `preset` among them."""
    rf: dict[str, Any] = Field(default={})
    """Keys of the RF sensor, likewise."""
    detector: dict[str, Any] = Field(default={})
    """Keys of the RF sensor that finds no direction, likewise."""
    audio: dict[str, Any] = Field(default={})
    """Keys of the microphones, likewise."""
    camera: dict[str, Any] = Field(default={})
    """Keys of the camera, likewise."""


def _or_of_a_preset(schema: dict[str, Any]) -> None:
    """Let the JSON schema pass a sensor whose keys its preset gives."""
    from plotfeed.feeds.scene.presets.preset import names

    of_a_preset = {
        "type": "object",
        "required": ["id", "preset"],
        "properties": {"preset": {"enum": names()}},
    }
    schema["items"] = {"anyOf": [of_a_preset, schema["items"]]}


class Scene(DestinationTables, WorldKeys):
    """Everything that a session models. What is not named here costs nothing."""

    scene: General
    telemetry: Telemetry = Telemetry()
    mqtt: Mqtt = Mqtt()
    asterix: Asterix = Asterix()
    sapient: SapientKeys = SapientKeys()
    sensor: Annotated[
        tuple[Sensor, ...], Field(strict=False, min_length=1, json_schema_extra=_or_of_a_preset)
    ]
    system: Annotated[tuple[SystemKeys, ...], Field(strict=False)] = ()
    """Their sensors are among `sensor` once a scene is loaded."""
    drone: Annotated[tuple[Drone, ...], Field(strict=False)] = ()
    swarm: Annotated[tuple[Swarm, ...], Field(strict=False)] = ()
    target: Targets = ()
    cooperative: CooperativeKeys | None = None
    story: Annotated[tuple[Story, ...], Field(strict=False)] = ()
    """What happens at a word, beside bad-link, outage, drift, jamming and swarm."""
    page: PageKeys = PageKeys()

    _path: Path = PrivateAttr(default=Path())
    _files: Mapping[str, Path] | None = PrivateAttr(default=None)
    _outgoing: WaysOut | None = PrivateAttr(default=None)
    _text: str = PrivateAttr(default="")

    @classmethod
    def _put_right(cls, schema: dict[str, Any]) -> None:
        """Systems may stand for all sensors."""
        schema["required"] = [key for key in schema["required"] if key != "sensor"]
        schema["anyOf"] = [{"required": ["sensor"]}, {"required": ["system"]}]

    @model_validator(mode="before")
    @classmethod
    def _above_the_ellipsoid(cls, tree: Any) -> Any:
        sensors = tree.get("sensor") if isinstance(tree, dict) else None
        return with_ellipsoidal_heights(tree) if isinstance(sensors, list | tuple) else tree

    @field_validator("sensor")
    @classmethod
    def _as_the_scene_has_them(
        cls, sensors: tuple[SensorKeys, ...], info: ValidationInfo
    ) -> tuple[SensorKeys, ...]:
        """The sensors with what follows from the scene: its weather, and numbers of their own."""
        spells = (*info.data.get("weather", ()), *info.data.get("jammer", ()))
        if events := tuple(map(_as_event, spells)):
            sensors = tuple(s.model_copy(update={"event": s.event + events}) for s in sensors)
        return tuple(with_track_numbers(numbered(sensors)))

    def _refusals(self) -> Iterator[str]:
        yield from used_twice("sensor", (sensor.id for sensor in self.sensor))
        for n, sensor in enumerate(self.sensor):
            if sensor.id in TOPICS_OF_SESSION:
                yield f"sensor[{n}].id: the id {sensor.id!r} is a topic of the session"
        yield from shared_sources(self.sensor)
        yield from refused_cues(self.sensor)
        yield from self.fleet.refusals()
        for n, sensor in enumerate(self.sensor):
            yield from _too_many_alarms(sensor, f"sensor[{n}]", self.scene.site)
        yield from self._refused_events()
        yield from self._refused_stories()

    def _refused_events(self) -> Iterator[str]:
        for n, sensor in enumerate(self.sensor):
            for i, event in enumerate(sensor.event):
                key = f"sensor[{n}].event[{i}].set"
                try:
                    other = changed(sensor, event.set)
                except ChangeError as error:
                    yield f"{key}: {error}"
                else:
                    yield from _too_many_alarms(other, key, self.scene.site)
        senders = {COOPERATIVE: (), **{s.id: s.report for s in self.sensor}}
        yield from self.refused_destinations(senders)

    def _refused_stories(self) -> Iterator[str]:
        sensors = {sensor.id: sensor for sensor in self.sensor}
        yield from used_twice("story", (story.id for story in self.story))
        for n, story in enumerate(self.story):
            for key, why in story.problems(sensors, self.fleet.names, self.fleet.cooperative_names):
                yield f"story[{n}].{key}: {why}"
            for name, keys in story.sets.items():
                other = changed(sensors[name], keys)
                yield from _too_many_alarms(other, f"story[{n}].change", self.scene.site)

    @property
    def fleet(self) -> Fleet:
        """All that the scene flies itself, and what of it says where it is."""
        waiting = tuple(swarm for story in self.story for swarm in story.swarm)
        return Fleet(self.drone, self.swarm, self.cooperative, self.scene.seed, waiting)

    @property
    def stories(self) -> dict[str, Story]:
        """What can happen at a word, by its id: the usual, and what the scene tells itself."""
        return {story.id: story for story in (*usual_stories(self.sensor), *self.story)}

    @property
    def folder(self) -> Path:
        """Where the scene's own files are."""
        return self._path.parent

    def file(self, name: str) -> Path:
        """Where a file is that the scene names; raises `PlotfeedError` where it may have none."""
        if self._files is None:
            return self.folder / name
        if name not in self._files:
            raise PlotfeedError(f"the recording names the file {name!r} and does not hold it")
        return self._files[name]

    def sea_level(self, *, stated_m: float | None = None) -> SeaLevel:
        """Mean sea level, unless another is stated; raises `PlotfeedError`."""
        keys = self.telemetry
        if stated_m is not None or keys.geoid_grid is None:
            return SeaLevel(keys.geoid_undulation_m if stated_m is None else stated_m)
        return SeaLevel(grid=self.file(keys.geoid_grid))

    @property
    def is_enclosed(self) -> bool:
        """Whether it is data, of whose files there are only those that it brings along."""
        return self._files is not None

    def encloses(self, name: str) -> bool:
        """Whether it is data that brings a file of that name along."""
        return self._files is not None and name in self._files

    @property
    def outgoing(self) -> WaysOut:
        """DestinationTables by the scene's own keys, unless somebody has named others."""
        if self._outgoing is not None:
            return self._outgoing
        return WaysOut(
            mqtt=self.mqtt,
            middleware=self.sapient.middleware,
            sources=self.telemetry.source,
            **self.destinations(self.file),
        )

    def sent_to(self, outgoing: WaysOut) -> Self:
        """Copy it with other destinations; its text and keys do not change."""
        other = self.model_copy()
        other._outgoing = outgoing
        return other

    def enclosed(self, files: Mapping[str, Path]) -> Self:
        """Copy it as data: of its files it has these, by name, and nothing else outside."""
        other = self.sent_to(WaysOut())
        other._files = dict(files)
        return other

    def refusal(self, problems: list[tuple[str, str]]) -> SceneError:
        """What to raise where it turns out that it cannot be run: keys, and what was expected."""
        owners = {kind: [{"id": each.id} for each in getattr(self, kind)] for kind in OWNERS}
        return SceneError(self._path, problems, owners, self._text)

    @property
    def text(self) -> str:
        """The file as it was written; empty for a scene that was not loaded from one."""
        return self._text


def _too_many_alarms(sensor: Sensor, key: str, site: Site) -> Iterator[str]:
    expected = sensor.model(site).false_alarms_per_scan
    if expected > MAX_FALSE_ALARMS:
        yield f"{key}: {expected:.3g} false alarms a scan; at most {MAX_FALSE_ALARMS} are taken"


def load(path: str | Path) -> Scene:
    """The scene in a TOML file; raises `SceneError` with every problem that was found in it."""
    path = Path(path)
    try:
        with path.open("rb") as file:
            data = file.read(MAX_SCENE_OCTETS + 1)
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else None
        raise SceneError(path, [("", why or f"cannot be read: {error}")]) from None
    if len(data) > MAX_SCENE_OCTETS:
        raise SceneError(path, [("", f"larger than {MAX_SCENE_OCTETS} octets: not a scene")])
    return parsed(data, path)


def parsed(data: bytes, path: Path) -> Scene:
    """The scene in what a file holds; `path` is for messages and for finding files beside it."""
    try:
        text = data.removeprefix(BOM_UTF8).decode()
        tree = tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise SceneError(path, [("", f"not UTF-8 at octet {error.start}")]) from None
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, or an int of 5,000 digits
        raise SceneError(path, [("", f"not TOML: {error}")]) from None
    return from_tree(tree, path, text)


def example(name: str) -> Scene:
    """One of the scenes that come with plotfeed; raises `PlotfeedError` for no name of one."""
    from plotfeed.feeds.scene.examples import summaries

    if name not in summaries():
        raise PlotfeedError(f"no shipped scene {name!r}: expected one of {', '.join(summaries())}")
    with as_file(files("plotfeed.feeds.scene.examples") / f"{name}.toml") as path:
        return load(path)


def from_tree(tree: dict[str, Any], path: Path, text: str = "") -> Scene:
    """The scene in what TOML gave; `path` is for messages and for finding flights beside it.

    `text` is what TOML was given, if it was a file; raises `SceneError`.
    """
    written = tree
    of_systems: list[tuple[str, str]] = []
    problems: list[tuple[str, str]] = []
    whose: dict[str, str] = {}
    sensors = tree.get("sensor")
    of_sensors = sensors if isinstance(sensors, list) else []
    if "system" in tree or any(isinstance(s, dict) and "preset" in s for s in of_sensors):
        from plotfeed.feeds.scene.presets.preset import with_presets
        from plotfeed.feeds.scene.presets.system import with_systems

        tree, of_systems, whose = with_systems(tree)
        tree, problems = with_presets(tree)
    misused = {key.partition(".")[0] for key, _ in problems}
    try:
        scene = Scene.model_validate(tree)
    except ValidationError as error:
        # A sensor without its preset lacks keys that nobody wanted to write.
        others = (p for p in problems_of(error, tree) if p[0].partition(".")[0] not in misused)
        problems += islice(others, MAX_PROBLEMS)
    parts = [(key.partition("."), what) for key, what in problems]
    # A key of a system's sensor is told as the scene has it: of the system.
    renamed = [(whose.get(of, of) + dot + rest, what) for (of, dot, rest), what in parts]
    if problems := of_systems + renamed:
        raise SceneError(path, problems, written, text)
    scene._path, scene._text = path, text
    return scene
