"""Options that several commands share, or of which one has many, and what becomes of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from plotfeed.feeds.scene.output_keys import UdpDestination
    from plotfeed.feeds.telemetry.flights.flight import FlightOptions

# What a command needs is imported inside it, so that --help does not wait for NumPy.

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]
EXISTING = click.Path(exists=True, dir_okay=False, path_type=Path)
NEW_FILE = click.Path(dir_okay=False, path_type=Path)
POSITIVE = click.FloatRange(min=0, min_open=True)
NOT_NEGATIVE = click.FloatRange(min=0)


def together(*options: Decorator) -> Decorator:
    """A decorator that gives a command all these options, told in this order."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def force_option(help_text: str) -> Decorator:
    """The option without which no command replaces a file."""
    return click.option("--force", is_flag=True, help=help_text)


date_option = click.option(
    "--date",
    type=click.DateTime(["%Y-%m-%d"]),
    help="The first day of a file that has none: FINAL, raw.",
)
topic_option = click.option(
    "--topic", "topics", multiple=True, metavar="FILTER", help="Only these: + and #."
)


def stage_option(help_text: str) -> Decorator:
    """The option that chooses stages of messages in a recording."""
    stages = ["telemetry", "before", "after", "received"]
    return click.option(
        "--stage", "stages", multiple=True, type=click.Choice(stages), help=help_text
    )


part_options = together(
    click.option("--start", metavar="TIME", help="Seconds from the beginning, or UTC."),
    click.option("--end", metavar="TIME", help="As --start; what was recorded then is left out."),
)
session_options = together(
    click.option(
        "--broker",
        metavar="URL",
        help="mqtt://HOST:PORT, or 'none'; without it the scene's, else an embedded one.",
    ),
    click.option(
        "--udp",
        multiple=True,
        metavar="ADDRESS:PORT",
        help="Send all ASTERIX there, instead of where the scene says; may be repeated.",
    ),
    click.option(
        "--middleware",
        metavar="HOST:PORT",
        help="Connect to that SAPIENT middleware instead of the scene's.",
    ),
    click.option("--duration", type=POSITIVE, metavar="SECONDS"),
    click.option(
        "--speed",
        default="1",
        metavar="FACTOR",
        help="Times real time, or 'max' for as fast as possible.",
    ),
    click.option(
        "--write",
        type=NEW_FILE,
        metavar="FILE",
        help="Also write the ASTERIX data blocks to a raw file.",
    ),
    click.option(
        "--record",
        type=NEW_FILE,
        metavar="FILE",
        help="Record all that comes in and goes out, and the ledger, as MCAP.",
    ),
    force_option("Replace the files of --record and --write."),
    click.option(
        "--metrics",
        type=click.IntRange(1, 65535),
        metavar="PORT",
        help="Serve Prometheus metrics on that port of loopback.",
    ),
    click.option(
        "--page",
        metavar="[HOST:]PORT",
        help="Serve the live page there; HOST is this machine alone unless it is given.",
    ),
    click.option("--json", "as_json", is_flag=True, help="End with the totals as JSON."),
)
access_options = together(
    click.option("--ca-file", type=EXISTING, help="Who vouches for a mqtts:// broker."),
    click.option("--client-certificate", type=EXISTING, help="For a broker that asks."),
    click.option("--client-key", type=EXISTING),
    click.option("--credentials", type=EXISTING, help="TOML: username, password."),
    click.option("--mqtt-version", type=click.Choice(["5", "3.1.1", "any"]), default="any"),
)
"""How to get into a broker; user and password come from the environment or a file."""
flight_options = together(
    click.option(
        "--column",
        "columns",
        multiple=True,
        metavar="OURS=THEIRS",
        help="A CSV's own name for one of our columns, such as latitude_deg=lat.",
    ),
    click.option(
        "--altitude-reference",
        type=click.Choice(["ellipsoid", "mean_sea_level", "above_takeoff"]),
        help="What altitudes are above, where the file does not say.",
    ),
    click.option(
        "--gps-order",
        type=click.Choice(["lat-lon", "lon-lat"]),
        help="Order of an SRT's GPS(...) values, where the file does not show it.",
    ),
    click.option(
        "--utc-offset-h",
        type=click.FloatRange(-14, 14),
        default=0.0,
        help="Of the file's local time.",
    ),
    click.option(
        "--max-speed-m-s",
        type=click.FloatRange(min=0, min_open=True, max=1000),
        default=150.0,
        show_default=True,
        help="What cannot have been flown to at this speed is skipped.",
    ),
)
replay_options = together(
    click.option(
        "--broker", metavar="URL", help="mqtt://HOST:PORT; loopback if there is no --udp either."
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
    click.option("--speed", type=click.FloatRange(0.001, 10_000), default=1.0, show_default=True),
    click.option("--fastest", is_flag=True, help="As fast as possible, without deadlines."),
    part_options,
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
    date_option,
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
    click.option(
        "--link",
        "links",
        multiple=True,
        metavar="[TOPIC=]FILE",
        help="TOML with the keys of a scene's [sensor.link]; each sensor has one of its own.",
    ),
    click.option("--latency-ms", type=NOT_NEGATIVE, help="Of a link for all that has no --link."),
    click.option("--jitter-ms", type=NOT_NEGATIVE),
    click.option("--loss", type=click.FloatRange(0, 1), metavar="PROBABILITY"),
    click.option(
        "--seed",
        type=click.IntRange(0, (1 << 63) - 1),
        default=0,
        show_default=True,
        help="Of the links.",
    ),
)


def take_access(options: dict[str, Any]) -> dict[str, Any]:
    """What `access_options` gave, taken out of a command's options: for BrokerAddress.parse."""
    from plotfeed.feeds.transport.mqtt.address import VERSIONS, BrokerAccess

    access = BrokerAccess(
        ca_file=options.pop("ca_file"),
        certificate_file=options.pop("client_certificate"),
        key_file=options.pop("client_key"),
    ).with_credentials(options.pop("credentials"))
    return {"access": access, "versions": VERSIONS[options.pop("mqtt_version")]}


def take_flight_options(options: dict[str, Any]) -> FlightOptions:
    """What `flight_options` gave, likewise, for the readers; raises `click.BadParameter`."""
    from plotfeed.feeds.telemetry.flights.flight import FlightOptions
    from plotfeed.models.state import AltitudeReference

    pairs = [column.partition("=") for column in options.pop("columns")]
    if any(not (ours and equals and theirs) for ours, equals, theirs in pairs):
        raise click.BadParameter("expected OURS=THEIRS", param_hint="--column")
    reference = options.pop("altitude_reference")
    return FlightOptions(
        columns={ours: theirs for ours, _, theirs in pairs},
        altitude_reference=reference and AltitudeReference(reference),
        gps_order=options.pop("gps_order"),
        utc_offset_h=options.pop("utc_offset_h"),
        max_speed_m_s=options.pop("max_speed_m_s"),
    )


def udp_destination(to: str, ttl: int = 1, interface: str | None = None) -> UdpDestination:
    """Where a command sends datagrams; raises `PlotfeedError`. Multicast leaves by `interface`."""
    from pydantic import ValidationError

    from plotfeed.feeds.scene.output_keys import Endpoint, UdpDestination
    from plotfeed.feeds.scene.problems import problems_of
    from plotfeed.proto.errors import PlotfeedError

    tree: dict[str, Any] = {"destination": to, "ttl": ttl}
    try:
        if interface is not None and Endpoint.parse(to).address.is_multicast:
            tree["interface"] = interface
        return UdpDestination.model_validate(tree)
    except ValidationError as error:
        _, text = next(iter(problems_of(error, tree)))
        raise PlotfeedError(f"--udp: {text}") from None
    except ValueError as error:
        raise PlotfeedError(f"--udp: {error}") from None
