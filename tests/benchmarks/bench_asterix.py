"""Microseconds per CAT048 record, ours and libasterix's, taken in turns in the same run.

    python tests/benchmarks/bench_asterix.py

libasterix runs in `.venv-libasterix`, which is made where it is missing. Both make the same
octets from the same plots; that is checked first. A record has items 010, 140, 020, 040, 130 (PRL
and PAM) and 110.
"""

from __future__ import annotations

import json
import os
import platform
import statistics
import subprocess
import sys
import time
import venv
from collections.abc import Callable
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).parents[2]
OTHER = PROJECT / ".venv-libasterix"
LIBASTERIX = "libasterix==0.36.3"

SIZES = (1, 10, 40, 100, 1000, 10_000)
SIZES_OF_LIBASTERIX = (1, 10, 40, 1000)
AIMS = {1: 200, 10: 200, 40: 200, 1000: 2000}
"""Records at once, and how many times as fast as libasterix."""
REPEATS = 9
SECONDS_A_REPEAT = 0.05
SAC, SIC = 25, 3
ITEMS = tuple(f"I048/{item}" for item in ("010", "140", "020", "040", "130/PRL", "130/PAM", "110"))


def us_per_call(call: Callable[[], object], seconds: float) -> float:
    """Mean of as many calls as go into that time; at least one."""
    calls = 0
    start = now = time.perf_counter()
    while now - start < seconds or not calls:
        for _ in range(max(1, calls // 4)):
            call()
            calls += 1
        now = time.perf_counter()
    return (now - start) / calls * 1e6


def serve_libasterix() -> None:
    """In the other environment: one question a line, {"plots"} or {"us"}, one answer a line."""
    from asterix.generated import Cat_048_1_32  # noqa: PLC0415 - only there

    plots: list[tuple[float, ...]] = []

    def encoded(n: int) -> bytes:
        records = [
            Cat_048_1_32.cv_record.create(
                {
                    "010": (("SAC", SAC), ("SIC", SIC)),
                    "140": (seconds, "s"),
                    "020": ((1, 1, 0, 0, 0, None),),
                    "040": (("RHO", (rho, "NM")), ("THETA", (theta, "°"))),
                    "130": {"PRL": (prl, "°"), "PAM": (pam, "dBm")},
                    "110": (0, ("3DH", (height, "ft"))),
                }
            )
            for seconds, rho, theta, prl, pam, height in plots[:n]
        ]
        block: bytes = Cat_048_1_32.create(records).unparse().to_bytes()
        return block

    for line in sys.stdin:
        question = json.loads(line)
        if "plots" in question:
            plots = question["plots"]
            print(encoded(len(plots)).hex(), flush=True)
        else:
            n = question["us"]
            print(us_per_call(lambda: encoded(n), SECONDS_A_REPEAT), flush=True)  # noqa: B023


class Libasterix:
    """libasterix in a process of its own."""

    def __init__(self) -> None:
        python = OTHER / "bin" / "python"
        if not python.exists():
            venv.create(OTHER, with_pip=True)
            subprocess.run([python, "-m", "pip", "install", "--quiet", LIBASTERIX], check=True)
        self._process = subprocess.Popen(
            [python, __file__, "serve"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def ask(self, **question: Any) -> str:
        """The answer to a question."""
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.write(json.dumps(question) + "\n")
        self._process.stdin.flush()
        return self._process.stdout.readline().strip()

    def close(self) -> None:
        """Ends the process."""
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait(10)


def main() -> None:
    """Measures and prints a table."""
    import numpy as np  # noqa: PLC0415 - the other environment has none of these

    from plotfeed.proto.asterix.cat048 import CAT048  # noqa: PLC0415
    from plotfeed.proto.asterix.encode import CROSSOVER, Encoder, blocks_of  # noqa: PLC0415

    source: dict[str, float | str] = {"I048/010/SAC": SAC, "I048/010/SIC": SIC}
    report = dict.fromkeys(("RDP", "SPI", "RAB"), 0) | {"TYP": 1, "SIM": 1}
    encoder = Encoder(
        CAT048,
        (
            "I048/010",
            "I048/140",
            "I048/020",
            "I048/040",
            "I048/130/PRL",
            "I048/130/PAM",
            "I048/110",
        ),
        constants=source | {f"I048/020/{name}": value for name, value in report.items()},
    )
    rng = np.random.default_rng(1)
    most = max(SIZES)
    limits = [(0, 86_399), (0, 255), (0, 359), (0, 11), (-120, 0), (-500, 30_000)]
    plots = np.column_stack([rng.uniform(low, high, most) for low, high in limits])
    columns = dict(zip(encoder.columns, plots.T.copy(), strict=True))

    libasterix = Libasterix()
    theirs = libasterix.ask(plots=plots[: max(SIZES_OF_LIBASTERIX)].tolist())
    records = encoder.records({path: c[: max(SIZES_OF_LIBASTERIX)] for path, c in columns.items()})
    (block,) = blocks_of(48, records, encoder.record_length, 65535)
    assert block.hex() == theirs, "the two do not make the same octets"

    cut = {n: {path: column[:n] for path, column in columns.items()} for n in SIZES}
    row = plots[0].tolist()
    times: dict[tuple[str, int], list[float]] = {}
    for _ in range(REPEATS):
        one = us_per_call(lambda: encoder.record(*row), SECONDS_A_REPEAT)
        times.setdefault(("record", 1), []).append(one)
        for n in SIZES:
            us = us_per_call(lambda: encoder.records(cut[n]), SECONDS_A_REPEAT) / n  # noqa: B023
            times.setdefault(("records", n), []).append(us)
            if n in SIZES_OF_LIBASTERIX:
                times.setdefault(("libasterix", n), []).append(float(libasterix.ask(us=n)) / n)
    libasterix.close()

    print(f"{encoder.record_length} octets a record; µs a record: median (least to most) of")
    print(f"{REPEATS} repeats. {platform.machine()}, {os.cpu_count()} cores, {platform.system()};")
    print(f"Python {platform.python_version()}, NumPy {np.__version__}, {LIBASTERIX}.\n")
    print("| records | encoder | plotfeed | libasterix | ratio |\n|--:|---|--:|--:|--:|")
    print(_line(1, "record()", times[("record", 1)], times[("libasterix", 1)]))
    for n in SIZES:
        path = "records(), vector" if n >= CROSSOVER else "records(), scalar"
        print(_line(n, path, times[("records", n)], times.get(("libasterix", n))))
    print("\nAims, by records() as the plots of a sector go:", "; ".join(_verdicts(times)) + ".")


def _verdicts(times: dict[tuple[str, int], list[float]]) -> list[str]:
    """How each aim was met, in times as fast as libasterix."""
    verdicts = []
    for n, aim in AIMS.items():
        theirs, ours = times["libasterix", n], times["records", n]
        ratio = statistics.median(theirs) / statistics.median(ours)
        verdict = "met" if ratio >= aim else f"**missed**, {ratio:.0f}"
        verdicts.append(f"{aim:,} times at {n:,}: {verdict}")
    return verdicts


def _line(n: int, path: str, ours: list[float], theirs: list[float] | None) -> str:
    ratio = f"{statistics.median(theirs) / statistics.median(ours):.0f}" if theirs else ""
    return (
        f"| {n} | {path} | {_spread(ours, 3)} | {_spread(theirs, 0) if theirs else ''} | {ratio} |"
    )


def _spread(times: list[float], digits: int) -> str:
    middle = statistics.median(times)
    return f"{middle:.{digits}f} ({min(times):.{digits}f} to {max(times):.{digits}f})"


if __name__ == "__main__":
    serve_libasterix() if sys.argv[1:] == ["serve"] else main()
