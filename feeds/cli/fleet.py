"""The command `plotfeed fleet` and its options."""

from __future__ import annotations

from pathlib import Path

import click

from plotfeed.feeds.cli.fleet_settings import FleetSettings
from plotfeed.feeds.cli.options import options_of

# What a command needs is imported inside it, so that --help does not wait for NumPy.


@click.command()
@click.argument("words", nargs=-1, required=True, metavar="SCENE | status SCENE | stop SCENE")
@options_of(FleetSettings)
def fleet(settings: FleetSettings, *, words: tuple[str, ...]) -> int:
    """Run SCENE, a TOML file, by many processes of this machine, or where an engine places them.

    Each runs a part of the scene, as `plotfeed run --part K/N` does, and publishes by itself over
    MQTT: together they send the bytes that one process would. A process that dies is started again
    and goes on at the right scan; none depends on another.

    With status SCENE it prints how the parts do that run on the scene's prefix, or shows it on a
    page; with stop SCENE it ends those that Ray runs.
    """
    from plotfeed.feeds.cli.fleet_command import print_status, run_fleet, stop_fleet

    match words:
        case ("status", scene):
            return print_status(Path(scene), settings)
        case ("stop", scene):
            return stop_fleet(Path(scene), settings.ray)
        case (scene,) if scene not in ("status", "stop"):
            return run_fleet(Path(scene), settings)
    raise click.UsageError("expected SCENE, status SCENE, or stop SCENE")
