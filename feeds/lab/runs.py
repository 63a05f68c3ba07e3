"""Runs of scenes at levels of their keys: handed out to processes, and kept in a journal."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import signal
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from multiprocessing import get_context
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, Self, TypeVar

from plotfeed.feeds.console.cluster import EngineError, connected
from plotfeed.feeds.console.posix import lock
from plotfeed.feeds.console.printed import naming, say, with_progress
from plotfeed.feeds.lab.lab_settings import RunsAsked
from plotfeed.feeds.recording.recorder import files_of
from plotfeed.feeds.scene.levels import SweepLevel
from plotfeed.feeds.scene.scene import parsed
from plotfeed.feeds.scene.world_keys import HORIZONS
from plotfeed.proto.errors import PlotfeedError

TRIES = 4  # Of a job whose process dies
AHEAD = 2  # Jobs for each processor that are handed out: one is worked on, and one waits

Job = TypeVar("Job")
Result = TypeVar("Result")


def spread(
    work: Callable[[Job], Result],
    jobs: Iterable[Job],
    *,
    address: str | None = None,
    processes: int | None = None,
) -> Generator[tuple[Job, Result], None, None]:
    """Each job and what `work` made of it, in the order in which they are done.

    Where one process is asked for, and no cluster, that is this one; more, or as many as there are
    processors, are those of this machine, and `address` is that of a cluster of Ray's. A job whose
    process dies is done again, by another; after some deaths, `EngineError` is raised, as is every
    `PlotfeedError` of `work` with its text.
    """
    if address is not None:
        yield from _by_ray(work, jobs, address)
    elif processes == 1:
        for job in jobs:
            yield job, work(job)
    else:
        yield from _by_processes(work, jobs, processes or os.cpu_count() or 1)


def _by_processes(
    work: Callable[[Job], Result], jobs: Iterable[Job], processes: int
) -> Generator[tuple[Job, Result], None, None]:
    """Each job and its result by processes of this machine, each with one job at a time."""
    context, begun = get_context("spawn"), list[Any]()

    def started() -> Any:
        here, there = context.Pipe()
        process = context.Process(target=_work_on, args=(work, there), daemon=True)
        process.start()
        begun.append(process)
        there.close()  # so that it ends with its process
        return here

    left = ((job, 1) for job in jobs)
    again: list[tuple[Job, int]] = []
    at_work: dict[Any, tuple[Job, int]] = {}
    idle: list[Any] = []
    try:
        while True:
            while len(at_work) < processes:
                task = again.pop() if again else next(left, None)
                if task is None:
                    break
                pipe = idle.pop() if idle else started()
                pipe.send(task[0])
                at_work[pipe] = task
            if not at_work:
                return
            ready: list[Any] = wait(list(at_work))
            for pipe in ready:
                job, tries = at_work.pop(pipe)
                try:
                    result, refused = pipe.recv()
                except EOFError:
                    if tries == TRIES:
                        raise EngineError(f"{TRIES} processes died of one job: {job}") from None
                    again.append((job, tries + 1))
                    continue
                idle.append(pipe)
                if refused is not None:
                    raise PlotfeedError(refused)
                yield job, result
    finally:
        for process in begun:
            process.terminate()
            process.join()


def _work_on(work: Callable[[Job], Result], pipe: Any) -> None:
    """Do one job after the other; Ctrl-C is for whoever hands them out."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(EOFError):
        while True:
            pipe.send(_told(work)(pipe.recv()))


def _by_ray(
    work: Callable[[Job], Result], jobs: Iterable[Job], address: str
) -> Generator[tuple[Job, Result], None, None]:
    """Each job and its result by tasks of a cluster of Ray, as `spread` gives them."""
    with connected(address) as ray:
        task = ray.remote(num_cpus=1, max_retries=TRIES - 1)(_told(work))
        processors = max(1, int(ray.cluster_resources().get("CPU", 1)))
        left, handed_out = iter(jobs), dict[Any, Job]()
        while True:
            for job in islice(left, AHEAD * processors - len(handed_out)):
                handed_out[task.remote(job)] = job
            if not handed_out:
                return
            done, _ = ray.wait(list(handed_out), num_returns=1)
            for each in done:
                job = handed_out.pop(each)
                try:
                    result, refused = ray.get(each)
                except ray.exceptions.WorkerCrashedError:
                    raise EngineError(f"{TRIES} processes died of one job: {job}") from None
                if refused is not None:
                    raise PlotfeedError(refused)
                yield job, result


def _told(work: Callable[[Job], Result]) -> Callable[[Job], tuple[Result | None, str | None]]:
    """`work` that hands back the text of an error: not all of them can be pickled."""

    def done(job: Job) -> tuple[Result | None, str | None]:
        try:
            return work(job), None
        except PlotfeedError as error:
            return None, str(error)

    return done


def digests(levels: Iterable[SweepLevel]) -> dict[str, str]:
    """SHA-256 of each scene's text and of the files that it names, by the scene's name.

    Raises `PlotfeedError` for a file that is not there.
    """
    found = {}
    for name, level in {level.scene: level for level in levels}.items():
        scene = parsed(level.text.encode(), Path(level.file))
        files = [file for file in files_of(scene) if file != HORIZONS]
        if scene.terrain is not None:
            files += [*scene.terrain.elevation, *scene.terrain.buildings]
        digest = hashlib.sha256(level.text.encode())
        for each in files:
            with scene.file(each).open("rb") as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
        found[name] = digest.hexdigest()
    return found


NAME = "journal.jsonl"
SEEDS = 1 << 63  # After the last of them comes 0 again


def seed_of(first: int, run: int) -> int:
    """The seed of a run, the same at every level: `first`, and the next whole numbers."""
    return (first + run) % SEEDS


@dataclass(frozen=True, slots=True, kw_only=True)
class RunJob:
    """A run of a level, with what all runs have in common; a number has one seed at all levels."""

    level: SweepLevel
    run: int
    seed: int
    plan: Any

    def __str__(self) -> str:
        return f"run {self.run} of {self.level}"


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
            try:
                lock(self._file.fileno())
            except OSError:
                raise PlotfeedError(f"{self.path}: another process works on it") from None
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
            keys = [] if n else sorted(found.keys() | plan.keys())
            if other := [key for key in keys if found.get(key) != plan.get(key)]:
                raise PlotfeedError(
                    f"{self.path}: begun with other {', '.join(other)}; --force begins anew, "
                    "and another folder leaves it alone"
                )
            if n:
                self.done[found["level"], found["run"]] = found
            whole += len(line)
        if not whole and len(lines) > 1:
            raise PlotfeedError(f"{self.path}: is no journal of runs")
        self._file.truncate(whole)
        if not whole:
            self._write(plan)

    def _write(self, line: Mapping[str, Any]) -> None:
        with naming(str(self.path)):
            left = memoryview(json.dumps(line).encode() + b"\n")
            while left:
                left = left[self._file.write(left) :]


def finish_runs(
    kept: Journal,
    work: Callable[[RunJob], dict[str, Any]],
    levels: Sequence[SweepLevel],
    asked: RunsAsked,
    plan: Any,
    *,
    runs: int,
) -> None:
    """Do those of so many runs of each level that are not done yet, and keep the result of each.

    A bar says how far they are. Ctrl-C ends it with a line on what is kept.
    """
    jobs = [
        RunJob(level=level, run=run, seed=seed_of(asked.seed, run), plan=plan)
        for level, run in kept.missing(levels, runs)
    ]
    every = len(levels) * runs
    count = every - len(jobs)

    def counted(results: Iterable[tuple[Any, dict[str, Any]]]) -> Iterator[None]:
        nonlocal count
        for _, result in results:
            kept.take(result)
            count += 1
            yield

    processes = asked.processes_of(len(jobs))
    try:
        with closing(spread(work, jobs, address=asked.ray, processes=processes)) as results:
            progress = with_progress(counted(results), "runs", lambda: count, every, look_every=1)
            for _ in progress if jobs else ():
                pass
    except KeyboardInterrupt:
        say(
            f"plotfeed: {count} of {every} runs are kept in {kept.path}; the same command goes on "
            "from there",
            err=True,
        )
        raise
