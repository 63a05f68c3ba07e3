"""Microseconds per record of every category, ours and libasterix's, taken in turns in one run.

    python tools/benchmarks/bench_asterix.py [category ...]

libasterix runs in a process of its own. Both make the same octets from the same values; that is
checked first. libasterix has no category 129. A record has
the items that the report encoders send when everything is measured.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from importlib.metadata import version
from itertools import chain

from aims import Other, ratios, spread, table, us_per_call
from asterix_cases import CASES, SOURCE, encoded, theirs

LIBASTERIX = f"libasterix {version('libasterix')}"

SIZES = (1, 10, 100, 1000)
REPEATS = 5
SECONDS_A_REPEAT = 0.03


def serve_libasterix() -> None:
    """In the other process: one question a line, {"rows"} or {"us"}, one answer a line."""
    from asterix import generated

    editions = {15: "1_2", 16: "1_0", 25: "1_6", 34: "1_29", 48: "1_32", 62: "1_21", 63: "1_7"}
    category, rows, number = None, [], 0

    def made(n: int) -> bytes:
        record = category.cv_record
        records = [record.create({"010": SOURCE} | theirs(number, row)) for row in rows[:n]]
        block: bytes = category.create(records).unparse().to_bytes()
        return block

    for line in sys.stdin:
        question = json.loads(line)
        if "rows" in question:
            number, rows = question["category"], question["rows"]
            category = getattr(generated, f"Cat_{number:03}_{editions.get(number, '1_0')}")
            print(json.dumps(made(len(rows)).hex()), flush=True)
        else:
            n = question["us"]
            print(us_per_call(lambda: made(n), SECONDS_A_REPEAT), flush=True)  # noqa: B023


def main(categories: list[int]) -> None:
    """Measures and prints a table."""
    libasterix = Other(sys.executable, __file__)
    print(f"µs a record: median (least to most) of {REPEATS} repeats in turns. {LIBASTERIX}.\n")
    head = ("category", "octets", "records", "plotfeed", "libasterix", "ratio")
    table(head, chain.from_iterable(measure(each, libasterix) for each in categories), 0)
    libasterix.close()


def measure(number: int, libasterix: Other) -> Iterator[tuple[str, ...]]:
    """The lines of one category."""
    from plotfeed.proto.asterix.codec.encode import blocks_of

    encoder, whole = encoded(number, max(SIZES))
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
        words = f"{number:03}", f"{encoder.record_length}", f"{n}", spread(ours, ".3f")
        beside = map(spread, (others, ratios(others, ours)), (".0f", ".0f")) if known else ()
        yield *words, *(beside or ("has none", ""))


if __name__ == "__main__":
    if sys.argv[1:] == ["serve"]:
        serve_libasterix()
    else:
        main([int(argument) for argument in sys.argv[1:]] or list(CASES))
