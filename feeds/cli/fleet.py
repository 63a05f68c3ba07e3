"""The command `plotfeed fleet` and its options."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from plotfeed.feeds.cli.options import POSITIVE

# What a command needs is imported inside it, so that --help does not wait for NumPy.


@click.command()
@click.argument("words", nargs=-1, required=True, metavar="SCENE | status SCENE")
@click.option(
    "--workers",
    type=click.IntRange(1, 100_000),
    default=2,
    show_default=True,
    metavar="N",
    help="Share the sensors out to so many processes: one for each core is usual.",
)
@click.option(
    "--ray",
    "ray_address",
    metavar="HOST:PORT",
    help="Join the Ray cluster whose head is there; without it Ray is started on this machine.",
)
@click.option(
    "--broker",
    metavar="URL",
    help="Connect all workers to the broker at mqtt://HOST:PORT or mqtts://HOST:PORT, or to none "
    "by 'none'; without it the scene's broker is used.",
)
@click.option(
    "--duration",
    type=POSITIVE,
    metavar="SECONDS",
    help="End after so many seconds of the scene's time; else as the scene says, or never.",
)
@click.option(
    "--speed",
    type=click.Choice(["1", "max"]),
    default="1",
    show_default=True,
    help="Run in real time, or as fast as possible.",
)
@click.option(
    "--record",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Record what each worker takes in and sends, and its ledger, to MCAP files there.",
)
@click.option(
    "--lease",
    "lease_s",
    type=click.FloatRange(0.2, 600),
    default=2.0,
    show_default=True,
    metavar="SECONDS",
    help="Give the sensors of a worker to another after so many seconds without news of it.",
)
@click.option(
    "--spares",
    type=click.IntRange(0, 1000),
    default=1,
    show_default=True,
    metavar="N",
    help="Have so many more workers ready to take over.",
)
@click.option(
    "--ramp-up",
    "ramp_up_s",
    type=click.FloatRange(min=0),
    default=0.0,
    metavar="SECONDS",
    help="Let the workers begin one after another over so many seconds.",
)
@click.option(
    "--metrics",
    metavar="[HOST:]PORT",
    help="Serve Prometheus metrics of the fleet there: to this machine alone, or where HOST says, "
    "with a token.",
)
@click.option(
    "--page",
    metavar="[HOST:]PORT",
    help="Serve a page there that shows the scene and how its workers do: to this machine alone, "
    "or where HOST says, with a token.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the answer as one JSON object.")
def fleet(words: tuple[str, ...], **options: Any) -> int:
    """Run SCENE, a TOML file, over many processes or hosts, or look after such a fleet.

    The sensors of the scene are shared out to workers, each of which publishes by itself over MQTT:
    together they send the bytes that one process would. Where a worker dies or hangs, another goes
    on with its sensors at the right scan.

    `status SCENE` prints how the fleet does that runs on the scene's prefix.
    """
    from plotfeed.feeds.cli.fleet_command import print_status, run_fleet
    from plotfeed.feeds.scene.scene import load

    match words:
        case ("status", scene):
            return print_status(load(scene), options["broker"], as_json=options["as_json"])
        case (scene,) if scene != "status":
            return run_fleet(load(scene), **options)
    raise click.UsageError("expected SCENE, or status SCENE")
