"""What benchmarks have alike: how they say what they found, and how they ask other libraries."""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import time
import venv
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # What benchmarks share with tests


def aim(what: str, limit: str, found: str, *, is_met: bool) -> str:
    """A line of the page, which `tests/test_docs.py` knows."""
    return f"- Aim: {what}, {limit}: {'met' if is_met else '**missed**'}, {found}."


def spread(values: Iterable[float], form: str = ".2f") -> str:
    """The median of runs, and the least to the most."""
    each = list(values)
    return f"{statistics.median(each):{form}} ({min(each):{form}} to {max(each):{form}})"


def ratios(ours: Sequence[float], theirs: Sequence[float]) -> list[float]:
    """How many times the other ours is, run by run: each has one of its own beside it."""
    return [a / b for a, b in zip(ours, theirs, strict=True)]


def table(head: Sequence[object], rows: Iterable[Sequence[object]], words: int = 1) -> None:
    """Prints a table, each row as it comes; its first columns are words, the others numbers."""
    print(_row(head), "|" + "---|" * words + "--:|" * (len(head) - words), sep="\n")
    for row in rows:
        print(_row(row), flush=True)


def _row(cells: Iterable[object]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def in_turns(
    sizes: Iterable[int], repeats: int, ways_at: Callable[[int], Mapping[str, Callable[[], float]]]
) -> dict[tuple[str, int], list[float]]:
    """What each of the ways takes at each size, run by run; of a size they take turns."""
    found: dict[tuple[str, int], list[float]] = defaultdict(list)
    for n in sizes:
        ways = ways_at(n)
        for _ in range(repeats):
            for name, way in ways.items():
                found[name, n].append(way())
    return found


def by_size(
    title: str, sizes: Iterable[object], rows: Mapping[str, Iterable[list[float]]], form: str = ""
) -> None:
    """Prints a table of runs: a row a way, a column a size."""
    cells = ([name, *(spread(runs, form or ".2f") for runs in row)] for name, row in rows.items())
    table([title, *sizes], cells)


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


def python_with(name: str, *packages: str) -> Path:
    """The interpreter of an environment with those; it is made where it is missing."""
    folder = Path(__file__).parents[2] / name
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    quiet = ("--quiet", "--disable-pip-version-check")
    subprocess.run([python, "-m", "pip", "install", *quiet, *packages], check=True)
    return python


class Other:
    """Another library in a process of its own: `script serve` answers questions, a line each."""

    def __init__(self, python: str | Path, script: str) -> None:
        self._process = subprocess.Popen(
            [python, script, "serve"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def ask(self, **question: Any) -> Any:
        """The answer to a question."""
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.write(json.dumps(question) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def close(self) -> None:
        """Ends the process."""
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait(10)


def cpu_s(pid: int) -> float:
    """Processor time of a process so far."""
    # Fields 14 and 15, counted from after the name, which may hold blanks; see proc(5).
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def processor_s(command: Sequence[object], **how: Any) -> float:
    """Processor time of a command, which is to end well."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([str(word) for word in command], check=True, **how)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


YARDSTICK = """A yardstick is a fixed piece of work, half of it Python's and half NumPy's, measured
in the same runs: what another machine may be compared by."""


def yardstick_us() -> float:
    """Processor time of the yardstick, microseconds; mean of some."""
    import numpy as np  # some who read this file run where it is not

    chance, turns = np.random.default_rng(1), 200
    start = time.process_time()
    for _ in range(turns):
        found = {f"{i}": i * 0.5 for i in range(1000)}
        total = sum(found.values()) + float(np.sort(chance.standard_normal(5000)).sum())
    assert total > 0
    return (time.process_time() - start) / turns * 1e6
