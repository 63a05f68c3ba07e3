"""Runs every benchmark and writes docs/benchmarks.md; nothing is asserted.

python tests/benchmarks/write_benchmarks.py
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "benchmarks.md"
BENCHMARKS = {
    "bench_model.py": "The physics",
    "bench_sensors.py": "The sensors, beside Stone Soup",
    "bench_asterix.py": "ASTERIX records",
    "bench_sapient.py": "SAPIENT messages",
    "bench_impairment.py": "Impaired links",
    "bench_start.py": "Start",
    "bench_lateness.py": "Lateness",
    "bench_drift.py": "Drift",
    "bench_mqtt.py": "MQTT clients",
    "bench_page.py": "The live page",
    "bench_log.py": "Recordings",
    "bench_replay.py": "Replays, beside ast-tool-py",
}
LIBRARIES = ("numpy", "scipy", "protobuf", "pydantic", "gmqtt", "iotcore", "mcap", "zstandard")


def processor() -> str:
    """What the machine says that it is."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def head() -> str:
    """Machine, versions and date."""
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    return f"""# Benchmarks

Written by `make bench`, which takes a few minutes. These are figures of one machine, which did
other work at the same time: trust the ratios more than the numbers. No test depends on them.

- Date: {datetime.now(UTC):%Y-%m-%d}
- Machine: {processor()}, {os.cpu_count()} cores, {platform.system()}; load average before the start
  {os.getloadavg()[0]:.1f}
- Python {platform.python_version()}, {libraries}
"""


def section(file: str, title: str) -> str:
    """One benchmark's own words."""
    print(file, flush=True)
    out = subprocess.run(
        [sys.executable, HERE / file], check=True, stdout=subprocess.PIPE, text=True
    ).stdout
    summary = (HERE / file).read_text().partition('"""')[2].partition("\n")[0]
    return f"\n## {title}\n\n{summary} (`tests/benchmarks/{file}`)\n\n{out}"


def main() -> None:
    """Write the page."""
    PAGE.write_text(head() + "".join(section(*item) for item in BENCHMARKS.items()))


if __name__ == "__main__":
    main()
