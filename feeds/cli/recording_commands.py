"""The commands on recordings: show, replay, convert, merge, record, report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from plotfeed.feeds.cli.options import (
    DEFAULT_BROKER,
    NEW_FILE,
    NOT_NEGATIVE,
    POSITIVE,
    access_options,
    date_option,
    force_option,
    part_options,
    stage_option,
    take_access,
    together,
    topic_option,
)
from plotfeed.replay.recorded import TableName

# What a command needs is imported inside it, so that --help does not wait for NumPy.

FORMATS = ["mcap", "pcap", "pcapng", "final", "raw", "jsonl", "csv", "parquet"]
replay_options = together(
    click.option(
        "--broker",
        metavar="URL",
        help="Send to the broker at mqtt://HOST:PORT or mqtts://HOST:PORT; without it and without "
        f"--udp to {DEFAULT_BROKER}.",
    ),
    click.option(
        "--udp",
        multiple=True,
        metavar="ADDRESS:PORT",
        help="Send ASTERIX there by UDP, or by 'recorded' each datagram to where it once went; "
        "may be repeated.",
    ),
    click.option(
        "--ttl",
        type=click.IntRange(0, 255),
        default=1,
        show_default=True,
        help="Let multicast pass so many networks less one (its time to live).",
    ),
    click.option(
        "--interface",
        metavar="NAME",
        help="Send multicast by this network interface, such as eth0.",
    ),
    click.option(
        "--topic",
        "topics",
        multiple=True,
        metavar="OLD=NEW",
        help="Let topics that begin with the levels of OLD begin with NEW; may be repeated.",
    ),
    click.option(
        "--speed",
        type=click.FloatRange(0.001, 10_000),
        default=1.0,
        show_default=True,
        help="Replay so many times as fast as it was recorded.",
    ),
    click.option("--fastest", is_flag=True, help="Send as fast as possible, without deadlines."),
    part_options,
    click.option(
        "--loop",
        "laps",
        is_flag=False,
        flag_value=0,
        default=1,
        type=click.IntRange(min=0),
        metavar="[N]",
        help="Replay N times over; without N, until it is stopped.",
    ),
    date_option,
    click.option(
        "--stage",
        type=click.Choice(["after", "before", "telemetry"]),
        default="after",
        show_default=True,
        help="Send what left or was heard (after), what sensors handed to their links (before), or "
        "what came in (telemetry).",
    ),
    click.option(
        "--truth", is_flag=True, help="Send the ledger too, which says whose plot is whose."
    ),
    click.option(
        "--stamps",
        metavar="HOW",
        help="Write times inside messages anew: keep leaves them alone, now makes them as much "
        "later as the message is, and +SECONDS so much later; without it keep, but now for "
        "telemetry.",
    ),
    click.option(
        "--json",
        "as_json",
        is_flag=True,
        help="Print nothing but the counts at the end, as one JSON object.",
    ),
    click.option(
        "--link",
        "links",
        multiple=True,
        metavar="[TOPIC=]FILE",
        help="Put the messages of each sensor on a link by the keys of a scene's [sensor.link] in "
        "this TOML file; with TOPIC= only those whose topics begin so. May be repeated.",
    ),
    click.option(
        "--latency-ms",
        type=NOT_NEGATIVE,
        help="Put what has no --link on a link that is so many milliseconds late.",
    ),
    click.option(
        "--jitter-ms",
        type=NOT_NEGATIVE,
        help="Let the delays of that link vary by this standard deviation, in milliseconds.",
    ),
    click.option(
        "--loss",
        type=click.FloatRange(0, 1),
        metavar="PROBABILITY",
        help="Let that link lose each message with this probability.",
    ),
    click.option(
        "--seed",
        type=click.IntRange(0, (1 << 63) - 1),
        default=0,
        show_default=True,
        help="Draw delays and losses of links by this seed; with the same seed they are the same.",
    ),
)


@click.command()
@click.argument("source", metavar="FILE-or-URL")
@click.option("--list", "listed", is_flag=True, help="Print the messages of a file, one a line.")
@click.option(
    "--count", type=click.IntRange(min=1), help="End after so many lines; implies --list."
)
@click.option(
    "--duration",
    type=POSITIVE,
    metavar="SECONDS",
    help="End after so many seconds, of what is live.",
)
@topic_option
@stage_option(
    "Take only this stage of a session's record; may be repeated. Without it all are taken, each "
    "line with its stage."
)
@click.option(
    "--interface",
    metavar="NAME",
    help="Join a multicast group at this network interface, such as eth0.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object a line.")
@click.option(
    "--verbose",
    is_flag=True,
    help="Print trees with names, units and what numbers stand for; implies --list.",
)
@click.option(
    "--edition",
    "editions",
    multiple=True,
    type=click.Choice(["025-half-turn", "062-1.18"]),
    help="Read ASTERIX 025 with longitudes in steps of 180 degrees, or 062 as before edition 1.19, "
    "where a sender has them so; may be repeated.",
)
@access_options
def show(source: str, **options: Any) -> int:
    """Print what a recording holds, in figures, or decoded messages, one a line.

    The messages are those of a file, with --list; of a broker, mqtt://HOST:PORT/TOPIC-FILTER or
    mqtts:// for TLS, where the filter is plotfeed/# if it is left out; or of a network,
    udp://ADDRESS:PORT as for record. A file is MCAP, pcap, pcapng, FINAL, raw ASTERIX or JSON
    lines.
    """
    from plotfeed.feeds.recording.show import ShowSettings, show_source

    access = take_access(options)
    return show_source(source, access, ShowSettings(**options))


@click.command()
@click.argument("recording", metavar="FILE", type=click.Path(path_type=Path))
@replay_options
@access_options
def replay(recording: Path, **options: Any) -> int:
    """Replay the recording FILE to a broker or over UDP, with its own timing.

    FILE is MCAP, pcap, pcapng, FINAL, raw ASTERIX or JSON lines. In a terminal keys steer it.
    """
    from plotfeed.feeds.cli.replay import replay_as_asked
    from plotfeed.feeds.cli.replay_options import ReplayOptions

    access = take_access(options)
    return replay_as_asked(recording, DEFAULT_BROKER, access, ReplayOptions(**options))


@click.command()
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@click.option(
    "--from",
    "from_format",
    type=click.Choice(FORMATS),
    help="Read IN in this format; without it its content says which, and else its suffix.",
)
@click.option(
    "--to",
    "to_format",
    type=click.Choice(FORMATS),
    help="Write OUT in this format; without it its suffix says which.",
)
@click.option(
    "--table",
    metavar="TABLE",
    type=click.Choice([name.value for name in TableName]),
    help=f"Write this table of Parquet or CSV: {', '.join(TableName)}. Without it the end of OUT's "
    "name says which, else it is plots, which has each plot once.",
)
@topic_option
@stage_option(
    "Take only this stage of a session's record; may be repeated. Without it a format that has no "
    "stages takes after and received."
)
@part_options
@date_option
@force_option("Replace OUT where it is there already.")
@click.option("--json", "as_json", is_flag=True, help="Print the totals as one JSON object.")
def convert(source: Path, target: Path, **options: Any) -> int:
    """Convert the recording IN to OUT.

    What is whole of a damaged file is converted. MCAP, pcap, FINAL, raw ASTERIX and JSON lines go
    both ways; pcapng is read, CSV (of plots) and Parquet (a table) are written.
    """
    from plotfeed.feeds.recording.convert import ConvertSettings, convert_recording

    return convert_recording(source, target, ConvertSettings(**options))


@click.command()
@click.argument("source", metavar="URL")
@click.argument("file", type=NEW_FILE)
@click.option(
    "--interface",
    metavar="NAME",
    help="Join a multicast group at this network interface, such as eth0.",
)
@click.option("--count", type=click.IntRange(min=1), help="End after so many messages.")
@click.option("--duration", type=POSITIVE, metavar="SECONDS", help="End after so many seconds.")
@force_option("Replace FILE where it is there already.")
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print nothing but the totals at the end, as one JSON object.",
)
@access_options
def record(source: str, file: Path, **options: Any) -> int:
    """Record what a broker or a network has to FILE, MCAP.

    URL is mqtt://HOST:PORT/TOPIC-FILTER (mqtts:// for TLS, plotfeed/# without a filter), or
    udp://ADDRESS:PORT: an address of this machine, 0.0.0.0 for all of them, or a multicast group.
    """
    from plotfeed.feeds.recording.record import RecordSettings, record_source

    access = take_access(options)
    return record_source(source, file, access, RecordSettings(**options))


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
    from plotfeed.feeds.recording.merge import merge_recordings

    return merge_recordings(sources, target, **options)
