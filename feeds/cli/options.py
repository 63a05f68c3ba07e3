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
DEFAULT_BROKER = "mqtt://127.0.0.1:1883"
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
    help="Let a file without dates (FINAL, raw ASTERIX) begin on this day; else on 1970-01-01.",
)
seed_option = click.option(
    "--seed",
    type=click.IntRange(0, (1 << 63) - 1),
    default=1,
    show_default=True,
    help="Take this seed for the first run, and the next whole numbers for the others.",
)
topic_option = click.option(
    "--topic",
    "topics",
    multiple=True,
    metavar="FILTER",
    help="Take only topics that fit this filter, as of MQTT with + and #; may be repeated.",
)


def stage_option(help_text: str) -> Decorator:
    """The option that chooses stages of messages in a recording."""
    stages = ["telemetry", "before", "after", "received"]
    return click.option(
        "--stage", "stages", multiple=True, type=click.Choice(stages), help=help_text
    )


wait_option = click.option(
    "--wait", is_flag=True, help="Wait for a broker that is not up yet, with a line, until it is."
)
part_options = together(
    click.option(
        "--start",
        metavar="TIME",
        help="Begin so many seconds after the beginning, or at a time as 2026-01-01T12:00:00Z.",
    ),
    click.option(
        "--end",
        metavar="TIME",
        help="End before that time, given as for --start; what was recorded at it is left out.",
    ),
)
session_options = together(
    click.option(
        "--broker",
        metavar="URL",
        help="Connect to the broker at mqtt://HOST:PORT or mqtts://HOST:PORT, or to none by "
        "'none'; without it the scene's broker is used, else an embedded one.",
    ),
    wait_option,
    click.option(
        "--udp",
        multiple=True,
        metavar="ADDRESS:PORT",
        help="Send all ASTERIX to this address by UDP, unicast or multicast, instead of where the "
        "scene says; may be repeated.",
    ),
    click.option(
        "--middleware",
        metavar="HOST:PORT",
        help="Connect to this SAPIENT middleware by TCP instead of the scene's.",
    ),
    click.option(
        "--tak",
        multiple=True,
        metavar="URL",
        help="Send events of Cursor on Target to the TAK server at tcp://HOST:PORT instead of the "
        "scene's; may be repeated.",
    ),
    click.option(
        "--http",
        multiple=True,
        metavar="FORMAT=URL",
        help="Post tracks to this address instead of the scene's, such as "
        "air-traffic=http://HOST:PORT/PATH, with the bearer token in "
        "PLOTFEED_HTTP_TOKEN_COMMAND_LINE, if any; may be repeated.",
    ),
    click.option(
        "--duration",
        type=POSITIVE,
        metavar="SECONDS",
        help="End after so many seconds of the session's time; else as the scene says, or never.",
    ),
    click.option(
        "--speed",
        default="1",
        metavar="FACTOR",
        show_default=True,
        help="Run so many times as fast as real time (0.001 to 10000), slower where this machine "
        "would else miss scans; or with 'max' as fast as possible.",
    ),
    click.option(
        "--write",
        type=NEW_FILE,
        metavar="FILE",
        help="Write the ASTERIX data blocks that are sent to this raw file (.ast) too.",
    ),
    click.option(
        "--record",
        type=NEW_FILE,
        metavar="FILE",
        help="Record all that comes in and goes out, and the ledger, to this MCAP file.",
    ),
    force_option("Replace the files of --record and --write where they are there already."),
    click.option(
        "--metrics",
        metavar="[HOST:]PORT",
        help="Serve Prometheus metrics there: to this machine alone, or where HOST says, with a "
        "token.",
    ),
    click.option(
        "--page",
        metavar="[HOST:]PORT",
        help="Serve the live page there: to this machine alone, or where HOST says, with a token; "
        "below /audience/ for an audience, without truth and controls.",
    ),
    click.option(
        "--json",
        "as_json",
        is_flag=True,
        help="Print nothing but the totals at the end, as one JSON object.",
    ),
)
access_options = together(
    click.option(
        "--ca-file",
        type=EXISTING,
        help="Trust the certificate of an mqtts:// broker by the authorities in this PEM file; "
        "without it by those that the system trusts.",
    ),
    click.option(
        "--client-certificate",
        type=EXISTING,
        help="Show this certificate, a PEM file, to a broker that asks for one.",
    ),
    click.option(
        "--client-key",
        type=EXISTING,
        help="Take the private key of --client-certificate from this PEM file.",
    ),
    click.option(
        "--credentials",
        type=EXISTING,
        help="Take username and password from this TOML file; PLOTFEED_MQTT_USERNAME and "
        "PLOTFEED_MQTT_PASSWORD stand before it.",
    ),
    click.option(
        "--mqtt-version",
        type=click.Choice(["5", "3.1.1", "any"]),
        default="any",
        show_default=True,
        help="Speak this version of MQTT; any tries 5 first, and then 3.1.1.",
    ),
    wait_option,
)
"""How to get into a broker; user and password come from the environment or a file."""
flight_options = together(
    click.option(
        "--column",
        "columns",
        multiple=True,
        metavar="OURS=THEIRS",
        help="Read one of our columns under a CSV's own name for it, such as latitude_deg=lat; may "
        "be repeated.",
    ),
    click.option(
        "--altitude-reference",
        type=click.Choice(["ellipsoid", "mean_sea_level", "above_takeoff"]),
        help="Take altitudes as above this, where the file does not say above what they are.",
    ),
    click.option(
        "--gps-order",
        type=click.Choice(["lat-lon", "lon-lat"]),
        help="Take the GPS(A,B) values of a DJI subtitle file so, where it shows no order.",
    ),
    click.option(
        "--utc-offset-h",
        type=click.FloatRange(-14, 14),
        default=0.0,
        show_default=True,
        help="Take times without a zone as so many hours ahead of UTC.",
    ),
    click.option(
        "--height-m",
        type=click.FloatRange(-1000, 100_000),
        metavar="METRES",
        help="Fly at this height above take-off where the file has no heights.",
    ),
    click.option(
        "--max-speed-m-s",
        type=click.FloatRange(min=0, min_open=True, max=1000),
        default=150.0,
        show_default=True,
        help="Skip positions that cannot have been flown to at this speed.",
    ),
)
source_options = together(
    click.option(
        "--duration",
        type=POSITIVE,
        metavar="SECONDS",
        help="End after listening to a source for so long.",
    ),
    click.option(
        "--altitude",
        type=click.Choice(["mean_sea_level", "above_takeoff"]),
        default="mean_sea_level",
        show_default=True,
        help="Take this altitude of a MAVLink source: above the sea, or above home.",
    ),
    click.option(
        "--view",
        metavar="LAT,LON,LAT,LON",
        help="Send these two corners to a service of network Remote ID.",
    ),
    click.option(
        "--qnh-hpa",
        type=click.FloatRange(850, 1100),
        metavar="HPA",
        help="Take this pressure at sea level for pressure altitudes of ADS-B.",
    ),
    click.option(
        "--interface",
        metavar="NAME",
        help="Join a multicast group of a source at this network interface, such as eth0.",
    ),
    click.option(
        "--ask-hz",
        type=click.FloatRange(0.1, 50),
        metavar="HERTZ",
        help="Send requests to a MAVLink source for so many positions a second.",
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
    versions = VERSIONS[options.pop("mqtt_version")]
    return {"access": access, "versions": versions, "waits": options.pop("wait")}


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
        height_m=options.pop("height_m"),
    )


def take_source_options(options: dict[str, Any]) -> dict[str, Any]:
    """What `source_options` gave, likewise."""
    names = ("duration", "altitude", "ask_hz", "view", "qnh_hpa", "interface")
    return {name: options.pop(name) for name in names}


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
