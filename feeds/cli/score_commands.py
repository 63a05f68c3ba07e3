"""The command on trackers: score."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from plotfeed.feeds.cli.options import options_of
from plotfeed.feeds.lab.lab_settings import ScoreOptions, TrackerSettings

# What a command needs is imported inside it, so that --help does not wait for NumPy.

OF_FILES = ("tracks", "truth", "feed")  # Options of a tracker whose tracks are there already


@click.command()
@click.argument("recording", metavar="RECORDING-or-SCENE", type=click.Path(path_type=Path))
@options_of(ScoreOptions, TrackerSettings)
def score(found: ScoreOptions, trackers: TrackerSettings, recording: Path) -> int:
    """Score a tracker: its tracks beside the drones that the ledger in RECORDING tells of.

    RECORDING is MCAP, made by run --record or by record. Tracks are ASTERIX 062, SAPIENT, our
    protobuf, JSON, CSV or GeoJSON: those of the tracker's topic in RECORDING, or of another file.
    With a limit of the profile broken, a tracker that failed, or with --feed a sensor that does
    not keep what it claims, the exit code is 1.

    With --tracker it runs SCENE, a TOML file, at each level of what is varied, starts the tracker
    beside it, and draws its score against the level. What is in braces in COMMAND is filled in:
    {broker}, {host}, {port}, {prefix}, {topic}. The same command goes on after an interruption.
    """
    from plotfeed.feeds.lab.score import load_profile, score_recording, settings_of

    if not trackers.trackers:
        if trackers.vary:
            raise click.UsageError("--vary needs --tracker")
        return score_recording(recording, found)
    from plotfeed.feeds.lab.studies import score_tracker

    for name in OF_FILES:
        if getattr(found, name):
            raise click.UsageError(f"--{name} contradicts --tracker")
    if len(found.topics) > 1:
        raise click.UsageError("--topic: a tracker of --tracker publishes on one")
    profile = None if found.profile is None else load_profile(found.profile)
    topic = found.topics[0] if found.topics else None
    settings = replace(
        trackers,
        topic=topic,
        force=found.force,
        as_json=found.as_json,
        out=found.out,
        junit=found.junit,
    )
    return score_tracker(recording, settings, settings_of(profile, found.changes), profile)
