"""The command: plotfeed demo, run, inject, check, show, record, replay, convert, and others."""

from __future__ import annotations

import gc
import logging
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from plotfeed.feeds.cli.options import (
    NEW_FILE,
    POSITIVE,
    AccessOptions,
    FleetSettings,
    InjectSettings,
    ReplayOptions,
    RunSettings,
    force_option,
    options_of,
)
from plotfeed.feeds.console import INTERRUPTED
from plotfeed.feeds.console.printed import STANDARD_OUTPUT, PrintableFormatter, naming, say
from plotfeed.feeds.lab.lab_settings import (
    ChartSettings,
    NeedsSettings,
    ScoreOptions,
    SweepSettings,
    TrackerSettings,
)
from plotfeed.feeds.recording.recording_settings import (
    ConvertSettings,
    RecordSettings,
    ShowSettings,
)
from plotfeed.proto.errors import PlotfeedError

# What a command needs is imported inside it, so that --help does not wait for NumPy.

# Objects more than before at which the garbage collector looks at what commands load and check.
GARBAGE_OF_START = 100_000
OF_FILES = ("tracks", "truth", "feed")  # Options of a tracker whose tracks are there already
# Options that were: what is typed in place of them.
GONE = {
    "--ca-file": "ca_file in the file of --credentials",
    "--client-certificate": "client_certificate_file in the file of --credentials",
    "--client-key": "client_key_file in the file of --credentials",
    "--mqtt-version": "version in the file of --credentials",
    "--interface": "?interface=NAME behind a multicast address, --set interface=NAME for a source",
    "--ttl": "?ttl=NUMBER behind the address of --udp",
    "--fastest": "--speed max",
    "--no-page": "--page none",
    "--date": "plotfeed convert --date before the replay",
    "--table": "the end of OUT's name, as in site-looks.parquet,",
    "--column": "--set columns.OURS=THEIRS",
    "--view": "--set view=[LAT,LON,LAT,LON]",
    "--lean": "--write lean.toml",
    "--full": "--write full.toml",
    **{
        f"--{key.replace('_', '-')}": f"--set {key}=VALUE"
        for key in (
            "altitude",
            "altitude_reference",
            "ask_hz",
            "geoid_undulation_m",
            "gps_order",
            "height_m",
            "max_speed_m_s",
            "qnh_hpa",
            "rcs_m2",
            "takeoff_height_m",
            "utc_offset_h",
        )
    },
}


class Commands(click.Group):
    """The commands, of which none fails because nobody reads on: `plotfeed show ... | head`."""

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


def command(summary: str, *examples: str) -> Callable[[Callable[..., Any]], click.Command]:
    """A decorator of a command, with its summary in a line, and examples of what follows plotfeed.

    They are in the marks of click, which keep lines.
    """
    title = "Example:" if len(examples) == 1 else "Examples:"
    lines = ["\b", title, *(f"  plotfeed {line}" for line in examples)]
    return cli.command(short_help=summary, epilog="\n".join(lines))


@command(
    "Run a shipped scene with its live page: a field day.", "demo --duration 60", "demo stadium"
)
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


@command(
    "Run a scene, or a recorded session again.",
    "run here.toml --record there.mcap",
    "run here.toml --speed max --duration 60 --write here.ast",
    "run there.mcap --broker none --speed max",
)
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


@command(
    "Publish a flight, or what a live source says.",
    "inject flight.srt --now --set takeoff_height_m=650",
    "inject mavlink:udpin:127.0.0.1:14550 --set ask_hz=5",
)
@click.argument("flight", metavar="FLIGHT-or-SOURCE")
@options_of(InjectSettings, AccessOptions)
def inject(settings: InjectSettings, access: AccessOptions, flight: str) -> int:
    """Publish FLIGHT, a recorded file, or what a live SOURCE says, as live telemetry.

    FLIGHT is a DJI subtitle file (.srt), a table (.csv, .tsv, .txt), a log of ArduPilot (.bin),
    MAVLink (.tlog) or PX4 (.ulg), a GPX (.gpx) or KML (.kml) track, or NMEA sentences (.nmea).

    SOURCE is KIND:TRANSPORT:PLACE, such as mavlink:udpin:127.0.0.1:14550 or mavlink:-, of the
    kinds mavlink, remote-id, sbs1, beast and asterix-021.
    """
    from plotfeed.feeds.cli.inject import publish_flight, publish_source
    from plotfeed.feeds.scene.telemetry_keys import looks_like_source
    from plotfeed.feeds.transport.mqtt.address import BrokerAddress

    address = BrokerAddress.parse(settings.broker, **access.parsed())
    if looks_like_source(flight) and not Path(flight).exists():
        return publish_source(flight, settings, address)
    return publish_flight(Path(flight), settings, address)


@command(
    "Validate a scene; print who sees which drone, and Pd against range.",
    "check here.toml",
    "check here.toml --json",
    "check here.toml --chart here.png",
)
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


@command(
    "Say what a scene needs, and what it can leave out.",
    "needs here.toml --matters 5% --runs 4 --duration 10",
    "needs here.toml --runs 4 --duration 10 --write lean.toml",
)
@click.argument("scene", type=click.Path(path_type=Path))
@options_of(NeedsSettings)
def needs(settings: NeedsSettings, *, scene: Path) -> int:
    """Say what SCENE, a TOML file, needs, what it can leave out, and what it lacks.

    Each effect that the scene names is switched off, and each that it could name is switched on,
    through the engine itself and with the same random numbers.
    """
    from plotfeed.feeds.lab.needs import print_needs
    from plotfeed.feeds.scene.scene import load

    print_needs(load(scene), settings)
    return 0


@command(
    "Chart speed against accuracy of a scene's choices.",
    "chart here.toml --runs 4 --duration 10 --chart choices.png",
)
@click.argument("scene", type=click.Path(path_type=Path))
@options_of(ChartSettings)
def chart(settings: ChartSettings, *, scene: Path) -> int:
    """Chart speed against accuracy: the choices that SCENE, a TOML file, has.

    These are formats, sectors, periods, tracks on board, and each effect left out, all compared
    with the scene as it is.
    """
    from plotfeed.feeds.lab.needs import print_chart
    from plotfeed.feeds.scene.scene import load

    print_chart(load(scene), settings)
    return 0


@command("List the scenes that come with plotfeed.", "scenes", "scenes --json")
@click.option("--json", "as_json", is_flag=True, help="Print them as JSON.")
def scenes(*, as_json: bool) -> int:
    """List the scenes that come with plotfeed: what each is about, and its file to start from."""
    from plotfeed.feeds.cli.show_sensors import print_scenes

    print_scenes(as_json=as_json)
    return 0


@command("List commercial sensors for scenes.", "sensors", "sensors echodyne")
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="Print them as JSON.")
def sensors(name: str | None, *, as_json: bool) -> int:
    """List the commercial sensors and systems that a scene can name as presets, or one of them.

    NAME is that of one, such as echodyne: its keys are printed, each with where it comes from.
    """
    from plotfeed.feeds.cli.show_sensors import print_presets

    print_presets(name, as_json=as_json)
    return 0


@command(
    "Print the schema of scenes, messages or topics.",
    "schema",
    "schema messages",
    "schema asyncapi",
)
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


@command(
    "Make many runs of scenes, with keys varied.",
    "sweep here.toml --vary sensor.radar.pfa=1e-6,1e-5 --runs 100",
    "sweep here.toml there.toml --vary link.latency_ms=0,250 --out two",
)
@click.argument("scenes", metavar="SCENE", nargs=-1, required=True, type=click.Path(path_type=Path))
@options_of(SweepSettings)
def sweep(settings: SweepSettings, scenes: tuple[Path, ...]) -> int:
    """Make many seeded runs of SCENE, a TOML file, in simulated time, with keys varied.

    Several scenes are compared. A key goes by its path, such as sensor.radar.pfa or
    drone.intruder.rcs_m2, where sensors go by id or type; link.latency_ms is that of all sensors.
    Tables are Parquet, or CSV where that cannot be written. What is done is kept: the same command
    goes on after an interruption.
    """
    from plotfeed.feeds.lab.sweep import run_sweep

    return run_sweep(scenes, settings)


@command(
    "Score a tracker against the truth of a run.",
    "score there.mcap --tracks tracks.csv",
    "score there.mcap --tracks tracks.csv --out score.html",
    "score there.mcap --tracks tracks.csv --profile example-f3411",
)
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
    from plotfeed.feeds.lab.score import score_recording

    if not trackers.trackers:
        if trackers.vary:
            raise click.UsageError("--vary needs --tracker")
        return score_recording(recording, found)
    from plotfeed.feeds.lab.trackers import score_tracker

    for name in OF_FILES:
        if getattr(found, name):
            raise click.UsageError(f"--{name} contradicts --tracker")
    if len(found.topics) > 1:
        raise click.UsageError("--topic: a tracker of --tracker publishes on one")
    return score_tracker(recording, trackers, found)


@command(
    "Sum a recording up, or decode messages.",
    "show there.mcap",
    "show here.ast --list",
    "show mqtt://127.0.0.1:1883/plotfeed/#",
)
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


@command(
    "Replay a recording to a broker or over UDP.",
    "replay there.mcap",
    "replay here.pcap --udp 127.0.0.1:8600 --speed 2",
)
@click.argument("recording", metavar="FILE", type=click.Path(path_type=Path))
@options_of(ReplayOptions, AccessOptions)
def replay(options: ReplayOptions, access: AccessOptions, recording: Path) -> int:
    """Replay the recording FILE to a broker or over UDP, with its own timing.

    FILE is MCAP, pcap, pcapng, FINAL, raw ASTERIX or JSON lines. In a terminal keys steer it.
    """
    from plotfeed.feeds.cli.replay import replay_as_asked

    return replay_as_asked(recording, access.parsed(), options)


@command(
    "Convert a recording to another format.",
    "convert here.ast here.pcap --date 2026-01-01",
    "convert there.mcap part.mcap --start 60",
)
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


@command(
    "Record a broker's topics, or datagrams.",
    "record mqtt://127.0.0.1:1883/plotfeed/# heard.mcap",
    "record udp://0.0.0.0:8600 udp.mcap",
)
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


@command(
    "Hold what was delivered against what was asked.",
    "report there.mcap",
    "report there.mcap --chart there.png",
)
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


@command("Merge recordings of one session.", "merge there.mcap part.mcap all.mcap")
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


@command(
    "Run a scene by many processes, on one machine or many.",
    "fleet here.toml --workers 2 --broker mqtt://127.0.0.1:1883",
    "fleet here.toml --broker mqtt://broker:1883 --kubernetes",
)
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
