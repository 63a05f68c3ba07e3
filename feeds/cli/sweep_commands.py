"""The commands that make many runs of a scene."""

from __future__ import annotations

from pathlib import Path

import click

from plotfeed.feeds.cli.options import options_of
from plotfeed.feeds.lab.lab_settings import SweepSettings

# What a command needs is imported inside it, so that --help does not wait for NumPy.


@click.command()
@click.argument("scenes", metavar="SCENE", nargs=-1, required=True, type=click.Path(path_type=Path))
@options_of(SweepSettings)
def sweep(settings: SweepSettings, scenes: tuple[Path, ...]) -> int:
    """Make many seeded runs of SCENE, a TOML file, in simulated time, with keys varied.

    Several scenes are compared. A key goes by its path, such as sensor.radar.pfa or
    drone.intruder.rcs_m2, where sensors go by id or type; link.latency_ms is that of all sensors.
    Tables are Parquet, or CSV where that cannot be written. What is done is kept: the same command
    goes on after an interruption.
    """
    from plotfeed.feeds.lab.studies import run_sweep

    return run_sweep(scenes, settings)
