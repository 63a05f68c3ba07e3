"""Options of commands, made of the fields of their settings, and those that several share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import Field, dataclass, fields
from datetime import datetime
from functools import wraps
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Literal, Union, get_args, get_origin, get_type_hints

import click

from plotfeed.feeds.console.option_fields import keys_given, option

if TYPE_CHECKING:
    from plotfeed.feeds.scene.output_keys import UdpDestination

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


def udp_destination(text: str) -> UdpDestination:
    """Where datagrams go: ADDRESS:PORT, or with keys of [[udp]], ADDRESS:PORT?ttl=4&interface=eth0.

    Raises `PlotfeedError`.
    """
    from pydantic import ValidationError

    from plotfeed.feeds.scene.output_keys import UdpDestination
    from plotfeed.feeds.scene.problems import problems_of
    from plotfeed.proto.errors import PlotfeedError

    place, mark, keys = text.partition("?")
    given = keys_given("--udp", keys.split("&")) if mark else {}
    tree: dict[str, Any] = {"destination": place} | given
    try:
        return UdpDestination.model_validate(tree)
    except ValidationError as error:
        key, problem = next(iter(problems_of(error, tree)))
        where = f"{key}: " if key in given else ""
        raise PlotfeedError(f"--udp: {where}{problem}") from None
