"""Batch sizes: what a target costs when it comes in company."""

from __future__ import annotations

from functools import partial

import numpy as np

from plotfeed.feeds.chart.case import Case
from plotfeed.feeds.chart.sample import targets_at
from plotfeed.feeds.chart.stage import Time
from plotfeed.feeds.chart.stopwatch import in_turns


def batches(case: Case) -> dict[int, Time]:
    """Nanoseconds per target-scan of the sensor's model, by the number of targets at once.

    From where they are seen to what is measured of those that are detected: nearly all of them.
    """
    rng, sizes = case.rng, case.effort.batches
    calls = []
    for n in sizes:
        some = case.seen.drawn(rng.integers(0, len(case.seen), n))
        targets = targets_at(some, case.frame, case.flown.signatures)
        calls.append(partial(case.model.observe, targets, rng))
    turns_ns = in_turns(calls, rounds=case.effort.rounds, seconds=case.effort.seconds)
    each_ns = turns_ns / np.array(sizes)
    return {n: Time.of(column) for n, column in zip(sizes, each_ns.T, strict=True)}
