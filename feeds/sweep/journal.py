"""What is done of many runs, on disk: a line of JSON each, so that a killed sweep goes on."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Self

from plotfeed.feeds.console.posix import lock
from plotfeed.feeds.console.printed import naming, say
from plotfeed.feeds.console.status_line import with_progress
from plotfeed.feeds.sweep.levels import SweepLevel
from plotfeed.feeds.workers.spread import spread
from plotfeed.proto.errors import PlotfeedError

NAME = "journal.jsonl"
SEEDS = 1 << 63
"""After the last of them comes 0 again."""


def seed_of(first: int, run: int) -> int:
    """The seed of a run, the same at every level: `first`, and the next whole numbers."""
    return (first + run) % SEEDS


class Journal:
    """A file of runs that are done, by level and run. One process at a time writes to it.

    A line is written at once: whatever ends the process, what is there is whole up to the last
    line, and a part of one is cut off when the file is opened again.
    """

    def __init__(self, path: Path, plan: Mapping[str, Any], *, anew: bool = False) -> None:
        """`plan` is what runs must have in common; `anew` forgets those of before.

        Raises `PlotfeedError` if the file is of another plan, or in use.
        """
        self.path = path
        self.done: dict[tuple[int, int], dict[str, Any]] = {}
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a+b", buffering=0)
        try:
            self._hold()
            if anew:
                self._file.truncate(0)
            self._read(json.loads(json.dumps(plan)))
        except BaseException:
            self._file.close()
            raise

    def take(self, result: dict[str, Any]) -> None:
        """Keep the result of a run, which says of which level and run it is."""
        self._write(result)
        self.done[result["level"], result["run"]] = result

    def missing(self, levels: Sequence[SweepLevel], runs: int) -> list[tuple[SweepLevel, int]]:
        """Level and number of each run that is not done, the first run of all levels first."""
        wanted = ((level, run) for run in range(runs) for level in levels)
        return [(level, run) for level, run in wanted if (level.number, run) not in self.done]

    def of_first(self, runs: int) -> dict[tuple[int, int], dict[str, Any]]:
        """Results of so many runs of each level, in their order; more may be kept."""
        return {key: self.done[key] for key in sorted(self.done) if key[1] < runs}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def _hold(self) -> None:
        try:
            lock(self._file.fileno())
        except OSError:
            raise PlotfeedError(f"{self.path}: another process works on it") from None

    def _read(self, plan: dict[str, Any]) -> None:
        self._file.seek(0)
        lines = self._file.read().splitlines(keepends=True)
        whole = 0
        for n, line in enumerate(lines):
            found = None
            with contextlib.suppress(ValueError):
                found = json.loads(line) if line.endswith(b"\n") else None
            if not isinstance(found, dict):
                break
            if not n:
                self._check(found, plan)
            else:
                self.done[found["level"], found["run"]] = found
            whole += len(line)
        if not whole and len(lines) > 1:
            raise PlotfeedError(f"{self.path}: is no journal of runs")
        self._file.truncate(whole)
        if not whole:
            self._write(plan)

    def _check(self, before: dict[str, Any], plan: dict[str, Any]) -> None:
        other = [key for key in before.keys() | plan.keys() if before.get(key) != plan.get(key)]
        if other:
            raise PlotfeedError(
                f"{self.path}: begun with other {', '.join(sorted(other))}; --force begins anew, "
                "and another --out leaves it alone"
            )

    def _write(self, line: Mapping[str, Any]) -> None:
        with naming(str(self.path)):
            left = memoryview(json.dumps(line).encode() + b"\n")
            while left:
                left = left[self._file.write(left) :]


def keep_all(
    kept: Journal,
    work: Callable[[Any], dict[str, Any]],
    jobs: Sequence[Any],
    before: int,
    *,
    address: str | None,
    processes: int | None,
) -> None:
    """Spread jobs, and keep the result of each as it comes; a bar says how far they are.

    `before` are done already. Ctrl-C ends it with a line on what is kept.
    """
    count, every = before, before + len(jobs)

    def counted(results: Iterable[tuple[Any, dict[str, Any]]]) -> Iterator[None]:
        nonlocal count
        for _, result in results:
            kept.take(result)
            count += 1
            yield

    if not jobs:
        return
    try:
        with closing(spread(work, jobs, address=address, processes=processes)) as results:
            for _ in with_progress(counted(results), "runs", lambda: count, every, look_every=1):
                pass
    except KeyboardInterrupt:
        say(
            f"plotfeed: {count} of {every} runs are kept in {kept.path}; the same command goes on "
            "from there",
            err=True,
        )
        raise
