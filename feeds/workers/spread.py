"""Jobs handed out to processes, here or on many hosts, and what comes of them as it comes."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from itertools import islice
from typing import Any, TypeVar

from plotfeed.feeds.workers.ray_engine import EngineError, connected
from plotfeed.proto.errors import PlotfeedError

TRIES = 4
"""Of a job whose process dies."""
AHEAD = 2
"""Jobs for each processor that are handed out: one is worked on, and one waits."""

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

    Where one process is asked for, and no cluster, that is this one. Else they are Ray's tasks, in
    so many processes or as many as there are processors; `address` is that of a cluster. A job
    whose process dies is done again, by another; after some deaths, `EngineError` is raised, as is
    every `PlotfeedError` of `work` with its text.
    """
    if processes == 1 and address is None:
        for job in jobs:
            yield job, work(job)
        return
    with connected(address, processes) as ray:
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
