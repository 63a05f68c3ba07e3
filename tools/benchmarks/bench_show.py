"""Processor time of decoding and showing recordings, beside asterix-decoder, in turns in one run.

    python tools/benchmarks/bench_show.py [RECORDS]

asterix-decoder (GPL-3, C++) is asked by its own Python module in `.venv-asterix-decoder`; where
that is missing, its columns are empty. Both read the same file of raw ASTERIX, by turns; both print
into nothing. A ratio is theirs over ours of the same turn. Start is that of Python and imports,
which is in the other figures.
"""

from __future__ import annotations

import os
import platform
import statistics
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from subprocess import DEVNULL

import numpy as np
from aims import aim, processor_s, ratios, spread
from asterix_cases import CASES, SAC, SIC

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.encode import Encoder, blocks_of

RECORDS = 50_640
REPEATS = 3
ROWS_A_BLOCK = 25
MEASURED = (48, 62, 15, 205)

OURS_DECODE = """
import sys
from plotfeed.proto.asterix.codec.decode import blocks, records_in
data = open(sys.argv[1], "rb").read()
for block in blocks(data):
    for record in records_in(block):
        pass
"""
_THEIRS = """
import sys, asterix
data = open(sys.argv[1], "rb").read()
at = 0
while at < len(data):
    end = at + int.from_bytes(data[at + 1 : at + 3], "big")
    found = asterix.parse(data[at:end], verbose=False)
    {then}
    at = end
"""
DECODER = Path(__file__).parents[2] / ".venv-asterix-decoder" / "bin" / "python"
THEIRS_DECODE = _THEIRS.format(then="pass")
THEIRS_SHOW = _THEIRS.format(then="[print(record) for record in found]")
COMMAND = (sys.executable, "-m", "plotfeed.feeds.cli", "show")
STEPS: dict[str, tuple[Sequence[str], Sequence[str], Sequence[str]]] = {
    "start": ((sys.executable, "-c", "import plotfeed.proto.asterix.codec.decode"), (), ()),
    "decode": ((sys.executable, "-c", OURS_DECODE), (), (str(DECODER), "-c", THEIRS_DECODE)),
    "show --list": (COMMAND, ("--list",), (str(DECODER), "-c", THEIRS_SHOW)),
    "show": (COMMAND, (), ()),
    "show --verbose": (COMMAND, ("--verbose",), ()),
}


def file_of(number: int, records: int) -> bytes:
    """Blocks of records that have the items which the report encoders send."""
    case, name = CASES[number], f"I{number:03}/"
    encoder = Encoder(
        CATEGORIES[number],
        [name + path for path in case.paths.split()],
        constants={
            name + path: value
            for path, value in ({"010/SAC": SAC, "010/SIC": SIC} | case.constants).items()
        },
    )
    rng = np.random.default_rng(1)
    columns = {
        name + path: rng.integers(low, high, records, endpoint=True)
        if isinstance(low, int)
        else rng.uniform(low, high, records)
        for path, (low, high) in case.columns.items()
    }
    octets, length = encoder.records(columns), encoder.record_length
    return b"".join(blocks_of(number, octets, length, 3 + ROWS_A_BLOCK * length))


def main(records: int) -> None:
    """Measures and prints a table."""
    has_theirs = DECODER.exists()
    print(f"Seconds of processor time for {records} records: median (least to most) of {REPEATS}")
    print(f"repeats. {platform.machine()}, {os.cpu_count()} cores; Python", end=" ")
    print(f"{platform.python_version()}.\n")
    print("| category | what | plotfeed | asterix-decoder | ratio |")
    print("|--:|---|--:|--:|--:|")
    aims = []
    with tempfile.TemporaryDirectory() as folder:
        for number in MEASURED:
            path = Path(folder) / f"{number:03d}.ast"
            path.write_bytes(file_of(number, records))
            for what, (ours, options, theirs) in STEPS.items():
                mine, others = [], []
                for _ in range(REPEATS):
                    mine.append(processor_s([*ours, path, *options], stdout=DEVNULL))
                    if theirs and has_theirs:
                        others.append(processor_s([*theirs, path], stdout=DEVNULL))
                print(_line(number, what, mine, others), flush=True)
                if what == "decode" and others:
                    aims.append(_aim(number, mine, others))
    print("\n" + "\n".join(aims) if aims else "")


def _line(number: int, what: str, mine: list[float], others: list[float]) -> str:
    theirs = spread(others) if others else ""
    faster = spread(ratios(others, mine)) if others else ""
    return f"| {number:03} | {what} | {spread(mine)} | {theirs} | {faster} |"


def _aim(number: int, mine: list[float], others: list[float]) -> str:
    times = ratios(others, mine)
    what = f"reading {number:03}"
    found = f"{spread(times)} times as fast"
    return aim(what, "no slower than asterix-decoder", found, is_met=statistics.median(times) >= 1)


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else RECORDS)
