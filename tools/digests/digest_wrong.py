"""What is wrong: damaged recordings, wrong scenes, wrong uses; what is said of them, and how."""

from __future__ import annotations

from digest_bench import Bench

# What stands in a whole scene, and what stands there instead.
SCENES = {
    "no-such-key": ("power_w", "powr_w"),
    "missing-key": ("power_w = 500.0\n", ""),
    "wrong-type": ("power_w = 500.0", 'power_w = "much"'),
    "out-of-bounds": ("power_w = 500.0", "power_w = -3"),
    "no-such-sensor": ('type = "active_radar"', 'type = "sonar"'),
    "no-such-format": ('"asterix-048"', '"asterix-021"'),
    "no-such-preset": ("sic = 2", 'sic = 2\npreset = "oracle"'),
    "no-toml": ("[scene]", "[scene"),
    "twice": ('id = "finder"', 'id = "radar"'),
    "bad-id": ('id = "finder"', 'id = "a/b"'),
    "no-flight": ("speed_m_s = 25.0", 'flight = { file = "absent.csv" }'),
    "path-and-flight": ("repeat = true", 'flight = { file = "loop.gpx" }'),
    "bad-event": ("set = { enabled = false }", "set = { type = 3 }"),
    "late-event": ("to_s = 15.0", "to_s = 2.0"),
    "bad-link": ("decodes", "link = { p = 3, in_order = 1 }\ndecodes"),
    "contradiction": (
        "decodes",
        "link = { in_order = true, reorder = { probability = 1 } }\ndecodes",
    ),
    "no-baseline": ("baseline_m = 0.1\n", ""),
    "no-time": ("2026-01-01T12:00:00Z", "2026-01-01T12:00:00"),
    "no-middleware": ("[scene.site]", "[sapient]\nmiddleware = 'nowhere'\n\n[scene.site]"),
    "bad-broker": ("[scene.site]", "[mqtt]\nbroker = 'http://here'\n\n[scene.site]"),
    "bad-udp": ("[scene.site]", "[[udp]]\ndestination = 'localhost:99999'\n\n[scene.site]"),
    "no-interface": (
        "[scene.site]",
        "[[udp]]\ndestination = '239.1.2.3:8600'\ninterface = 'no9'\n\n[scene.site]",
    ),
}
USES = (
    "",
    "fly",
    "run",
    "run absent.toml",
    "run absent.mcap",
    "run heard.toml --speed fast",
    "run heard.toml --speed -1",
    "run heard.toml --duration 0",
    "run heard.toml --broker http://here",
    "run heard.toml --broker mqtt://user:word@here",
    "run heard.toml --telemetry absent.mcap",
    "run heard.toml --broker none --speed max --page nowhere:x",
    "run heard.toml --broker none --speed max --record no/such/folder/x.mcap",
    "run heard.jsonl --broker none --speed max",
    "demo --no-page",
    "check absent.toml",
    "check heard.jsonl",
    "check heard.toml --rcs-m2 0",
    "check heard.toml --chart x.tiff",
    "chart absent.toml",
    "chart heard.toml --runs 1",
    "needs absent.toml",
    "needs heard.toml --matters much",
    "show absent.mcap",
    "show http://here/x",
    "show heard.toml",
    "show heard.jsonl --edition 1",
    "show heard.jsonl --list --count 3",
    "convert heard.jsonl heard.jsonl",
    "convert heard.jsonl loop.gpx",
    "convert heard.jsonl x.what",
    "convert heard.jsonl x.pcapng",
    "convert heard.jsonl x.mcap --topic a/#/b",
    "convert heard.jsonl x.mcap --start yesterday",
    "convert heard.toml x.mcap",
    "record nowhere x.mcap",
    "record udp://here:1 x.mcap",
    "record udp://127.0.0.1:9 loop.gpx",
    "replay absent.mcap",
    "replay heard.jsonl --udp nowhere",
    "replay heard.jsonl --udp recorded --broker http://x",
    "replay heard.jsonl --udp 127.0.0.1:9 --stamps sometimes",
    "replay heard.jsonl --udp 127.0.0.1:9 --topic x",
    "replay heard.jsonl --udp 127.0.0.1:9 --start noon",
    "replay heard.jsonl --udp 127.0.0.1:9 --link absent.toml",
    "report absent.mcap",
    "report heard.jsonl",
    "sensors nobody",
    "schema nothing",
    "inject absent.csv",
    "inject loop.gpx --set columns.x",
    "inject heard.toml",
    "inject loop.gpx --set gps_order=up",
)


def wrong_scenes(bench: Bench) -> None:
    """Each is the scene `heard` with one thing otherwise."""
    whole = (bench.folder / "heard.toml").read_text()
    for name, (old, new) in SCENES.items():
        if old not in whole:
            raise ValueError(f"{name}: {old} is not in the scene")
        bench.write(f"wrong-{name}.toml", whole.replace(old, new, 1).encode())
        bench.run("wrong scene", "check", f"wrong-{name}.toml")
    for name in ("no-such-key", "no-flight", "no-toml", "no-interface"):
        how = ["--broker", "none", "--speed", "max"]
        bench.run("wrong scene", "run", f"wrong-{name}.toml", *how)


def wrong_uses(bench: Bench) -> None:
    for use in USES:
        bench.run("wrong use", *use.split())


def damage(bench: Bench, name: str) -> None:
    """Files of all formats that are cut, or in which an octet is another."""
    for suffix in ("jsonl", "pcap", "ff", "ast", "mcap"):
        data = (bench.folder / f"{name}-to.{suffix}").read_bytes()
        middle = len(data) // 2
        turned = data[:middle] + bytes([data[middle] ^ 0xFF]) + data[middle + 1 :]
        for how, damaged in (("cut", data[: len(data) * 3 // 5]), ("turned", turned)):
            file, target = f"{name}-{how}.{suffix}", f"{name}-{how}-{suffix}.jsonl"
            bench.write(file, damaged)
            bench.run(name, "show", file)
            bench.run(name, "convert", file, target, "--date", "2026-01-01")
            bench.octets(name, target)
