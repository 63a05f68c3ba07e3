"""What is run for the digests: each job by itself, with files of its own."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from digest_bench import Bench, Change, json_without, one_count
from digest_items import Item, of_messages, write_by_sector
from digest_listeners import broker, datagrams
from digest_wrong import damage, wrong_scenes, wrong_uses

from plotfeed import load, simulate
from plotfeed.feeds.cli.main import cli

Job = Callable[[Bench], None]

SCENES = Path(__file__).resolve().parent / "scenes"
GOLDEN = Path(__file__).resolve().parents[2] / "tests" / "golden"
EXAMPLES = Path("examples/scenes")
SHIPPED = Path("feeds/scene/examples")
# Scenes whose records are converted and replayed too.
CONVERTED = ("radars", "listeners", "heard", "effects")
# Topics of all but what tells how a session does, such as how the machine kept pace.
OF_FEEDS = (
    *("+/+/asterix/#", "+/+/sapient/#", "+/+/plots", "+/+/tracks", "+/+/cot", "+/+/geojson"),
    *("+/telemetry/#", "+/truth", "lab/north/+/asterix/#", "lab/north/+/plots"),
    *("lab/north/+/sapient/#", "lab/north/truth"),
)
SUFFIXES = ("jsonl", "pcap", "ff", "ast", "mcap")
TABLES = ("plots", "truths", "looks", "tracks", "messages", "fates")
CHARTED = ("section-4", "radars", "listeners")
# Times, and what is chosen by times, do not repeat; nor does the machine.
OF_CHARTS = json_without("machine", "processor", "processor_s_per_s")
OF_REPLAYS = json_without("duration_s")
START = "start_utc = 2026-01-01T12:00:00Z\nduration_s = 20.0"
START_NS = 1_767_268_800 * 10**9
QUIETLY = ("--broker", "none", "--speed", "max")


def jobs(bench: Bench, root: Path) -> list[Job]:
    """Those of the scenes here, and of the scenes that `root`, a clone of the project, ships."""
    names = []
    for folder in (SCENES, GOLDEN / "flights", root / "examples/flights"):
        for path in sorted(folder.iterdir()):
            bench.write(path.name, path.read_bytes())
    for path in sorted([*(root / SHIPPED).iterdir(), *(root / EXAMPLES).iterdir()]):
        if path.suffix == ".toml":
            # Without a time at which it begins, a scene begins now.
            text = path.read_text().replace("../flights/", "")
            text = re.sub(r"\[\[http\]\]\n(.+\n)+", "", text)  # there is no server
            if "start_utc" not in text:
                text = text.replace("[scene]\n", f"[scene]\n{START}\n", 1)
            bench.write(path.name, text.encode())
            names.append(path.stem)
        elif path.suffix in (".geojson", ".hgt"):
            bench.write(path.name, path.read_bytes())
    found: list[Job] = [partial(_shipped, name=name) for name in names]
    names += sorted(path.stem for path in SCENES.glob("*.toml"))
    found += [partial(_scene, name=name) for name in names]
    found += [partial(_chart, name=name) for name in CHARTED if name in names]
    recordings = sorted((GOLDEN / "recordings").iterdir())
    found += [partial(_foreign, path=path) for path in recordings]
    flights = sorted(path.name for path in (GOLDEN / "flights").iterdir())
    found += [partial(_inject, file=file) for file in ["loop.gpx", *flights]]
    found += [_static, _sensors, _udp, _session_over_mqtt, _sweeps, wrong_scenes, wrong_uses]
    return found


def _shipped(bench: Bench, *, name: str) -> None:
    """What Python has of it: the columns of three seconds."""
    scene = load(bench.folder / f"{name}.toml")
    simulated = simulate(scene, 3, start_utc_ns=START_NS)
    for sensor, seen in simulated.items():
        lines = []
        for table in (seen.plots, seen.looks):
            for field in fields(table):
                value = repr(np.asarray(getattr(table, field.name)).tolist())
                lines.append(f"{field.name} {hashlib.sha256(value.encode()).hexdigest()}")
        bench.add(f"{name}: simulate: {sensor}", Item(lines))


def _scene(bench: Bench, *, name: str) -> None:
    scene, record, again = f"{name}.toml", f"{name}.mcap", f"{name}-again.mcap"
    bench.run(name, "check", scene)
    bench.run(name, "check", scene, "--json", "--rcs-m2", "0.3")
    heard: list[str] = []
    if (bench.folder / f"{name}.jsonl").exists():
        bench.run(name, "convert", f"{name}.jsonl", f"{name}-in.mcap")
        heard = ["--telemetry", f"{name}-in.mcap"]
    end = ["--record", record, "--write", f"{name}.raw", "--json"]
    bench.run(name, "run", scene, *heard, *QUIETLY, *end)
    first = bench.recording(name, record)
    bench.octets(name, f"{name}.raw")
    end = ["--record", again, "--write", f"{name}-again.raw"]
    bench.run(name, "run", record, *QUIETLY, *end, change=one_count)
    lines = [f"{each} {item.digest}" for each, item in _of(bench, again) if not item.is_said]
    bench.add(f"{name}: {again}", Item(lines))
    bench.octets(name, f"{name}-again.raw")
    bench.run(name, "report", record)
    bench.run(name, "report", record, "--json")
    bench.run(name, "show", record)
    bench.run(name, "show", record, "--list", "--count", "300")
    bench.run(name, "show", record, "--list", "--count", "100", "--verbose")
    bench.run(name, "score", record, "--feed")
    bench.run(name, "score", record, "--feed", "--json")
    for topic in sorted({t.split()[0] for t in first if t.endswith("/tracks after")}):
        bench.run(name, "score", record, "--topic", topic)
        bench.run(name, "score", record, "--topic", topic, "--json")
    if name in CONVERTED:
        still = f"{name}-still.mcap"
        bench.run(name, "convert", record, still, *(f"--topic={topic}" for topic in OF_FEEDS))
        write_by_sector(bench.folder / still)
        bench.run(name, "show", still, "--json", "--list", "--edition", "025-half-turn")
        _convert(bench, name, still)
        _replay(bench, name, still)


def _of(bench: Bench, record: str) -> list[tuple[str, Item]]:
    other = Bench(bench.folder)
    return sorted(other.recording("", record).items())


def _convert(bench: Bench, name: str, record: str) -> None:
    """To every format, and back."""
    for suffix in SUFFIXES:
        target = f"{name}-to.{suffix}"
        bench.run(name, "convert", record, target)
        bench.octets(name, target)
    for table in TABLES:
        target = f"{name}-{table}.parquet"
        bench.run(name, "convert", record, target)
        _parquet(bench, name, target)
    _table(bench, name, record, f"{name}-to.csv")
    _table(bench, name, record, f"{name}-before.csv", "--stage", "before", "--json")
    for suffix, stage in (("ast", "before"), ("jsonl", "telemetry")):
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
    bench.run(name, "merge", record, record, f"{name}-merged.mcap", "--json")
    bench.octets(name, f"{name}-merged.mcap")
    if name == "heard":
        damage(bench, name)


def _table(bench: Bench, name: str, record: str, target: str, *more: str) -> None:
    bench.run(name, "convert", record, target, *more)
    path = bench.folder / target
    lines = path.read_text().split("\n") if path.exists() else []
    bench.add(f"{name}: {target}", Item(lines, is_said=True))


def _parquet(bench: Bench, name: str, target: str) -> None:
    """Columns and rows, for the octets have the version of the library."""
    path = bench.folder / target
    lines = []
    if path.exists():
        table = pq.read_table(path)
        for column in table.schema:
            values = table[column.name]
            if pa.types.is_timestamp(column.type):  # Python's own have no nanoseconds
                values = values.cast(pa.int64())
            lines.append(f"{column.name} {column.type} {values.to_pylist()}")
    bench.add(f"{name}: {target}", Item(lines, is_said=True))


def _replay(bench: Bench, name: str, record: str) -> None:
    """As fast as possible, where times are simulated; with times inside messages moved."""
    late = bench.folder / "late.toml"
    late.write_text(
        'latency_ms = 90.0\njitter_ms = 40.0\nloss = { kind = "random", probability = 0.1 }\n'
    )
    link = ["--link", late.name, "--seed", "5"]
    for which, more in {
        "as it was": [],
        "before": ["--stage", "before", "--stamps", "+3600"],
        "lossy": [*link, "--start", "1.5"],
    }.items():
        how = ["replay", record, "--speed", "max", "--json", *more]
        with datagrams() as listener:
            to, port = f"127.0.0.1:{listener.port}", listener.port
            bench.run(name, *how, "--udp", to, change=OF_REPLAYS, port=port)
        lines = [each.hex() for each in listener.heard]
        bench.add(f"{name}: replay {which} to UDP: datagrams", Item(lines))
    for which, more in {
        "all": ["--truth", "--stamps", "+86399.5", "--topic", "plotfeed=lab/again"],
        "lossy": [*link, "--end", "9"],
        "telemetry": ["--stage", "telemetry", "--stamps", "keep"],
    }.items():
        how = ["replay", record, "--speed", "max", "--json", *more]
        _over_mqtt(bench, f"{name}: replay {which}", *how, change=OF_REPLAYS)


def _over_mqtt(bench: Bench, name: str, *words: str, change: Change | None = None) -> None:
    """An item for each topic; of the ledger nothing, for its encoding may change."""
    with broker() as found:
        address = f"mqtt://127.0.0.1:{found.port}"
        bench.run(name, *words, "--broker", address, change=change, port=found.port)
    for topic, lines in sorted(found.topics.items()):
        if not topic.endswith("/truth"):
            bench.add(f"{name}: published {topic}", of_messages(topic, lines))


def _chart(bench: Bench, *, name: str) -> None:
    short = ("--runs", "2", "--duration", "5", "--json")
    for command in ("chart", "needs"):
        bench.run(name, command, f"{name}.toml", *short, change=OF_CHARTS)


def _foreign(bench: Bench, *, path: Path) -> None:
    """A recording that others made."""
    bench.write(path.name, path.read_bytes())
    for options in ([], ["--json"], ["--list"], ["--list", "--json", "--edition", "062-1.18"]):
        bench.run("recording", "show", path.name, *options)
    for suffix in SUFFIXES:
        target = f"{path.stem}-to.{suffix}"
        bench.run("recording", "convert", path.name, target, "--date", "2026-01-01")
        bench.octets("recording", target)
    _table(bench, "recording", path.name, f"{path.stem}-to.csv", "--date", "2026-01-01")
    if path.suffix == ".pcap":
        _replay(bench, path.name, path.name)


def _inject(bench: Bench, *, file: str) -> None:
    reference = ["--set", "altitude_reference=ellipsoid"] if file == "eight.csv" else []
    reference += ["--set", "height_m=60"] if file == "frames.srt" else []
    fast = ["--speed", "1000", *reference]
    _over_mqtt(bench, f"inject {file}", "inject", file, *fast)
    more = ["--encoding", "json", "--raw", "--drone", "d", "--prefix", "lab/1"]
    known = ("rcs_m2=0.2", "takeoff_height_m=62", "geoid_undulation_m=19.5")
    datum = [word for each in known for word in ("--set", each)]
    _over_mqtt(bench, f"inject {file} as JSON", "inject", file, *fast, *more, *datum)


def _static(bench: Bench) -> None:
    bench.run("static", "--version")
    bench.run("static", "--help")
    for command in cli.commands:
        bench.run("static", command, "--help")
    for what in ("scene", "messages", "asyncapi"):
        bench.run("static", "schema", what)
    bench.run("static", "scenes", "--json")


def _sensors(bench: Bench) -> None:
    listed = bench.run("static", "sensors")
    bench.run("static", "sensors", "--json")
    for line in listed.split("\n\n", maxsplit=1)[0].splitlines()[1:]:
        bench.run("static", "sensors", line.split()[0], "--json")


def _udp(bench: Bench) -> None:
    """ASTERIX of a session by datagrams, one destination for all and one for a sensor; and CoT."""
    for name in ("links", "effects"):
        scene = (bench.folder / f"{name}.toml").read_text()
        of = {"links": "radar", "effects": "distant"}[name]
        with datagrams() as everything, datagrams() as one, datagrams() as events:
            tables = f'[[udp]]\ndestination = "127.0.0.1:{everything.port}"\nmax_octets = 64\n'
            tables += f'[[udp]]\ndestination = "127.0.0.1:{one.port}"\nsensors = ["{of}"]\n'
            if name == "effects":
                tables += f'[[udp]]\ndestination = "127.0.0.1:{events.port}"\ncarries = "cot"\n'
            bench.write(f"udp-{name}.toml", f"{scene}\n{tables}".encode())
            bench.run("udp", "run", f"udp-{name}.toml", *QUIETLY, "--json")
        listeners = {"everything": everything, "one sensor": one, "events": events}
        for each, listener in listeners.items():
            lines = [datagram.hex() for datagram in listener.heard]
            bench.add(f"udp: {name}: {each}", Item(lines))


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


def _sweeps(bench: Bench) -> None:
    runs = ["--runs", "2", "--duration", "5", "--processes", "1"]
    radar = ["sweep", "radar-udp.toml", "bad-link.toml", "--vary", "link.latency_ms=0,250", *runs]
    bench.run("sweep", *radar, "--json")
    (table,) = (bench.folder / "sweep").glob("runs.*")
    _parquet(bench, "sweep", f"sweep/{table.name}")
    bench.run("sweep", "sweep", "field-day.toml", *runs, "--out", "runs.csv")
    bench.octets("sweep", "runs.csv")
