"""The command: plotfeed demo, run, inject, check, show, record, replay, convert, and others."""

from __future__ import annotations

import logging
import os
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click

from plotfeed.feeds.cli.help_texts import SUMMARIES_AND_EXAMPLES, epilog_of
from plotfeed.feeds.cli.options import (
    NEW_FILE,
    POSITIVE,
    access_options,
    date_option,
    flight_options,
    force_option,
    part_options,
    replay_options,
    session_options,
    stage_option,
    take_access,
    take_flight_options,
    topic_option,
)
from plotfeed.feeds.console import INTERRUPTED
from plotfeed.feeds.console.printed import STANDARD_OUTPUT, PrintableFormatter, naming, say
from plotfeed.proto.errors import PlotfeedError

DEFAULT_BROKER = "mqtt://127.0.0.1:1883"

# What a command needs is imported inside it, so that --help does not wait for NumPy.


class Commands(click.Group):
    """The commands, of which none fails because nobody reads on: `plotfeed show ... | head`."""

    def add_command(self, cmd: click.Command, name: str | None = None) -> None:
        """Add one, with its summary and examples."""
        summary, _ = SUMMARIES_AND_EXAMPLES[name or str(cmd.name)]
        cmd.short_help, cmd.epilog = summary, epilog_of(name or str(cmd.name))
        super().add_command(cmd, name)

    def invoke(self, ctx: click.Context) -> Any:
        """Run one, and be told of a broken pipe before click is."""
        try:
            code = super().invoke(ctx)
            with naming(STANDARD_OUTPUT):
                sys.stdout.flush()
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what is left
            return 0
        return code


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(version("plotfeed"), prog_name="plotfeed")
def cli() -> None:
    """Drone telemetry in; what counter-UAS sensors would have reported out, in real time."""


@cli.command()
@session_options
@click.option("--no-page", is_flag=True, help="Without the live page, which a demo has by itself.")
def demo(*, no_page: bool, **options: Any) -> int:
    """Run the paper's section 4: a drone comes straight at four sensors.

    Its live page is on port 8590 of this machine, or another where that is taken.
    """
    from plotfeed.feeds.cli.run import RunSettings, run_in_terminal
    from plotfeed.feeds.scene.scene import example

    if no_page and options["page"] is not None:
        raise click.UsageError("--no-page contradicts --page")
    settings = RunSettings(shows_page=not no_page, **options)
    return run_in_terminal(example("section-4"), settings)


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option(
    "--telemetry",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Take in again, at the same times, what came in to the session recorded there.",
)
@session_options
def run(scene: Path, **options: Any) -> int:
    """Run SCENE, a TOML file, or run the record of a session again."""
    from plotfeed.feeds.cli.run import RunSettings, run_again, run_in_terminal
    from plotfeed.feeds.recording.session_again import is_record
    from plotfeed.feeds.scene.scene import load

    settings = RunSettings(**options)
    if is_record(scene):
        return run_again(scene, settings)
    return run_in_terminal(load(scene), settings)


@cli.command()
@click.argument("flight", type=click.Path(path_type=Path))
@click.option("--drone", metavar="ID", help="Last level of the topic; the file's name without it.")
@click.option("--broker", default=DEFAULT_BROKER, show_default=True, metavar="URL")
@click.option("--prefix", default="plotfeed", show_default=True)
@click.option("--speed", type=click.FloatRange(min=0.01, max=1000), default=1.0, show_default=True)
@click.option("--now", "shift", is_flag=True, help="Shift the flight's time to start now.")
@click.option("--encoding", type=click.Choice(["protobuf", "json"]), default="protobuf")
@click.option("--raw", is_flag=True, help="Send positions as recorded, without smoothing.")
@click.option("--takeoff-height-m", type=float, help="Above the ellipsoid; makes altitudes that.")
@click.option("--geoid-undulation-m", type=float, help="Above the ellipsoid; makes altitudes that.")
@click.option("--rcs-m2", type=POSITIVE)
@access_options
@flight_options
def inject(flight: Path, broker: str, **options: Any) -> int:
    """Publish FLIGHT, a recorded file, as live telemetry."""
    from plotfeed.feeds.cli.inject import InjectSettings, publish_flight
    from plotfeed.feeds.transport.mqtt.address import BrokerAddress

    address = BrokerAddress.parse(broker, **take_access(options))
    how_to_read = take_flight_options(options)
    return publish_flight(flight, how_to_read, InjectSettings(broker=address, **options))


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--rcs-m2", type=POSITIVE, help="Instead of the scene's.")
@click.option("--json", "as_json", is_flag=True)
@click.option(
    "--chart",
    type=NEW_FILE,
    metavar="FILE",
    help="Also draw Pd and errors against range: .png, .svg or .pdf.",
)
@force_option("Replace the file of --chart.")
def check(scene: Path, **options: Any) -> int:
    """Validate SCENE; print the Pd and errors that its sensors have against range."""
    from plotfeed.feeds.cli.check import print_check

    print_check(scene, **options)
    return 0


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Also draw: a figure a stage, one of batch sizes, one of whole configurations.",
)
@click.option("--picture", type=click.Choice(["png", "svg"]), default="png", show_default=True)
@click.option(
    "--targets",
    type=click.IntRange(1, 100_000),
    default=1000,
    show_default=True,
    help="Seen at once.",
)
@click.option("--quick", is_flag=True, help="In seconds, roughly, with 200 targets at most.")
@force_option("Replace figures that are in DIR.")
@click.option("--json", "as_json", is_flag=True)
def chart(scene: Path, **options: Any) -> int:
    """Chart speed against accuracy: every stage of SCENE by other methods, measured here."""
    from plotfeed.feeds.accuracy_chart.chart_command import print_chart
    from plotfeed.feeds.scene.scene import load

    print_chart(load(scene), **options)
    return 0


@cli.command()
@click.argument("source", metavar="FILE-or-URL")
@click.option("--list", "listed", is_flag=True, help="The messages of a file, one a line.")
@click.option("--count", type=click.IntRange(min=1), help="End after so many; implies --list.")
@click.option("--duration", type=POSITIVE, help="End after seconds, of what is live.")
@topic_option
@stage_option("Only these, of a session's record; without it all, each with its stage.")
@click.option("--interface", metavar="NAME", help="Where a multicast group is joined.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line.")
@click.option("--verbose", is_flag=True, help="Trees with names, units, words; implies --list.")
@click.option(
    "--edition",
    "editions",
    multiple=True,
    type=click.Choice(["025-half-turn", "062-1.18"]),
    help="Of ASTERIX, where senders differ.",
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


@cli.command()
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


FORMATS = ["mcap", "pcap", "pcapng", "final", "raw", "jsonl", "csv"]


@cli.command()
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@click.option("--from", "from_format", type=click.Choice(FORMATS), help="Of IN; else its content.")
@click.option("--to", "to_format", type=click.Choice(FORMATS), help="Of OUT; else its suffix.")
@topic_option
@stage_option("Only these; what has no stages takes 'after' and 'received'.")
@part_options
@date_option
@force_option("Even if OUT is there already.")
@click.option("--json", "as_json", is_flag=True, help="Totals as JSON.")
def convert(source: Path, target: Path, **options: Any) -> int:
    """Convert the recording IN to OUT.

    What is whole of a damaged file is converted. MCAP, pcap, FINAL, raw ASTERIX and JSON lines go
    both ways; pcapng is read, and CSV (of plots) is written.
    """
    from plotfeed.feeds.recording.convert import ConvertSettings, convert_recording

    return convert_recording(source, target, ConvertSettings(**options))


@cli.command()
@click.argument("source", metavar="URL")
@click.argument("file", type=NEW_FILE)
@click.option("--interface", metavar="NAME", help="Where a multicast group is joined.")
@click.option("--count", type=click.IntRange(min=1), help="End after so many messages.")
@click.option("--duration", type=POSITIVE, help="End after seconds.")
@force_option("Even if FILE is there already.")
@click.option("--json", "as_json", is_flag=True, help="End with the totals as JSON.")
@access_options
def record(source: str, file: Path, **options: Any) -> int:
    """Record what a broker or a network has to FILE, MCAP.

    URL is mqtt://HOST:PORT/TOPIC-FILTER (mqtts:// for TLS, plotfeed/# without a filter), or
    udp://ADDRESS:PORT: an address of this machine, 0.0.0.0 for all of them, or a multicast group.
    """
    from plotfeed.feeds.recording.record import RecordSettings, record_source

    access = take_access(options)
    return record_source(source, file, access, RecordSettings(**options))


@cli.command()
@click.argument("recording", metavar="FILE", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Everything, as one JSON object.")
@click.option("--chart", type=NEW_FILE, metavar="IMAGE", help="Also draw it: .png, .svg or .pdf.")
@force_option("Replace the file of --chart.")
def report(recording: Path, **options: Any) -> int:
    """Hold what a session delivered against what its scene asked, by the ledger in FILE.

    FILE is MCAP, made by run --record or by record: delays, losses, detection, errors of plots.
    """
    from plotfeed.feeds.report.report_text import print_report

    return print_report(recording, **options)


@cli.command()
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True)
def sensors(name: str | None, *, as_json: bool) -> int:
    """List the commercial sensors that a scene can name as a preset, or all keys of one: NAME."""
    from plotfeed.feeds.cli.show_sensors import print_presets

    print_presets(name, as_json=as_json)
    return 0


@cli.command()
@click.argument("what", type=click.Choice(["scene", "messages", "asyncapi"]), default="scene")
def schema(what: str) -> int:
    """Print the JSON schema of the scene file, the protobuf schema of our messages, or AsyncAPI."""
    from plotfeed.feeds.schema import text_of

    say(text_of(what))
    return 0


def main() -> None:
    """Entry point: errors are one line each, and the exit code says which kind."""
    sys.exit(_run())


def _run() -> int:
    handler = logging.StreamHandler()
    handler.setFormatter(PrintableFormatter("plotfeed: %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    try:
        code = cli.main(prog_name="plotfeed", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        return INTERRUPTED
    except PlotfeedError as error:
        return _failed(str(error), error.exit_code)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _failed(f"{where}{error.strerror or error}", 1)
    return code if isinstance(code, int) else 0


def _failed(text: str, code: int) -> int:
    for line in text.splitlines():
        say(f"plotfeed: {line}", err=True)
    return code
