"""What `--help` says of each command: sentences, formats, and examples, each of which is run."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import click
import pytest
from support.brokers import free_port, mosquitto
from support.command import plotfeed_here, running
from support.scored_flights import csv_of
from support.vehicles import sending_vehicle

from plotfeed.feeds.cli.main import cli
from plotfeed.feeds.recording.recording_settings import FileKind
from plotfeed.feeds.scene.telemetry_keys import KINDS
from plotfeed.feeds.telemetry.flights import BY_SUFFIX

ROOT = Path(__file__).parents[3]
SIMULATED = "--broker none --speed max"
SENTENCE = re.compile(r"[A-Z][a-z]+ [^ ].* [^ ]+[^.]\.")
# With which something begins that is no sentence: one that says what an option does has a verb.
FRAGMENT = re.compile(
    "A|Also|An|As|At|By|Each|Even|Every|For|From|How|If|In|Instead|It|Of|On|Only|Or|Once|So|The|"
    "Their|These|This|Those|Times|To|What|When|Where|Which|Who|With|Within|Without"
)
FILES = [
    "MCAP" if name == "mcap" else "JSON lines" if name == "jsonl" else name
    for name in get_args(FileKind)
]
READ = [name for name in FILES if name not in ("csv", "parquet")]
# Formats that a command reads and writes.
SPOKEN = {
    "demo": ["ASTERIX", "SAPIENT", "protobuf", "MQTT"],
    "run": ["TOML", "MCAP", "ASTERIX", "SAPIENT", "protobuf", "MQTT", "UDP"],
    "inject": [*BY_SUFFIX, *KINDS],
    "check": ["TOML", ".png", ".svg", ".pdf", "JSON"],
    "show": READ,
    "replay": READ,
    "convert": FILES,
    "merge": ["MCAP"],
    "record": ["mqtt://", "udp://", "MCAP"],
    "report": ["MCAP", ".png", ".svg", ".pdf", "JSON"],
    "score": ["MCAP", "pcap", ".ast", "CSV", "GeoJSON", "ASTERIX 062", "SAPIENT", "TOML", "JUnit"],
    "fleet": ["TOML", "MQTT", "MCAP", "Kubernetes", "JSON"],
    "needs": ["TOML", "png", "svg", "JSON"],
    "chart": ["TOML", "png", "svg", "JSON"],
    "sweep": ["TOML", ".png", ".svg", ".pdf", "Parquet", ".csv", "JSON"],
    "scenes": ["JSON"],
    "sensors": ["JSON"],
    "schema": ["JSON schema", "protobuf", "AsyncAPI"],
}
PARAMETERS = [
    pytest.param(command, parameter, id=f"{name} {parameter.opts[0]}")
    for name, command in cli.commands.items()
    for parameter in command.params
]


@pytest.mark.parametrize(("command", "parameter"), PARAMETERS)
def test_each_option_and_argument_is_told_of_in_a_sentence(
    command: click.Command, parameter: click.Parameter
) -> None:
    if isinstance(parameter, click.Option):
        told = parameter.help or ""
        assert SENTENCE.fullmatch(told)
        assert not FRAGMENT.fullmatch(told.split()[0])
    else:  # click has no help of arguments: the command's text names them
        name = parameter.make_metavar(click.Context(command)).strip("[]").split("-or-")[0]
        assert re.search(rf"\b{name}\b", command.help or "", re.IGNORECASE if "-or-" else 0)


@pytest.mark.parametrize("name", cli.commands)
def test_help_names_the_formats_and_is_cut_nowhere(name: str) -> None:
    told = plotfeed_here(name, "--help").stdout
    joined = " ".join(told.split())
    assert [word for word in SPOKEN[name] if word.lower() not in joined.lower()] == []
    text = cli.commands[name].help or ""
    assert all(sentence[-1] in ".:" for sentence in text.strip().split("\n\n"))
    assert max(map(len, told.splitlines())) <= 80
    assert "..." not in told


def test_the_list_of_commands_has_whole_summaries() -> None:
    assert cli.commands.keys() == SPOKEN.keys()
    listed = plotfeed_here("--help").stdout
    assert max(map(len, listed.splitlines())) <= 80
    for name, command in cli.commands.items():
        summary = command.short_help or ""
        assert re.search(rf"^  {name} +{re.escape(summary)}$", listed, re.MULTILINE)
        assert summary.endswith(".")


# What makes an example end soon, or go to the broker of the test.
ENDS = {
    "demo --duration 60": f"{SIMULATED} --duration 5",
    "demo stadium": f"{SIMULATED} --duration 5",
    "run here.toml --record there.mcap": f"{SIMULATED} --duration 70",
    "run here.toml --speed max --duration 60 --write here.ast": "--broker none --duration 20",
    "fleet here.toml --workers 2 --broker mqtt://127.0.0.1:1883": "--duration 2",
    "inject flight.srt --now --set takeoff_height_m=650": "--broker {broker}",
    "inject mavlink:udpin:127.0.0.1:14550 --set ask_hz=5": "--broker {broker} --duration 2",
    "sweep here.toml --vary sensor.radar.pfa=1e-6,1e-5 --runs 100": (
        "--runs 2 --duration 2 --processes 1"
    ),
    "sweep here.toml there.toml --vary link.latency_ms=0,250 --out two": (
        "--runs 1 --duration 1 --processes 1"
    ),
    **dict.fromkeys(
        (
            "needs here.toml --matters 5% --runs 4 --duration 10",
            "needs here.toml --runs 4 --duration 10 --write lean.toml",
            "chart here.toml --runs 4 --duration 10 --chart choices.png",
        ),
        "--runs 2 --duration 0.5",
    ),
    "show mqtt://127.0.0.1:1883/plotfeed/#": "--count 3",
    "record mqtt://127.0.0.1:1883/plotfeed/# heard.mcap": "--count 3",
    "record udp://0.0.0.0:8600 udp.mcap": "--duration 0.1",
    "replay there.mcap": "--broker {broker} --speed max",
    "replay here.pcap --udp 127.0.0.1:8600 --speed 2": "--speed max",
}


VEHICLE_PORT = free_port()


@pytest.fixture(scope="module")
def beside(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, str]]:
    """A folder with what examples name, and a broker at which a session runs."""
    folder, port = tmp_path_factory.mktemp("examples"), free_port()
    subtitles = (ROOT / "tests" / "golden" / "flights" / "eight.srt").read_text()
    (folder / "flight.srt").write_text("\n\n".join(subtitles.split("\n\n")[:4]))
    scene = (ROOT / "examples" / "scenes" / "radar-udp.toml").read_text()
    for theirs, ours in (
        ("127.0.0.1:8600", f"127.0.0.1:{free_port()}"),
        ("latitude_deg = 40.45", "latitude_deg = 43.31"),
        ("longitude_deg = -3.73", "longitude_deg = -5.9"),
    ):
        assert theirs in scene
        scene = scene.replace(theirs, ours)
    (folder / "here.toml").write_text(scene)
    (folder / "there.toml").write_text(scene.replace('name = "', 'name = "there-'))
    with mosquitto(folder, port), sending_vehicle(VEHICLE_PORT):
        broker = f"mqtt://127.0.0.1:{port}"
        with running("run", folder / "here.toml", "--broker", broker):
            yield folder, broker


def test_every_example_does_what_it_says(
    beside: tuple[Path, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, broker = beside
    monkeypatch.chdir(folder)
    told = "\n".join(command.epilog or "" for command in cli.commands.values())
    examples = re.findall("^  plotfeed (.+)$", told, re.MULTILINE)
    assert ENDS.keys() <= set(examples)
    order = {"run": 0, "convert": 1}  # others read what they write
    for example in sorted(examples, key=lambda line: order.get(line.split()[0], 2)):
        assert f"  plotfeed {example}\n" in plotfeed_here(example.split()[0], "--help").stdout
        if example.startswith("score"):
            csv_of(folder / "tracks.csv", folder / "there.mcap")
        words = shlex.split(f"{example} {ENDS.get(example, '')}".format(broker=broker))
        words = [
            word.replace("mqtt://127.0.0.1:1883", broker)
            .replace(":8600", f":{free_port()}")
            .replace(":14550", f":{VEHICLE_PORT}")
            for word in words
        ]
        done = plotfeed_here(*words)
        assert done.returncode == 0, (example, done.stdout, done.stderr)
        assert done.stdout.strip(), example
    pictures = ("here.png", "there.png", "choices.png")
    for name in ("here.ast", "here.pcap", "part.mcap", "heard.mcap", "lean.toml", *pictures):
        assert (folder / name).stat().st_size > 100, name
