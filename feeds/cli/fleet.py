"""The command `plotfeed fleet` and its options."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from plotfeed.feeds.cli.options import POSITIVE

# What a command needs is imported inside it, so that --help does not wait for NumPy.


@click.command()
@click.argument("words", nargs=-1, required=True, metavar="SCENE | status SCENE | stop SCENE")
@click.option(
    "--workers",
    type=click.IntRange(1, 10_000),
    default=2,
    show_default=True,
    metavar="N",
    help="Share the sensors out to so many parts: one for each core is usual.",
)
@click.option(
    "--spares",
    type=click.IntRange(0, 9),
    default=0,
    show_default=True,
    metavar="N",
    help="Have so many more processes of each part stand by, which work out the same and take over "
    "at once.",
)
@click.option(
    "--start",
    metavar="TIME",
    help="Begin the scene at this time, as 2026-01-01T12:00:00Z; without it in five seconds.",
)
@click.option(
    "--broker",
    metavar="URL",
    help="Connect all parts to the broker at mqtt://HOST:PORT or mqtts://HOST:PORT; without it the "
    "scene's broker is used.",
)
@click.option(
    "--duration",
    type=POSITIVE,
    metavar="SECONDS",
    help="End after so many seconds of the scene's time; else as the scene says, or never.",
)
@click.option(
    "--record",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Record what each process takes in and sends, and its ledger, to MCAP files there.",
)
@click.option(
    "--kubernetes",
    is_flag=True,
    help="Start nothing, but print manifests with which Kubernetes runs the parts.",
)
@click.option(
    "--ray",
    "ray_address",
    metavar="HOST:PORT",
    help="Have the Ray cluster whose head is there run the parts, and return.",
)
@click.option(
    "--page",
    metavar="[HOST:]PORT",
    help="Serve a page there that shows the scene and how its parts do: to this machine alone, "
    "or where HOST says, with a token.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the answer as one JSON object.")
def fleet(words: tuple[str, ...], **options: Any) -> int:
    """Run SCENE, a TOML file, by many processes of this machine, or where an engine places them.

    Each runs a part of the scene, as `plotfeed run --part K/N` does, and publishes by itself over
    MQTT: together they send the bytes that one process would. A process that dies is started again
    and goes on at the right scan; none depends on another.

    With status SCENE it prints how the parts do that run on the scene's prefix, or shows it on a
    page; with stop SCENE it ends those that Ray runs.
    """
    from plotfeed.feeds.cli.fleet_command import print_status, run_fleet, stop_fleet
    from plotfeed.feeds.scene.scene import load

    match words:
        case ("status", scene):
            return print_status(
                load(scene), options["broker"], options["page"], as_json=options["as_json"]
            )
        case ("stop", scene):
            return stop_fleet(load(scene), options["ray_address"])
        case (scene,) if scene not in ("status", "stop"):
            return run_fleet(Path(scene), **options)
    raise click.UsageError("expected SCENE, status SCENE, or stop SCENE")
