"""Microseconds per record of every category, ours and libasterix's, taken in turns in one run.

    python tools/benchmarks/bench_asterix.py [category ...]

libasterix runs in a process of its own. Both make the same octets from the same values; that is
checked first. libasterix has no category 129. A record has
the items that the report encoders send when everything is measured.
"""

from __future__ import annotations

import json
import os
import platform
import sys
from importlib.metadata import version

from aims import Other, ratios, spread, us_per_call
from asterix_cases import CASES, SAC, SIC, SOURCE, theirs

LIBASTERIX = f"libasterix {version('libasterix')}"

SIZES = (1, 10, 100, 1000)
REPEATS = 5
SECONDS_A_REPEAT = 0.03


def serve_libasterix() -> None:
    """In the other process: one question a line, {"rows"} or {"us"}, one answer a line."""
    from asterix import generated

    editions = {15: "1_2", 16: "1_0", 25: "1_6", 34: "1_29", 48: "1_32", 62: "1_21", 63: "1_7"}
    category, rows, number = None, [], 0

    def encoded(n: int) -> bytes:
        record = category.cv_record
        records = [record.create({"010": SOURCE} | theirs(number, row)) for row in rows[:n]]
        block: bytes = category.create(records).unparse().to_bytes()
        return block

    for line in sys.stdin:
        question = json.loads(line)
        if "rows" in question:
            number, rows = question["category"], question["rows"]
            category = getattr(generated, f"Cat_{number:03}_{editions.get(number, '1_0')}")
            print(json.dumps(encoded(len(rows)).hex()), flush=True)
        else:
            n = question["us"]
            print(us_per_call(lambda: encoded(n), SECONDS_A_REPEAT), flush=True)  # noqa: B023


def main(categories: list[int]) -> None:
    """Measures and prints a table."""
    import numpy as np

    libasterix = Other(sys.executable, __file__)
    print(f"µs a record: median (least to most) of {REPEATS} repeats in turns.")
    print(f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}; Python")
    print(f"{platform.python_version()}, NumPy {np.__version__}, {LIBASTERIX}.\n")
    print("| category | octets | records | plotfeed | libasterix | ratio |")
    print("|--:|--:|--:|--:|--:|--:|")
    for category in categories:
        measure(category, libasterix)
    libasterix.close()


def measure(number: int, libasterix: Other) -> None:
    """Prints the lines of one category."""
    import numpy as np

    from plotfeed.proto.asterix.categories import CATEGORIES
    from plotfeed.proto.asterix.codec.encode import Encoder, blocks_of

    case, name = CASES[number], f"I{number:03}/"
    constants = {"010/SAC": SAC, "010/SIC": SIC} | case.constants
    encoder = Encoder(
        CATEGORIES[number],
        [name + path for path in case.paths.split()],
        constants={name + path: value for path, value in constants.items()},
    )
    rng = np.random.default_rng(1)
    whole = {
        name + path: rng.integers(low, high, max(SIZES), endpoint=True)
        if isinstance(low, int)
        else rng.uniform(low, high, max(SIZES))
        for path, (low, high) in case.columns.items()
    }
    assert tuple(sorted(whole)) == tuple(sorted(encoder.columns)), encoder.columns
    known = number != 129
    if known:
        rows = list(zip(*(column.tolist() for column in whole.values()), strict=True))
        records = encoder.records(whole)
        (block,) = blocks_of(number, records, encoder.record_length, 65_535)
        other = libasterix.ask(category=number, rows=rows)
        assert block.hex() == other, "the two do not make the same octets"
    for n in SIZES:
        columns = {path: column[:n] for path, column in whole.items()}
        ours, others = [], []
        for _ in range(REPEATS):
            ours.append(us_per_call(lambda: encoder.records(columns), SECONDS_A_REPEAT) / n)  # noqa: B023
            if known:
                others.append(libasterix.ask(us=n) / n)
        print(_line(number, encoder.record_length, n, ours, others), flush=True)


def _line(number: int, octets: int, n: int, ours: list[float], others: list[float]) -> str:
    other = spread(others, ".0f") if others else "has none"
    ratio = spread(ratios(others, ours), ".0f") if others else ""
    return f"| {number:03} | {octets} | {n} | {spread(ours, '.3f')} | {other} | {ratio} |"


if __name__ == "__main__":
    if sys.argv[1:] == ["serve"]:
        serve_libasterix()
    else:
        main([int(argument) for argument in sys.argv[1:]] or list(CASES))
