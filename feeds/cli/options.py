"""Options that several commands share, and what becomes of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from collections.abc import Callable

    from plotfeed.feeds.telemetry.flights.flight import FlightOptions

# What a command needs is imported inside it, so that --help does not wait for NumPy.


def session_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options that `run` and `demo` share."""
    for option in reversed(
        [
            click.option(
                "--broker",
                metavar="URL",
                help="mqtt://HOST:PORT, or 'none'; without it the scene's, else an embedded one.",
            ),
            click.option(
                "--duration", type=click.FloatRange(min=0, min_open=True), metavar="SECONDS"
            ),
            click.option(
                "--speed",
                default="1",
                metavar="FACTOR",
                help="Times real time, or 'max' for as fast as possible.",
            ),
            click.option(
                "--write",
                type=click.Path(dir_okay=False, path_type=Path),
                metavar="FILE",
                help="Also write the ASTERIX data blocks to a raw file.",
            ),
            click.option(
                "--record",
                type=click.Path(dir_okay=False, path_type=Path),
                metavar="FILE",
                help="Record all that comes in and goes out, and the ledger, as MCAP.",
            ),
            click.option("--force", is_flag=True, help="Replace the file of --record."),
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
        ]
    ):
        command = option(command)
    return command


def access_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """How to get into a broker; user and password come from the environment or a file."""
    existing = click.Path(exists=True, dir_okay=False, path_type=Path)
    for option in reversed(
        [
            click.option("--ca-file", type=existing, help="Who vouches for a mqtts:// broker."),
            click.option("--client-certificate", type=existing, help="For a broker that asks."),
            click.option("--client-key", type=existing),
            click.option("--credentials", type=existing, help="TOML: username, password."),
            click.option("--mqtt-version", type=click.Choice(["5", "3.1.1", "any"]), default="any"),
        ]
    ):
        command = option(command)
    return command


def take_access(options: dict[str, Any]) -> dict[str, Any]:
    """What `access_options` gave, taken out of a command's options: for BrokerAddress.parse."""
    from plotfeed.feeds.transport.mqtt.address import VERSIONS, BrokerAccess

    access = BrokerAccess(
        ca_file=options.pop("ca_file"),
        certificate_file=options.pop("client_certificate"),
        key_file=options.pop("client_key"),
    ).with_credentials(options.pop("credentials"))
    return {"access": access, "versions": VERSIONS[options.pop("mqtt_version")]}


def flight_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options that say what a flight file does not."""
    for option in reversed(
        [
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
        ]
    ):
        command = option(command)
    return command


def how_to_read_flight(columns: tuple[str, ...], **others: Any) -> FlightOptions:
    """What `flight_options` gave, for the readers; raises `click.BadParameter`."""
    from plotfeed.feeds.telemetry.flights.flight import FlightOptions
    from plotfeed.models.state import AltitudeReference

    pairs = [column.partition("=") for column in columns]
    if any(not (ours and equals and theirs) for ours, equals, theirs in pairs):
        raise click.BadParameter("expected OURS=THEIRS", param_hint="--column")
    reference = others.pop("altitude_reference")
    return FlightOptions(
        columns={ours: theirs for ours, _, theirs in pairs},
        altitude_reference=reference and AltitudeReference(reference),
        **others,
    )
