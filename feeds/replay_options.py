"""The options of `plotfeed replay`; what they mean is worked out in replay_asked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

NOT_NEGATIVE = click.FloatRange(min=0)


def replay_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """All of them."""
    for option in reversed([*_where(), *_when(), *_what(), *_links()]):
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


def _links() -> list[Any]:
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
