"""The command on trackers: score."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from plotfeed.feeds.cli.options import EXISTING, NEW_FILE, POSITIVE, force_option

# What a command needs is imported inside it, so that --help does not wait for NumPy.


@click.command()
@click.argument("recording", metavar="RECORDING", type=click.Path(path_type=Path))
@click.option(
    "--tracks",
    type=EXISTING,
    metavar="FILE",
    help="Read tracks from this file, MCAP, pcap, raw ASTERIX (.ast), CSV or GeoJSON; without it "
    "from RECORDING.",
)
@click.option(
    "--topic",
    "topics",
    multiple=True,
    metavar="FILTER",
    help="Take tracks only from topics that fit this filter, as of MQTT with + and #; may be "
    "repeated.",
)
@click.option(
    "--out", type=NEW_FILE, metavar="HTML", help="Write tables and charts to this HTML file too."
)
@click.option(
    "--profile",
    metavar="NAME|FILE",
    help="Judge by the limits of this profile: a TOML file, or one that comes with plotfeed, such "
    "as example-f3411.",
)
@click.option(
    "--junit",
    type=NEW_FILE,
    metavar="XML",
    help="Write the verdict on each limit to this file too, as JUnit's XML.",
)
@click.option(
    "--cutoff-m",
    type=POSITIVE,
    metavar="METRES",
    help="Take a track that is further from a drone for none of it; without it the profile's, or "
    "50.",
)
@click.option(
    "--stale-s",
    type=POSITIVE,
    metavar="SECONDS",
    help="Take a track whose last report is older for gone; without it the profile's, or 5.0.",
)
@click.option(
    "--protect",
    metavar="LATITUDE,LONGITUDE",
    help="Count alert distances from this place; without it from the site of the scene.",
)
@click.option(
    "--feed",
    is_flag=True,
    help="Check the plots of each sensor beside what the sensor claims, in place of a tracker.",
)
@force_option("Replace the files of --out and --junit where they are there already.")
@click.option("--json", "as_json", is_flag=True, help="Print everything as one JSON object.")
def score(recording: Path, **options: Any) -> int:
    """Score a tracker: its tracks beside the drones that the ledger in RECORDING tells of.

    RECORDING is MCAP, made by run --record or by record. Tracks are ASTERIX 062, SAPIENT, our
    protobuf, JSON, CSV or GeoJSON: those of the tracker's topic in RECORDING, or of another file.
    With a limit of the profile broken, a tracker that failed, or with --feed a sensor that does
    not keep what it claims, the exit code is 1.
    """
    from plotfeed.feeds.score.score_command import ScoreOptions, score_recording

    return score_recording(recording, ScoreOptions(**options))
