"""What is run for the digests: each job by itself, with files of its own."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

from digest_bench import Bench, Change, json_without, one_count
from digest_items import Item, Series
from digest_listeners import broker, datagrams
from digest_wrong import damage, wrong_scenes, wrong_uses

Job = Callable[[Bench], None]

SCENES = Path(__file__).resolve().parent / "scenes"
GIVEN = Path(os.environ.get("PLOTFEED_TEST_INPUT", "no input"))
FLIGHTS = {"flight-srt": "matrice_300.srt", "flight-csv": "UAV_Rot.csv", "flight-bin": "log171.bin"}
"""Scenes that need a file which may not be here."""
CONVERTED = ("radars", "listeners", "heard")
"""Scenes whose records are converted and replayed too."""
SUFFIXES = ("jsonl", "pcap", "ff", "ast", "csv", "mcap")
COMMANDS = (
    *("demo", "run", "inject", "check", "chart", "show", "replay", "convert", "record", "report"),
    *("sensors", "schema"),
)
CHARTED = ("section-4", "radars", "listeners")
# Times, and what is chosen by times, do not repeat; nor does the machine.
OF_CHARTS = json_without("ns", "machine", "on_front", "front", "cheapest", "batches")
OF_REPLAYS = json_without("duration_s")
START = "start_utc = 2026-01-01T12:00:00Z"


def jobs(bench: Bench, shipped: list[Path]) -> list[Job]:
    """`shipped` are the example scenes of the project; the longest jobs come first."""
    names = []
    for path in [*sorted(SCENES.iterdir()), *sorted((GIVEN / "flights").glob("*.*"))]:
        bench.write(path.name, path.read_bytes())
        if path.suffix == ".toml" and _is_complete(path.stem):
            names.append(path.stem)
    for path in shipped:
        bench.write(f"shipped-{path.name}", path.read_bytes())
        # Without a time at which it begins, a scene begins now.
        text = path.read_text()
        if "start_utc" not in text:
            text = text.replace("[scene]\n", f"[scene]\n{START}\nduration_s = 30.0\n", 1)
        bench.write(path.name, text.encode())
        names.append(path.stem)
    names.sort(key=lambda name: (name not in CONVERTED, name))
    found: list[Job] = [partial(_scene, name=name) for name in names]
    found += [partial(_chart, name=name) for name in CHARTED if name in names]
    recordings = sorted((GIVEN / "recordings").glob("*.*"))
    found += [partial(_foreign, path=path) for path in recordings if path.suffix != ".md"]
    found += [partial(_inject, file=file) for file in _flights()]
    return [*found, _static, _sensors, _udp, _session_over_mqtt, wrong_scenes, wrong_uses]


def _is_complete(name: str) -> bool:
    return name not in FLIGHTS or (GIVEN / "flights" / FLIGHTS[name]).exists()


def _flights() -> list[str]:
    return ["loop.gpx", *(f for f in FLIGHTS.values() if (GIVEN / "flights" / f).exists())]


def _scene(bench: Bench, *, name: str) -> None:
    scene, record, again = f"{name}.toml", f"{name}.mcap", f"{name}-again.mcap"
    bench.run(name, "check", scene)
    bench.run(name, "check", scene, "--json", "--rcs-m2", "0.3")
    heard: list[str] = []
    if (bench.folder / f"{name}.jsonl").exists():
        bench.run(name, "convert", f"{name}.jsonl", f"{name}-in.mcap")
        heard = ["--telemetry", f"{name}-in.mcap"]
    how = ["--broker", "none", "--speed", "max"]
    end = ["--record", record, "--write", f"{name}.raw", "--json"]
    bench.run(name, "run", scene, *heard, *how, *end)
    bench.recording(name, record)
    bench.octets(name, f"{name}.raw")
    end = ["--record", again, "--write", f"{name}-again.raw"]
    bench.run(name, "run", record, *how, *end, change=one_count)
    bench.recording(name, again, marked=False)
    bench.octets(name, f"{name}-again.raw")
    bench.run(name, "report", record)
    bench.run(name, "report", record, "--json")
    bench.run(name, "show", record)
    bench.run(name, "show", record, "--list")
    if name in CONVERTED:
        bench.run(name, "show", record, "--json")
        bench.run(name, "show", record, "--list", "--json", "--edition", "025-half-turn")
        _convert(bench, name)
        _replay(bench, name, record)


def _convert(bench: Bench, name: str) -> None:
    """To every format, and back."""
    record = f"{name}.mcap"
    for suffix in SUFFIXES:
        target = f"{name}-to.{suffix}"
        bench.run(name, "convert", record, target)
        bench.octets(name, target)
    for suffix, stage in (("ast", "before"), ("csv", "before"), ("jsonl", "telemetry")):
        target = f"{name}-{stage}.{suffix}"
        bench.run(name, "convert", record, target, "--stage", stage, "--json")
        bench.octets(name, target)
    part = [record, f"{name}-part.jsonl", "--start", "2.5", "--end", "6", "--topic", "+/+/#"]
    bench.run(name, "convert", *part)
    bench.octets(name, f"{name}-part.jsonl")
    for suffix in ("ff", "ast", "pcap", "jsonl"):
        target = f"{name}-from-{suffix}.{'mcap' if suffix in ('pcap', 'jsonl') else 'jsonl'}"
        bench.run(name, "convert", f"{name}-to.{suffix}", target, "--date", "2026-01-01")
        bench.octets(name, target)
    if name == "heard":
        damage(bench, name)


def _replay(bench: Bench, name: str, record: str) -> None:
    """As fast as possible, where times are simulated; with times inside messages moved."""
    link = ["--latency-ms", "90", "--jitter-ms", "40", "--loss", "0.1", "--seed", "5"]
    for which, more in {
        "as it was": [],
        "before": ["--stage", "before", "--stamps", "+3600"],
        "lossy": [*link, "--start", "1.5"],
    }.items():
        how = ["replay", record, "--fastest", "--json", *more]
        with datagrams() as listener:
            to, port = f"127.0.0.1:{listener.port}", listener.port
            bench.run(name, *how, "--udp", to, change=OF_REPLAYS, port=port)
        bench.add(f"{name}: replay {which} to UDP: datagrams", _series(listener.heard))
    for which, more in {
        "all": ["--truth", "--stamps", "+86399.5", "--topic", "plotfeed=lab/again"],
        "lossy": [*link, "--end", "9"],
        "telemetry": ["--stage", "telemetry", "--stamps", "keep"],
    }.items():
        how = ["replay", record, "--fastest", "--json", *more]
        _over_mqtt(bench, f"{name}: replay {which}", *how, change=OF_REPLAYS)


def _series(datagrams: list[bytes]) -> Item:
    series = Series()
    for datagram in datagrams:
        series.add(payload=datagram)
    return series.item()


def _over_mqtt(bench: Bench, name: str, *arguments: str, change: Change | None = None) -> None:
    with broker() as found:
        address = f"mqtt://127.0.0.1:{found.port}"
        bench.run(name, *arguments, "--broker", address, change=change, port=found.port)
    for topic, series in sorted(found.topics.items()):
        bench.add(f"{name}: published {topic}", series.item())


def _chart(bench: Bench, *, name: str) -> None:
    bench.run(name, "chart", f"{name}.toml", "--quick", "--json", change=OF_CHARTS)


def _foreign(bench: Bench, *, path: Path) -> None:
    """A recording that others made."""
    bench.write(path.name, path.read_bytes())
    for options in ([], ["--json"], ["--list"], ["--list", "--json", "--edition", "062-1.18"]):
        bench.run("recording", "show", path.name, *options)
    for suffix in SUFFIXES:
        target = f"{path.stem}-to.{suffix}"
        bench.run("recording", "convert", path.name, target, "--date", "2026-01-01")
        bench.octets("recording", target)
    if path.suffix == ".pcap":
        _replay(bench, path.name, path.name)


def _inject(bench: Bench, *, file: str) -> None:
    reference = ["--altitude-reference", "ellipsoid"] if file.endswith(".csv") else []
    fast = ["--speed", "1000", *reference]
    _over_mqtt(bench, f"inject {file}", "inject", file, *fast)
    more = ["--encoding", "json", "--raw", "--drone", "d", "--rcs-m2", "0.2", "--prefix", "lab/1"]
    datum = ["--takeoff-height-m", "62", "--geoid-undulation-m", "19.5"]
    _over_mqtt(bench, f"inject {file} as JSON", "inject", file, *fast, *more, *datum)


def _static(bench: Bench) -> None:
    bench.run("static", "--version")
    bench.run("static", "--help")
    for command in COMMANDS:
        bench.run("static", command, "--help")
    for what in ("scene", "messages", "asyncapi"):
        bench.run("static", "schema", what)


def _sensors(bench: Bench) -> None:
    listed = bench.run("static", "sensors")
    bench.run("static", "sensors", "--json")
    for line in listed.split("\n\n", maxsplit=1)[0].splitlines()[1:]:
        preset = line.split()[0]
        bench.run("static", "sensors", preset)
        bench.run("static", "sensors", preset, "--json")


def _udp(bench: Bench) -> None:
    """ASTERIX of a session by datagrams, one destination for all and one for a sensor."""
    scene = (bench.folder / "links.toml").read_text()
    with datagrams() as everything, datagrams() as one:
        tables = f'[[udp]]\ndestination = "127.0.0.1:{everything.port}"\nmax_octets = 64\n'
        tables += f'[[udp]]\ndestination = "127.0.0.1:{one.port}"\nsensors = ["radar"]\n'
        bench.write("udp.toml", f"{scene}\n{tables}".encode())
        bench.run("udp", "run", "udp.toml", "--broker", "none", "--speed", "max", "--json")
    for name, listener in (("everything", everything), ("one sensor", one)):
        bench.add(f"udp: {name}", _series(listener.heard))


def _session_over_mqtt(bench: Bench) -> None:
    """A broker, a scene whose queue drops nothing, and telemetry of a file."""
    scene = (bench.folder / "heard.toml").read_text()
    queue = '[mqtt]\nprefix = "a/b"\nqueue = { policy = "wait", messages = 5000 }\n'
    bench.write("over-mqtt.toml", f"{scene}\n{queue}".encode())
    heard = (bench.folder / "heard.jsonl").read_text().replace('"plotfeed/', '"a/b/')
    bench.write("over-mqtt.jsonl", heard.encode())
    bench.run("over MQTT", "convert", "over-mqtt.jsonl", "over-mqtt.mcap")
    fast = ["--telemetry", "over-mqtt.mcap", "--speed", "max", "--json"]
    _over_mqtt(bench, "over MQTT", "run", "over-mqtt.toml", *fast)
