"""`plotfeed replay` as its options ask for it."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click
from pydantic import ValidationError

from plotfeed.feeds.cli.replay_terminal import replay_in_terminal
from plotfeed.feeds.replaying.destinations import Destinations
from plotfeed.feeds.replaying.replay_settings import (
    Choice,
    LinkRule,
    Moment,
    ReplayError,
    ReplaySettings,
    Selection,
    Stamps,
    TopicRule,
)
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.output_keys import Endpoint, UdpDestination
from plotfeed.feeds.scene.problems import problems_of
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto.utc import NS
from plotfeed.replay.pacing import speed_of

MAX_OCTETS = 1 << 20


def link_rule(text: str) -> LinkRule:
    """From FILE, for all topics, or TOPIC=FILE; raises `ReplayError`.

    The file holds the keys of a scene's [sensor.link].
    """
    topic, equals, name = text.rpartition("=")
    if equals and not topic:
        raise ReplayError(f"link: expected FILE or TOPIC=FILE, not {text!r}")
    return LinkRule(topic, link_in(Path(name)))


def link_in(path: Path) -> LinkSettings:
    """The link in a file; raises `ReplayError`."""
    try:
        with path.open("rb") as file:
            tree = tomllib.loads(file.read(MAX_OCTETS).decode())
    except OSError as error:
        raise ReplayError(f"{path}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ReplayError(f"{path}: not TOML: {error}") from None
    return _checked(tree, f"{path}: ")


def simple_link(
    latency_ms: float | None, jitter_ms: float | None, loss: float | None
) -> LinkRule | None:
    """Of all topics, with those figures; None if there are none. Raises `ReplayError`."""
    tree: dict[str, Any] = {"latency_ms": latency_ms, "jitter_ms": jitter_ms}
    if loss is not None:
        tree["loss"] = {"kind": "random", "probability": loss}
    tree = {key: value for key, value in tree.items() if value is not None}
    return LinkRule("", _checked(tree, "link: ")) if tree else None


def _checked(tree: dict[str, Any], where: str) -> LinkSettings:
    try:
        return LinkSettings.model_validate(tree)
    except ValidationError as error:
        problems = problems_of(error, tree)
        lines = [f"{where}{key}: {text}" if key else f"{where}{text}" for key, text in problems]
        raise ReplayError("\n".join(lines)) from None


RECORDED = "recorded"


def replay_as_asked(
    path: Path,
    default_broker: str,
    access: dict[str, Any],
    *,
    broker: str | None,
    udp: Sequence[str],
    ttl: int,
    interface: str | None,
    topics: Sequence[str],
    speed: float,
    fastest: bool,
    start: str | None,
    end: str | None,
    laps: int,
    date: datetime | None,
    stage: Choice,
    truth: bool,
    stamps: str | None,
    seed: int,
    as_json: bool,
    **links: Any,
) -> int:
    """Replay a file; the exit code. Raises `PlotfeedError`.

    `access` holds the keyword arguments of `BrokerAddress.parse`; `laps` of 0 are without end.
    """
    url = broker or (None if udp else default_broker)
    destinations = Destinations(
        brokers=() if url is None else (BrokerAddress.parse(url, **access),),
        udp=tuple(_destination(to, ttl, interface) for to in udp if to != RECORDED),
        recorded_udp=RECORDED in udp,
        ttl=ttl,
        interface=interface,
    )
    settings = ReplaySettings(
        selection=Selection(stage=stage, truth=truth),
        speed=speed_of(1.0 if fastest else speed),
        fastest=fastest,
        start=None if start is None else Moment.parse(start),
        end=None if end is None else Moment.parse(end),
        laps=laps or None,
        stamps=Stamps.parse(stamps or ("now" if stage == "telemetry" else "keep")),
        topics=tuple(TopicRule.parse(text) for text in topics),
        links=_links(**links),
        seed=seed,
    )
    date_utc_ns = 0 if date is None else int(date.replace(tzinfo=UTC).timestamp()) * NS
    return replay_in_terminal(
        path, destinations, settings, date_utc_ns=date_utc_ns, as_json=as_json
    )


def _links(
    *,
    links: Sequence[str],
    latency_ms: float | None,
    jitter_ms: float | None,
    loss: float | None,
) -> tuple[LinkRule, ...]:
    """Those of topics before those of all, whatever their order on the command line."""
    rules = [link_rule(text) for text in links]
    simple = simple_link(latency_ms, jitter_ms, loss)
    if simple is not None:
        rules.append(simple)
    return tuple(sorted(rules, key=lambda rule: -len(rule.topic)))


def _destination(to: str, ttl: int, interface: str | None) -> UdpDestination:
    tree = {"destination": to, "ttl": ttl}
    try:
        if interface is not None and Endpoint.parse(to).address.is_multicast:
            tree["interface"] = interface
        return UdpDestination.model_validate(tree)
    except ValidationError as error:
        _, text = next(iter(problems_of(error, tree)))
        raise ReplayError(f"--udp: {text}") from None
    except ValueError as error:
        raise ReplayError(f"--udp: {error}") from None


NOT_NEGATIVE = click.FloatRange(min=0)


def replay_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """All of them."""
    for option in reversed([*_where(), *_when(), *_what(), *_link_options()]):
        command = option(command)
    return command


def _where() -> list[Any]:
    return [
        click.option(
            "--broker",
            metavar="URL",
            help="mqtt://HOST:PORT; loopback if there is no --udp either.",
        ),
        click.option(
            "--udp",
            multiple=True,
            metavar="ADDRESS:PORT",
            help="Send datagrams there; 'recorded' is where each of them once went.",
        ),
        click.option("--ttl", type=click.IntRange(0, 255), default=1, help="Of multicast."),
        click.option("--interface", metavar="NAME", help="By which multicast leaves."),
        click.option(
            "--topic",
            "topics",
            multiple=True,
            metavar="OLD=NEW",
            help="Topics that begin with the levels of OLD begin with NEW instead.",
        ),
    ]


def _when() -> list[Any]:
    return [
        click.option(
            "--speed", type=click.FloatRange(0.001, 10_000), default=1.0, show_default=True
        ),
        click.option("--fastest", is_flag=True, help="As fast as possible, without deadlines."),
        click.option("--start", metavar="TIME", help="Seconds from the beginning, or UTC."),
        click.option(
            "--end", metavar="TIME", help="As --start; what was recorded then is left out."
        ),
        click.option(
            "--loop",
            "laps",
            is_flag=False,
            flag_value=0,
            default=1,
            type=click.IntRange(min=0),
            metavar="[N]",
            help="So many times; without N, until it is stopped.",
        ),
        click.option(
            "--date",
            type=click.DateTime(["%Y-%m-%d"]),
            help="The first day of a file that has none: FINAL, raw.",
        ),
    ]


def _what() -> list[Any]:
    return [
        click.option(
            "--stage",
            type=click.Choice(["after", "before", "telemetry"]),
            default="after",
            show_default=True,
            help="What left or was heard; what sensors handed to their links; what came in.",
        ),
        click.option("--truth", is_flag=True, help="The ledger too."),
        click.option(
            "--stamps",
            metavar="HOW",
            help="Times inside messages: keep, now, or so many seconds later. Without it keep, "
            "but now for telemetry.",
        ),
        click.option("--json", "as_json", is_flag=True, help="End with the counts as JSON."),
    ]


def _link_options() -> list[Any]:
    return [
        click.option(
            "--link",
            "links",
            multiple=True,
            metavar="[TOPIC=]FILE",
            help="TOML with the keys of a scene's [sensor.link]; each sensor has one of its own.",
        ),
        click.option(
            "--latency-ms", type=NOT_NEGATIVE, help="Of a link for all that has no --link."
        ),
        click.option("--jitter-ms", type=NOT_NEGATIVE),
        click.option("--loss", type=click.FloatRange(0, 1), metavar="PROBABILITY"),
        click.option(
            "--seed",
            type=click.IntRange(0, (1 << 63) - 1),
            default=0,
            show_default=True,
            help="Of the links.",
        ),
    ]
