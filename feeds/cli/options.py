"""Options of commands, made of the fields of their settings; those of brokers, run and inject."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import Field, dataclass, fields
from datetime import datetime
from functools import wraps
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import click

from plotfeed.feeds.console.option_fields import (
    MAX_SEED,
    end_option,
    keys_given,
    option,
    start_option,
)
from plotfeed.proto.errors import PlotfeedError

if TYPE_CHECKING:
    from plotfeed.feeds.scene.fields import SceneTable
    from plotfeed.feeds.scene.output_keys import UdpDestination

    M = TypeVar("M", bound=SceneTable)


# What a command needs is imported inside it, so that --help does not wait for NumPy.

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]
DEFAULT_BROKER = "mqtt://127.0.0.1:1883"
NEW_FILE = click.Path(dir_okay=False, path_type=Path)
POSITIVE = click.FloatRange(min=0, min_open=True)
# What may stand at a path, by the word that settings have for it.
PATHS: dict[str, dict[str, bool]] = {
    "any": {},
    "existing": {"exists": True, "dir_okay": False},
    "file": {"dir_okay": False},
    "folder": {"file_okay": False},
}


def options_of(*settings: type[Any]) -> Decorator:
    """A decorator that gives a command the options that the fields of settings are, in their order.

    It is called with one of each class, and with its other options and arguments by their names.
    """

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def called(**given: Any) -> Any:
            made = [
                kind(**{each.name: given.pop(each.name) for each in _told(kind)})
                for kind in settings
            ]
            return command(*made, **given)

        for kind in reversed(settings):
            types = get_type_hints(kind)
            for each in reversed(_told(kind)):
                _option(each, types[each.name])(called)
        return called

    return decorate


def _told(settings: type[Any]) -> list[Field[Any]]:
    """The fields of settings that are options."""
    return [each for each in fields(settings) if "help" in each.metadata]


def _option(each: Field[Any], kind: Any) -> Decorator:
    """The option that a field of a type is."""
    how: dict[str, Any] = {"metavar": each.metadata.get("metavar"), "help": each.metadata["help"]}
    if get_origin(kind) in (Union, UnionType):
        kind = next(part for part in get_args(kind) if part is not NoneType)
    if get_origin(kind) is tuple:
        kind, how["multiple"] = get_args(kind)[0], True
    elif kind is not bool and each.default is not None:
        how |= {"default": each.default, "show_default": each.metadata.get("tells_default", True)}
    if "bare" in each.metadata:
        how |= {"is_flag": False, "flag_value": each.metadata["bare"]}
    if kind is bool:
        how["is_flag"] = True
    else:
        how["type"] = _type(kind, **each.metadata)
    usual = "--json" if each.name == "as_json" else f"--{each.name.replace('_', '-')}"
    return click.option(each.metadata.get("name", usual), each.name, **how)


def _type(
    kind: Any, *, low: Any = None, over: Any = None, high: Any = None, path: str = "any", **_: Any
) -> Any:
    """What values of an option of that type may be."""
    if get_origin(kind) is Literal:
        return click.Choice(list(get_args(kind)))
    if kind is Path:
        return click.Path(**PATHS[path], path_type=Path)
    if kind is datetime:
        return click.DateTime(["%Y-%m-%d"])
    if (low, over, high) == (None, None, None):
        return click.types.convert_type(kind)
    numbers = click.IntRange if kind is int else click.FloatRange
    return numbers(low if over is None else over, high, min_open=over is not None)


def force_option(help_text: str) -> Decorator:
    """The option without which no command replaces a file."""
    return click.option("--force", is_flag=True, help=help_text)


@dataclass(frozen=True, slots=True, kw_only=True)
class AccessOptions:
    """How to get into a broker; user and password come from the environment or a file."""

    credentials: Path | None = option(
        None,
        "Take username, password, ca_file, client_certificate_file, client_key_file and version "
        "(of MQTT: 5, 3.1.1 or any) from this TOML file; PLOTFEED_MQTT_USERNAME and "
        "PLOTFEED_MQTT_PASSWORD stand before it.",
        path="existing",
        metavar="FILE",
    )
    wait: bool = option(False, "Wait for a broker that is not up yet, with a line, until it is.")

    def parsed(self) -> dict[str, Any]:
        """Keyword arguments of `BrokerAddress.parse`; raises `PlotfeedError` for a file amiss."""
        from plotfeed.feeds.transport.mqtt.address import BrokerAccess

        access = BrokerAccess().with_credentials(self.credentials)
        return {"access": access, "waits": self.wait}


def table_of(kind: type[M], tree: dict[str, Any], where: Callable[[str], str], hint: str = "") -> M:
    """The table of a scene with those keys, as options give them.

    Raises `PlotfeedError`, in which `where` says which option gave a key.
    """
    from pydantic import ValidationError

    from plotfeed.feeds.scene.problems import problems_of

    try:
        return kind.model_validate(tree)
    except ValidationError as error:
        key, text = next(iter(problems_of(error, tree)))
        raise PlotfeedError(f"{where(key)}: {text}{hint}") from None


def udp_destination(text: str) -> UdpDestination:
    """Where datagrams go: ADDRESS:PORT, or with keys of [[udp]], ADDRESS:PORT?ttl=4&interface=eth0.

    Raises `PlotfeedError`.
    """
    from plotfeed.feeds.scene.output_keys import UdpDestination

    place, mark, keys = text.partition("?")
    given = keys_given("--udp", keys.split("&")) if mark else {}
    tree = {"destination": place} | given
    return table_of(UdpDestination, tree, lambda key: f"--udp: {key}" if key in given else "--udp")


@dataclass(frozen=True, slots=True, kw_only=True)
class InjectSettings:
    """What the options of `inject` ask for."""

    drone: str | None = option(
        None,
        "Name the drone so in its topic; without it as the file is called, or as the source says.",
        metavar="ID",
    )
    broker: str = option(
        "mqtt://127.0.0.1:1883",
        "Publish at the broker mqtt://HOST:PORT or mqtts://HOST:PORT.",
        metavar="URL",
    )
    prefix: str = option(
        "plotfeed", "Begin the topic with these levels, as the session's scene has them."
    )
    speed: float = option(1.0, "Fly so many times as fast as it was flown.", low=0.01, high=1000)
    shift: bool = option(
        False,
        "Let the flight begin now; without it reports keep the times of the file.",
        name="--now",
    )
    encoding: Literal["protobuf", "json"] = option("protobuf", "Encode reports so.")
    raw: bool = option(False, "Send positions as recorded, without smoothing.")
    changes: tuple[str, ...] = option(
        (),
        "Read or listen by this key, as a scene has it: of [drone.flight] and max_speed_m_s for a "
        "file, of [[telemetry.source]] for a source; rcs_m2, takeoff_height_m and "
        "geoid_undulation_m for both. May be repeated.",
        metavar="KEY=VALUE",
        name="--set",
    )
    duration: float | None = option(
        None, "End after listening to a source for so long.", over=0, metavar="SECONDS"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSettings:
    """What the options of `run` and `demo` ask for, beside the scene."""

    broker: str | None = option(
        None,
        "Connect to the broker at mqtt://HOST:PORT or mqtts://HOST:PORT, or to none by 'none'; "
        "without it the scene's broker is used, else an embedded one.",
        metavar="URL",
    )
    wait: bool = option(False, "Wait for a broker that is not up yet, with a line, until it is.")
    udp: tuple[str, ...] = option(
        (),
        "Send all ASTERIX to this address by UDP, unicast or multicast, instead of where the "
        "scene says, with keys of its [[udp]] such as ?ttl=4&interface=eth0; may be repeated.",
        metavar="ADDRESS:PORT[?KEYS]",
    )
    middleware: str | None = option(
        None,
        "Connect to this SAPIENT middleware by TCP instead of the scene's.",
        metavar="HOST:PORT",
    )
    tak: tuple[str, ...] = option(
        (),
        "Send events of Cursor on Target to the TAK server at tcp://HOST:PORT instead of the "
        "scene's; may be repeated.",
        metavar="URL",
    )
    http: tuple[str, ...] = option(
        (),
        "Post tracks to this address instead of the scene's, such as "
        "air-traffic=http://HOST:PORT/PATH, with the bearer token in "
        "PLOTFEED_HTTP_TOKEN_COMMAND_LINE, if any; may be repeated.",
        metavar="FORMAT=URL",
    )
    duration: float | None = option(
        None,
        "End after so many seconds of the session's time; else as the scene says, or never.",
        over=0,
        metavar="SECONDS",
    )
    speed: str = option(
        "1",
        "Run so many times as fast as real time (0.001 to 10000), slower where this machine "
        "would else miss scans; or with 'max' as fast as possible.",
        metavar="FACTOR",
    )
    write: Path | None = option(
        None,
        "Write the ASTERIX data blocks that are sent to this raw file (.ast) too.",
        path="file",
        metavar="FILE",
    )
    record: Path | None = option(
        None,
        "Record all that comes in and goes out, and the ledger, to this MCAP file.",
        path="file",
        metavar="FILE",
    )
    force: bool = option(
        False, "Replace the files of --record and --write where they are there already."
    )
    metrics: str | None = option(
        None,
        "Serve Prometheus metrics there: to this machine alone, or where HOST says, with a token.",
        metavar="[HOST:]PORT",
    )
    page: str | None = option(
        None,
        "Serve the live page there: to this machine alone, or where HOST says, with a token; "
        "below /audience/ for an audience, without truth and controls. With 'none' there is none.",
        metavar="[HOST:]PORT",
    )
    as_json: bool = option(False, "Print nothing but the totals at the end, as one JSON object.")
    telemetry: Path | None = None  # A recorded session whose inputs are taken in again
    shows_page: bool = False  # Whether the page is served even if nobody said where
    part: str | None = None  # K/N, where other processes run the other parts of the scene
    start: str | None = None  # When all parts begin
    # Whether time can be paused and hurried although nobody asked for another than the world's.
    can_be_held: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """What the options of `replay` ask for."""

    broker: str | None = option(
        None,
        "Send to the broker at mqtt://HOST:PORT or mqtts://HOST:PORT; without it and without "
        "--udp to mqtt://127.0.0.1:1883.",
        metavar="URL",
    )
    udp: tuple[str, ...] = option(
        (),
        "Send ASTERIX there by UDP, or by 'recorded' each datagram to where it once went, with "
        "keys of a scene's [[udp]] such as ?ttl=4&interface=eth0 behind either; may be repeated.",
        metavar="ADDRESS:PORT[?KEYS]",
    )
    topics: tuple[str, ...] = option(
        (),
        "Let topics that begin with the levels of OLD begin with NEW; may be repeated.",
        metavar="OLD=NEW",
        name="--topic",
    )
    speed: str = option(
        "1",
        "Replay so many times as fast as it was recorded (0.001 to 10000), or with 'max' as fast "
        "as possible, without deadlines.",
        metavar="FACTOR",
    )
    start: str | None = start_option()
    end: str | None = end_option()
    laps: int = option(
        1,
        "Replay N times over; without N, until it is stopped.",
        low=0,
        metavar="[N]",
        name="--loop",
        tells_default=False,
        bare=0,
    )
    stage: Literal["after", "before", "telemetry"] = option(
        "after",
        "Send what left or was heard (after), what sensors handed to their links (before), or "
        "what came in (telemetry).",
    )
    truth: bool = option(False, "Send the ledger too, which says whose plot is whose.")
    stamps: str | None = option(
        None,
        "Write times inside messages anew: keep leaves them alone, now makes them as much later "
        "as the message is, and +SECONDS so much later; without it keep, but now for telemetry.",
        metavar="HOW",
    )
    as_json: bool = option(False, "Print nothing but the counts at the end, as one JSON object.")
    links: tuple[str, ...] = option(
        (),
        "Put the messages of each sensor on a link by the keys of a scene's [sensor.link] in "
        "this TOML file; with TOPIC= only those whose topics begin so. May be repeated.",
        metavar="[TOPIC=]FILE",
        name="--link",
    )
    seed: int = option(
        0,
        "Draw delays and losses of links by this seed; with the same seed they are the same.",
        low=0,
        high=MAX_SEED,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSettings:
    """What the options of `fleet` ask for, beside the scene."""

    workers: int = option(
        2,
        "Share the sensors out to so many parts: one for each core is usual.",
        low=1,
        high=10_000,
        metavar="N",
    )
    spares: int = option(
        0,
        "Have so many more processes of each part stand by, which work out the same and take over "
        "at once.",
        low=0,
        high=9,
        metavar="N",
    )
    start: str | None = option(
        None,
        "Begin the scene at this time, as 2026-01-01T12:00:00Z; without it in five seconds.",
        metavar="TIME",
    )
    broker: str | None = option(
        None,
        "Connect all parts to the broker at mqtt://HOST:PORT or mqtts://HOST:PORT; without it the "
        "scene's broker is used.",
        metavar="URL",
    )
    duration: float | None = option(
        None,
        "End after so many seconds of the scene's time; else as the scene says, or never.",
        over=0,
        metavar="SECONDS",
    )
    record: Path | None = option(
        None,
        "Record what each process takes in and sends, and its ledger, to MCAP files there.",
        path="folder",
        metavar="DIR",
    )
    kubernetes: bool = option(
        False, "Start nothing, but print manifests with which Kubernetes runs the parts."
    )
    ray: str | None = option(
        None,
        "Have the Ray cluster whose head is there run the parts, and return.",
        metavar="HOST:PORT",
    )
    page: str | None = option(
        None,
        "Serve a page there that shows the scene and how its parts do: to this machine alone, "
        "or where HOST says, with a token.",
        metavar="[HOST:]PORT",
    )
    as_json: bool = option(False, "Print the answer as one JSON object.")
