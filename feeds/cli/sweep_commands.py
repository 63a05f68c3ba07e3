"""The commands that make many runs of a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from plotfeed.feeds.cli.options import NEW_FILE, POSITIVE, force_option, seed_option

# What a command needs is imported inside it, so that --help does not wait for NumPy.


@click.command()
@click.argument(
    "scenes",
    metavar="SCENE",
    nargs=-1,
    required=True,
    type=click.Path(path_type=Path),
)
@click.option(
    "--vary",
    multiple=True,
    metavar="KEY=VALUES",
    help="Give this key of the scene each of these values, as A,B,C or START:STOP:STEP; may be "
    "repeated for all combinations.",
)
@click.option(
    "--runs",
    type=click.IntRange(1, 1_000_000),
    default=20,
    show_default=True,
    help="Make so many runs of each combination, each with a seed of its own, the same at all.",
)
@seed_option
@click.option(
    "--duration",
    type=POSITIVE,
    metavar="SECONDS",
    help="End each run after so many seconds; else as the scene says, or after 60.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default="sweep",
    show_default=True,
    metavar="DIR-or-FILE",
    help="Keep runs, tables and chart in this folder, or write the table of runs alone to this "
    "file, .parquet or .csv.",
)
@click.option(
    "--chart",
    type=NEW_FILE,
    metavar="FILE",
    help="Draw the chart to this file, .png, .svg or .pdf, instead of sweep.png in the folder.",
)
@click.option(
    "--protect",
    metavar="EAST,NORTH[,UP]",
    help="Count distances of alerts to this place, metres from the site; else to the site.",
)
@click.option(
    "--alert-plots",
    type=click.IntRange(1, 1000),
    default=3,
    show_default=True,
    help="Take so many plots of a drone that have arrived for an alert.",
)
@click.option(
    "--alert-within",
    type=POSITIVE,
    default=10.0,
    show_default=True,
    metavar="SECONDS",
    help="Let the plots of an alert arrive within so many seconds.",
)
@click.option(
    "--processes",
    type=click.IntRange(1, 1024),
    help="Spread runs over so many processes of this machine; else over one for each processor.",
)
@click.option(
    "--ray",
    metavar="HOST:PORT",
    help="Spread runs over the Ray cluster whose head is there.",
)
@force_option("Begin anew, and replace what is there.")
@click.option("--json", "as_json", is_flag=True, help="Print the figures as one JSON object.")
def sweep(scenes: tuple[Path, ...], **options: Any) -> int:
    """Make many seeded runs of SCENE, a TOML file, in simulated time, with keys varied.

    Several scenes are compared. A key goes by its path, such as sensor.radar.pfa or
    drone.intruder.rcs_m2, where sensors go by id or type; link.latency_ms is that of all sensors.
    Tables are Parquet, or CSV where that cannot be written. What is done is kept: the same command
    goes on after an interruption.
    """
    from plotfeed.feeds.lab.studies import SweepSettings, run_sweep

    return run_sweep(scenes, SweepSettings(**options))
