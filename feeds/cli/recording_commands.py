"""The commands on recordings: show, replay, convert, merge, record, report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from plotfeed.feeds.cli.options import (
    DEFAULT_BROKER,
    NEW_FILE,
    AccessOptions,
    force_option,
    options_of,
)
from plotfeed.feeds.cli.replay_options import ReplayOptions
from plotfeed.feeds.recording.recording_settings import (
    ConvertSettings,
    RecordSettings,
    ShowSettings,
)

# What a command needs is imported inside it, so that --help does not wait for NumPy.


@click.command()
@click.argument("source", metavar="FILE-or-URL")
@options_of(ShowSettings, AccessOptions)
def show(settings: ShowSettings, access: AccessOptions, source: str) -> int:
    """Print what a recording holds, in figures, or decoded messages, one a line.

    The messages are those of a file, with --list; of a broker, mqtt://HOST:PORT/TOPIC-FILTER or
    mqtts:// for TLS, where the filter is plotfeed/# if it is left out; or of a network,
    udp://ADDRESS:PORT as for record. A file is MCAP, pcap, pcapng, FINAL, raw ASTERIX or JSON
    lines.
    """
    from plotfeed.feeds.recording.show import show_source

    return show_source(source, access.parsed(), settings)


@click.command()
@click.argument("recording", metavar="FILE", type=click.Path(path_type=Path))
@options_of(ReplayOptions, AccessOptions)
def replay(options: ReplayOptions, access: AccessOptions, recording: Path) -> int:
    """Replay the recording FILE to a broker or over UDP, with its own timing.

    FILE is MCAP, pcap, pcapng, FINAL, raw ASTERIX or JSON lines. In a terminal keys steer it.
    """
    from plotfeed.feeds.cli.replay import replay_as_asked

    return replay_as_asked(recording, DEFAULT_BROKER, access.parsed(), options)


@click.command()
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@options_of(ConvertSettings)
def convert(settings: ConvertSettings, source: Path, target: Path) -> int:
    """Convert the recording IN to OUT.

    What is whole of a damaged file is converted. MCAP, pcap, FINAL, raw ASTERIX and JSON lines go
    both ways; pcapng is read, CSV (of plots) and Parquet (a table) are written.
    """
    from plotfeed.feeds.recording.convert import convert_recording

    return convert_recording(source, target, settings)


@click.command()
@click.argument("source", metavar="URL")
@click.argument("file", type=NEW_FILE)
@options_of(RecordSettings, AccessOptions)
def record(settings: RecordSettings, access: AccessOptions, source: str, file: Path) -> int:
    """Record what a broker or a network has to FILE, MCAP.

    URL is mqtt://HOST:PORT/TOPIC-FILTER (mqtts:// for TLS, plotfeed/# without a filter), or
    udp://ADDRESS:PORT: an address of this machine, 0.0.0.0 for all of them, or a multicast group,
    which is joined at the network interface that ?interface=NAME behind it names.
    """
    from plotfeed.feeds.recording.record import record_source

    return record_source(source, file, access.parsed(), settings)


@click.command()
@click.argument("recording", metavar="FILE", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print everything as one JSON object.")
@click.option(
    "--chart", type=NEW_FILE, metavar="IMAGE", help="Draw it to this file too, .png, .svg or .pdf."
)
@force_option("Replace the file of --chart where it is there already.")
def report(recording: Path, **options: Any) -> int:
    """Hold what a session delivered against what its scene asked, by the ledger in FILE.

    FILE is MCAP, made by run --record or by record: delays, losses, detection, errors of plots.
    """
    from plotfeed.feeds.lab.report import print_report

    return print_report(recording, **options)


@click.command()
@click.argument("sources", metavar="IN", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@force_option("Replace OUT where it is there already.")
@click.option("--json", "as_json", is_flag=True, help="Print the totals as one JSON object.")
def merge(sources: tuple[Path, ...], target: Path, **options: Any) -> int:
    """Merge recordings of one session, IN, to OUT, all MCAP, in the order of time.

    They are those of workers that each served some sensors of one scene. What two of them hold is
    in OUT once.
    """
    from plotfeed.feeds.recording.convert import merge_recordings

    return merge_recordings(sources, target, **options)
