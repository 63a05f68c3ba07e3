"""What help says of each command beside its own text: a summary in a line, and examples."""

from __future__ import annotations

# By the command's name; examples without the word plotfeed before them.
SUMMARIES_AND_EXAMPLES = {
    "demo": (
        "Run a shipped scene with its live page: a field day.",
        ("demo --duration 60", "demo stadium"),
    ),
    "run": (
        "Run a scene, or a recorded session again.",
        (
            "run here.toml --record there.mcap",
            "run here.toml --speed max --duration 60 --write here.ast",
            "run there.mcap --broker none --speed max",
        ),
    ),
    "inject": (
        "Publish a flight, or what a live source says.",
        (
            "inject flight.srt --now --set takeoff_height_m=650",
            "inject mavlink:udpin:127.0.0.1:14550 --set ask_hz=5",
        ),
    ),
    "check": (
        "Validate a scene; print who sees which drone, and Pd against range.",
        ("check here.toml", "check here.toml --json", "check here.toml --chart here.png"),
    ),
    "show": (
        "Sum a recording up, or decode messages.",
        ("show there.mcap", "show here.ast --list", "show mqtt://127.0.0.1:1883/plotfeed/#"),
    ),
    "convert": (
        "Convert a recording to another format.",
        ("convert here.ast here.pcap --date 2026-01-01", "convert there.mcap part.mcap --start 60"),
    ),
    "merge": ("Merge recordings of one session.", ("merge there.mcap part.mcap all.mcap",)),
    "record": (
        "Record a broker's topics, or datagrams.",
        (
            "record mqtt://127.0.0.1:1883/plotfeed/# heard.mcap",
            "record udp://0.0.0.0:8600 udp.mcap",
        ),
    ),
    "replay": (
        "Replay a recording to a broker or over UDP.",
        ("replay there.mcap", "replay here.pcap --udp 127.0.0.1:8600 --speed 2"),
    ),
    "report": (
        "Hold what was delivered against what was asked.",
        ("report there.mcap", "report there.mcap --chart there.png"),
    ),
    "score": (
        "Score a tracker against the truth of a run.",
        (
            "score there.mcap --tracks tracks.csv",
            "score there.mcap --tracks tracks.csv --out score.html",
            "score there.mcap --tracks tracks.csv --profile example-f3411",
        ),
    ),
    "fleet": (
        "Run a scene by many processes, on one machine or many.",
        (
            "fleet here.toml --workers 2 --broker mqtt://127.0.0.1:1883",
            "fleet here.toml --broker mqtt://broker:1883 --kubernetes",
        ),
    ),
    "needs": (
        "Say what a scene needs, and what it can leave out.",
        (
            "needs here.toml --matters 5% --runs 4 --duration 10",
            "needs here.toml --runs 4 --duration 10 --lean lean.toml",
        ),
    ),
    "chart": (
        "Chart speed against accuracy of a scene's choices.",
        ("chart here.toml --runs 4 --duration 10 --chart choices.png",),
    ),
    "sweep": (
        "Make many runs of scenes, with keys varied.",
        (
            "sweep here.toml --vary sensor.radar.pfa=1e-6,1e-5 --runs 100",
            "sweep here.toml there.toml --vary link.latency_ms=0,250 --out two",
        ),
    ),
    "scenes": ("List the scenes that come with plotfeed.", ("scenes", "scenes --json")),
    "sensors": ("List commercial sensors for scenes.", ("sensors", "sensors echodyne")),
    "schema": (
        "Print the schema of scenes, messages or topics.",
        ("schema", "schema messages", "schema asyncapi"),
    ),
}


def epilog_of(name: str) -> str:
    """The end of a command's help, in the marks of click, which keep its lines."""
    examples = SUMMARIES_AND_EXAMPLES[name][1]
    title = "Example:" if len(examples) == 1 else "Examples:"
    return "\n".join(["\b", title, *(f"  plotfeed {line}" for line in examples)])


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
