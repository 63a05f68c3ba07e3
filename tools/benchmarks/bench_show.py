"""Processor time of decoding and showing recordings, beside asterix-decoder, in turns in one run.

    python tools/benchmarks/bench_show.py [RECORDS]

asterix-decoder (GPL-3, C++) is asked by its own Python module in `.venv-asterix-decoder`; where
that is missing, its columns are empty. Both read the same file of raw ASTERIX, by turns; both print
into nothing. A ratio is theirs over ours of the same turn. Start is that of Python and imports,
which is in the other figures.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from subprocess import DEVNULL

from aims import aim, processor_s, ratios, spread, table
from asterix_cases import encoded

from plotfeed.proto.asterix.codec.encode import blocks_of

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
    encoder, columns = encoded(number, records)
    octets, length = encoder.records(columns), encoder.record_length
    return b"".join(blocks_of(number, octets, length, 3 + ROWS_A_BLOCK * length))


def main(records: int) -> None:
    """Measures and prints a table."""
    has_theirs, aims = DECODER.exists(), []
    print(f"Seconds of processor time for {records} records: median (least to most) of {REPEATS}")
    print("repeats.\n")

    def rows(folder: Path) -> Iterator[tuple[str, ...]]:
        for number in MEASURED:
            path = folder / f"{number:03d}.ast"
            path.write_bytes(file_of(number, records))
            for what, (ours, options, theirs) in STEPS.items():
                mine, others = [], []
                for _ in range(REPEATS):
                    mine.append(processor_s([*ours, path, *options], stdout=DEVNULL))
                    if theirs and has_theirs:
                        others.append(processor_s([*theirs, path], stdout=DEVNULL))
                beside = (others, ratios(others, mine)) if others else ()
                cells = (spread(mine), *map(spread, beside), *("", "")[len(beside) :])
                yield f"{number:03}", what, *cells
                if what == "decode" and others:
                    aims.append(_aim(number, mine, others))

    with tempfile.TemporaryDirectory() as folder:
        table(("category", "what", "plotfeed", "asterix-decoder", "ratio"), rows(Path(folder)), 2)
    print("\n" + "\n".join(aims) if aims else "")


def _aim(number: int, mine: list[float], others: list[float]) -> str:
    times = ratios(others, mine)
    what = f"reading {number:03}"
    found = f"{spread(times)} times as fast"
    return aim(what, "no slower than asterix-decoder", found, is_met=statistics.median(times) >= 1)


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else RECORDS)
