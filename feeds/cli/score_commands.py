"""The command on trackers: score."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from plotfeed.feeds.cli.options import (
    EXISTING,
    NEW_FILE,
    POSITIVE,
    force_option,
    seed_option,
    together,
)

# What a command needs is imported inside it, so that --help does not wait for NumPy.

OF_FILES = ("tracks", "out", "junit", "feed")
"""Options of a tracker whose tracks are there already."""
tracker_options = together(
    click.option(
        "--tracker",
        "trackers",
        multiple=True,
        metavar="[NAME=]COMMAND",
        help="Start this tracker beside a session of SCENE, in each run anew; may be repeated to "
        "compare several, each by its name.",
    ),
    click.option(
        "--vary",
        multiple=True,
        metavar="KEY=VALUES",
        help="Give this key of SCENE each of these values, as A,B,C or START:STOP:STEP, with "
        "--tracker; may be repeated for all combinations.",
    ),
    click.option(
        "--runs",
        type=click.IntRange(1, 100_000),
        default=10,
        show_default=True,
        help="Make so many runs of each combination, each with a seed of its own, the same at all.",
    ),
    seed_option,
    click.option(
        "--duration",
        type=POSITIVE,
        metavar="SECONDS",
        help="End each run after so many seconds of the session's time; else as the scene says, or "
        "after 60.",
    ),
    click.option(
        "--speed",
        type=click.FloatRange(0.1, 100),
        default=1.0,
        show_default=True,
        help="Run so many times as fast as real time: for trackers that go by times in messages.",
    ),
    click.option(
        "--patience",
        type=POSITIVE,
        default=10.0,
        show_default=True,
        metavar="SECONDS",
        help="Wait so long for the first line that the tracker prints, and begin then.",
    ),
    click.option(
        "--folder",
        type=click.Path(file_okay=False, path_type=Path),
        default="score",
        show_default=True,
        metavar="DIR",
        help="Keep runs, table (Parquet or CSV) and curve of --tracker in this folder.",
    ),
    click.option(
        "--processes",
        type=click.IntRange(1, 1024),
        default=1,
        show_default=True,
        help="Make so many runs of --tracker at once.",
    ),
    click.option(
        "--ray",
        metavar="HOST:PORT",
        help="Spread runs of --tracker over the Ray cluster whose head is there.",
    ),
)

TRACKER_NAMES = (
    "trackers", "vary", "runs", "seed", "duration", "speed", "patience", "folder", "processes",
    "ray",
)  # fmt: skip


@click.command()
@click.argument("recording", metavar="RECORDING-or-SCENE", type=click.Path(path_type=Path))
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
@tracker_options
@force_option("Replace the files of --out and --junit, and begin anew in --folder.")
@click.option("--json", "as_json", is_flag=True, help="Print everything as one JSON object.")
def score(recording: Path, **options: Any) -> int:
    """Score a tracker: its tracks beside the drones that the ledger in RECORDING tells of.

    RECORDING is MCAP, made by run --record or by record. Tracks are ASTERIX 062, SAPIENT, our
    protobuf, JSON, CSV or GeoJSON: those of the tracker's topic in RECORDING, or of another file.
    With a limit of the profile broken, a tracker that failed, or with --feed a sensor that does
    not keep what it claims, the exit code is 1.

    With --tracker it runs SCENE, a TOML file, at each level of what is varied, starts the tracker
    beside it, and draws its score against the level. What is in braces in COMMAND is filled in:
    {broker}, {host}, {port}, {prefix}, {topic}. The same command goes on after an interruption.
    """
    from plotfeed.feeds.lab.score import ScoreOptions, load_profile, score_recording, settings_of

    of_tracker = {name: options.pop(name) for name in TRACKER_NAMES}
    found = ScoreOptions(**options)
    if not of_tracker["trackers"]:
        if of_tracker["vary"]:
            raise click.UsageError("--vary needs --tracker")
        return score_recording(recording, found)
    from plotfeed.feeds.lab.studies import TrackerSettings, score_tracker

    for name in OF_FILES:
        if options[name]:
            raise click.UsageError(f"--{name} contradicts --tracker")
    if len(found.topics) > 1:
        raise click.UsageError("--topic: a tracker of --tracker publishes on one")
    profile = None if found.profile is None else load_profile(found.profile)
    settings = TrackerSettings(
        topic=found.topics[0] if found.topics else None,
        force=found.force,
        as_json=found.as_json,
        **of_tracker,
    )
    return score_tracker(recording, settings, settings_of(profile, found))
