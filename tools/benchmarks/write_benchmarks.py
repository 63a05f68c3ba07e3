"""Runs every benchmark and writes docs/benchmarks.md; nothing is asserted.

    python tools/benchmarks/write_benchmarks.py [FILE ...]

With files such as bench_log.py, only those run, and the other sections stay as they were.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from plotfeed.feeds.console.process import processor

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "benchmarks.md"
BENCHMARKS = {
    "bench_model.py": "The physics",
    "bench_sensors.py": "The sensors, beside Stone Soup",
    "bench_effects.py": "Effects, named or not",
    "bench_asterix.py": "ASTERIX records",
    "bench_show.py": "Decoding and showing, beside asterix-decoder",
    "bench_sapient.py": "SAPIENT messages",
    "bench_formats.py": "Formats",
    "bench_telemetry.py": "Telemetry",
    "bench_live.py": "Live sources, beside pymavlink",
    "bench_impairment.py": "Impaired links",
    "bench_start.py": "Start",
    "bench_lateness.py": "Lateness",
    "bench_delivery.py": "Delivery",
    "bench_engine.py": "The engine under load",
    "bench_scaling.py": "Scale",
    "bench_simulated.py": "Simulated time",
    "bench_sweep.py": "Sweeps",
    "bench_fleet.py": "A fleet",
    "bench_mqtt.py": "MQTT clients",
    "bench_page.py": "The live page",
    "bench_log.py": "Recordings",
    "bench_score.py": "Scoring a tracker, beside Stone Soup",
    "bench_replay.py": "Replays, beside C and ast-tool-py",
}
LIBRARIES = ("numpy", "scipy", "protobuf", "pydantic", "mcap", "zstandard")


def head() -> str:
    """Machine and versions."""
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    return f"""# Benchmarks

Written by `make bench`, which takes three quarters of an hour. These are figures of one machine,
which may have done other work at the same time: trust the ratios more than the numbers. No test
depends on them.

- Machine: {os.cpu_count()} cores, {platform.system()}; the processor is named in each section.
- Python {platform.python_version()}, {libraries}
"""


def section(file: str, title: str) -> str:
    """One benchmark's own words, with when it ran and how busy the machine was."""
    print(file, flush=True)
    load = os.getloadavg()[0]
    out = subprocess.run(
        [sys.executable, HERE / file], check=True, stdout=subprocess.PIPE, text=True
    ).stdout
    words = (HERE / file).read_text().split('"""')[1]
    summary = words.partition("\n")[0]
    when = f"{datetime.now(UTC):%Y-%m-%d}; {processor()}; load average before it {load:.1f}"
    return f"\n## {title}\n\n{summary} (`tools/benchmarks/{file}`; {when})\n\n{out}"


def sections_before() -> dict[str, str]:
    """What the page holds, by title."""
    _, *found = f"\n{PAGE.read_text()}".split("\n## ")
    return {part.partition("\n")[0]: f"\n## {part.rstrip()}\n" for part in found}


def main() -> None:
    """Write the page."""
    wanted, before = set(sys.argv[1:]), sections_before()
    parts = [head()]
    for file, title in BENCHMARKS.items():
        if not wanted or file in wanted:
            parts.append(section(file, title))
        elif title in before:
            parts.append(before[title])
        PAGE.with_suffix(".new").write_text("".join(parts))
    PAGE.with_suffix(".new").replace(PAGE)


if __name__ == "__main__":
    main()
