"""The command: plotfeed demo, run, inject, check, show, record, replay, convert, and others."""

from __future__ import annotations

import gc
import logging
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from plotfeed.feeds.cli.fleet import fleet
from plotfeed.feeds.cli.help_texts import GONE, SUMMARIES_AND_EXAMPLES, epilog_of
from plotfeed.feeds.cli.inject_settings import InjectSettings
from plotfeed.feeds.cli.options import NEW_FILE, POSITIVE, AccessOptions, force_option, options_of
from plotfeed.feeds.cli.recording_commands import convert, merge, record, replay, report, show
from plotfeed.feeds.cli.run_settings import RunSettings
from plotfeed.feeds.cli.score_commands import score
from plotfeed.feeds.cli.sweep_commands import sweep
from plotfeed.feeds.console import INTERRUPTED
from plotfeed.feeds.console.printed import STANDARD_OUTPUT, PrintableFormatter, naming, say
from plotfeed.feeds.lab.lab_settings import ChartSettings, NeedsSettings
from plotfeed.proto.errors import PlotfeedError

# What a command needs is imported inside it, so that --help does not wait for NumPy.


# Objects more than before at which the garbage collector looks at what commands load and check.
GARBAGE_OF_START = 100_000


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
@click.version_option(package_name="plotfeed", prog_name="plotfeed")
def cli() -> None:
    """Drone telemetry in; what counter-UAS sensors would have reported out, in real time."""


@cli.command()
@click.argument("scene", default="field-day")
@options_of(RunSettings)
def demo(settings: RunSettings, *, scene: str) -> int:
    """Run a scene that comes with plotfeed: a field day, or another one by its name.

    `plotfeed scenes` lists them. On the field day five kinds of sensors see twenty-one drones, over
    a poor link. The live page is on port 8590 of this machine, or another where that is taken; time
    can be paused and hurried there. Sensors report as ASTERIX, SAPIENT and protobuf over MQTT, by
    an embedded broker unless another is named.
    """
    from plotfeed.feeds.cli.run import run_in_terminal
    from plotfeed.feeds.scene.scene import example

    settings = replace(settings, shows_page=True, can_be_held=True)
    return run_in_terminal(example(scene), settings)


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option(
    "--telemetry",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Take in again, at the same times, what came in to the session in this MCAP file.",
)
@click.option(
    "--part",
    metavar="K/N",
    help="Run part K of N of the scene's sensors; other processes run the others.",
)
@click.option(
    "--start",
    metavar="TIME",
    help="Begin the scene at this time, as 2026-01-01T12:00:00Z: all parts at the same.",
)
@options_of(RunSettings)
def run(settings: RunSettings, *, scene: Path, **more: Any) -> int:
    """Run SCENE, a TOML file, or run the record of a session (MCAP) again.

    Sensors report as the scene says: as ASTERIX, SAPIENT and protobuf, over MQTT and UDP.
    """
    from plotfeed.feeds.cli.run import is_record, run_again, run_in_terminal
    from plotfeed.feeds.scene.scene import load

    settings = replace(settings, **more)
    if is_record(scene):
        return run_again(scene, settings)
    return run_in_terminal(load(scene), settings)


@cli.command()
@click.argument("flight", metavar="FLIGHT-or-SOURCE")
@options_of(InjectSettings, AccessOptions)
def inject(settings: InjectSettings, access: AccessOptions, flight: str) -> int:
    """Publish FLIGHT, a recorded file, or what a live SOURCE says, as live telemetry.

    FLIGHT is a DJI subtitle file (.srt), a table (.csv, .tsv, .txt), a log of ArduPilot (.bin),
    MAVLink (.tlog) or PX4 (.ulg), a GPX (.gpx) or KML (.kml) track, or NMEA sentences (.nmea).

    SOURCE is KIND:TRANSPORT:PLACE, such as mavlink:udpin:127.0.0.1:14550 or mavlink:-, of the
    kinds mavlink, remote-id, sbs1, beast and asterix-021.
    """
    from plotfeed.feeds.cli.inject import publish_flight
    from plotfeed.feeds.cli.inject_live import publish_source
    from plotfeed.feeds.scene.telemetry_keys import looks_like_source
    from plotfeed.feeds.transport.mqtt.address import BrokerAddress

    address = BrokerAddress.parse(settings.broker, **access.parsed())
    if looks_like_source(flight) and not Path(flight).exists():
        return publish_source(flight, settings, address)
    return publish_flight(Path(flight), settings, address)


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option(
    "--rcs-m2",
    type=POSITIVE,
    metavar="M2",
    help="Judge by a target of this radar cross-section, in square metres, instead of the scene's.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print everything as one JSON object, the problems of a scene that is refused too.",
)
@click.option(
    "--chart",
    type=NEW_FILE,
    metavar="FILE",
    help="Draw Pd and errors against range to this file too, .png, .svg or .pdf.",
)
@force_option("Replace the file of --chart where it is there already.")
def check(scene: Path, **options: Any) -> int:
    """Validate SCENE, a TOML file; print who sees its drones, when and with what Pd, or why not.

    After that, the Pd and errors that each sensor has against range.
    """
    from plotfeed.feeds.cli.check import print_check

    print_check(scene, **options)
    return 0


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@options_of(NeedsSettings)
def needs(settings: NeedsSettings, *, scene: Path) -> int:
    """Say what SCENE, a TOML file, needs, what it can leave out, and what it lacks.

    Each effect that the scene names is switched off, and each that it could name is switched on,
    through the engine itself and with the same random numbers.
    """
    from plotfeed.feeds.lab.needs_text import print_needs
    from plotfeed.feeds.scene.scene import load

    print_needs(load(scene), settings)
    return 0


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@options_of(ChartSettings)
def chart(settings: ChartSettings, *, scene: Path) -> int:
    """Chart speed against accuracy: the choices that SCENE, a TOML file, has.

    These are formats, sectors, periods, tracks on board, and each effect left out, all compared
    with the scene as it is.
    """
    from plotfeed.feeds.lab.needs_text import print_chart
    from plotfeed.feeds.scene.scene import load

    print_chart(load(scene), settings)
    return 0


@cli.command()
@click.option("--json", "as_json", is_flag=True, help="Print them as JSON.")
def scenes(*, as_json: bool) -> int:
    """List the scenes that come with plotfeed: what each is about, and its file to start from."""
    from plotfeed.feeds.cli.show_sensors import print_scenes

    print_scenes(as_json=as_json)
    return 0


@cli.command()
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="Print them as JSON.")
def sensors(name: str | None, *, as_json: bool) -> int:
    """List the commercial sensors and systems that a scene can name as presets, or one of them.

    NAME is that of one, such as echodyne: its keys are printed, each with where it comes from.
    """
    from plotfeed.feeds.cli.show_sensors import print_presets

    print_presets(name, as_json=as_json)
    return 0


@cli.command()
@click.argument(
    "what", metavar="[WHAT]", type=click.Choice(["scene", "messages", "asyncapi"]), default="scene"
)
def schema(what: str) -> int:
    """Print the schema of the scene file, of our messages, or of what flows over MQTT.

    WHAT is scene for the JSON schema of scenes (so it is without WHAT), messages for the protobuf
    schema of our messages, or asyncapi for the AsyncAPI document in JSON.
    """
    from plotfeed.feeds.schema import text_of

    say(text_of(what))
    return 0


for each in (show, convert, merge, record, replay, report, score, fleet, sweep):
    cli.add_command(each)


def main() -> None:
    """Entry point: errors are one line each, and the exit code says which kind."""
    sys.exit(_run())


def _run() -> int:
    gc.set_threshold(GARBAGE_OF_START)
    handler = logging.StreamHandler()
    handler.setFormatter(PrintableFormatter("plotfeed: %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    try:
        code = cli.main(prog_name="plotfeed", standalone_mode=False)
    except click.ClickException as error:
        if isinstance(error, click.NoSuchOption) and error.option_name in GONE:
            told = f"No such option: {error.option_name}. It is {GONE[error.option_name]} now."
            error = click.UsageError(told, error.ctx)
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
