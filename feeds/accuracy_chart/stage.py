"""A stage of the work, the methods by which it can be done, and what each of them costs."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from plotfeed.models.state import Floats

PD = "pd"
FALSE_ALARMS = "false_alarms"
MEASURED = ("range_m", "bistatic_range_m", "azimuth_deg", "elevation_deg")
"""Of everything in which a tracker can see an error, what is measured of a target."""
WORDS = {
    "range_m": "{} m",
    "bistatic_range_m": "{} m of path",
    "azimuth_deg": "{}° az",
    "elevation_deg": "{}° el",
    "pd": "Pd {}",
    "false_alarms": "{} alarms",
}
NEGLIGIBLE = 1e-12
"""Less than that is rounding."""
Call = Callable[[], object]
MOST_CALLS = 100_000
FINE_S = 1e-6
now_ns = (
    time.thread_time_ns
    if time.get_clock_info("thread_time").resolution <= FINE_S
    else time.perf_counter_ns
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """How much is done: a chart for a document, or a quick one."""

    targets: int
    """Seen at once."""
    pool: int
    """Places drawn, of which the targets are some."""
    references: int
    """Places at which 50 digits are computed."""
    rounds: int
    """Turns in which every method is timed."""
    seconds: float
    """Of one method in one turn, at least."""
    trials: int
    """Of a Monte Carlo for one probability."""
    batches: tuple[int, ...]
    """Numbers of targets at once between which costs are compared."""

    @classmethod
    def usual(cls, targets: int) -> Effort:
        """Some ten seconds a sensor."""
        return cls(
            targets=targets,
            pool=20_000,
            references=300,
            rounds=9,
            seconds=0.004,
            trials=1000,
            batches=(1, 3, 10, 30, 100, 300, 1000, 3000, 10_000, 30_000),
        )

    @classmethod
    def quick(cls, targets: int) -> Effort:
        """A second or so: that everything works."""
        return cls(
            targets=min(targets, 200),
            pool=3000,
            references=40,
            rounds=3,
            seconds=0.0005,
            trials=200,
            batches=(1, 10, 100),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """A call that does `units` target-scans, and the errors that it makes.

    `errors` are rms over the scene's places, by quantity; zero for what is right by definition or
    in law. `ours` is what the engine does for this scene.
    """

    name: str
    run: Call
    units: int
    errors: Mapping[str, float]
    ours: bool = False
    gives_ratio: bool = True
    """Whether a signal-to-noise ratio comes out of it."""
    needs_ratio: bool = False
    """Whether one must come in."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartStage:
    """Methods that do the same work."""

    name: str
    question: str
    methods: tuple[Method, ...]

    @classmethod
    def of(
        cls,
        name: str,
        question: str,
        methods: Iterable[tuple[str, Call, Mapping[str, float]]],
        *,
        units: int,
        ours: str,
        need_ratio: Container[str] = (),
    ) -> ChartStage:
        """Methods of so many target-scans each, given by name, call and errors."""
        made = (
            Method(
                name=method,
                run=run,
                units=units,
                errors=errors,
                ours=method == ours,
                needs_ratio=method in need_ratio,
            )
            for method, run, errors in methods
        )
        return cls(name=name, question=question, methods=tuple(made))


@dataclass(frozen=True, slots=True)
class Time:
    """Nanoseconds per target-scan over the turns, the middle half of which is from low to high."""

    median_ns: float
    low_ns: float
    high_ns: float

    @classmethod
    def of(cls, turns_ns: Floats) -> Time:
        """Quantiles of the means of the turns."""
        low_ns, median_ns, high_ns = np.quantile(turns_ns, (0.25, 0.5, 0.75)).tolist()
        return cls(median_ns, low_ns, high_ns)


def rms(values: Floats) -> float:
    """Root of the mean square, over what is finite; 0 of nothing."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0


def share_of_own(errors: Mapping[str, float], own: Mapping[str, float]) -> float:
    """The largest error beside the sensor's own in that quantity."""
    return max((_share(error, own.get(name, 0.0)) for name, error in errors.items()), default=0.0)


def _share(error: float, own: float) -> float:
    if own > 0:
        return error / own
    return 0.0 if error == 0 else float("inf")


def errors_text(errors: Mapping[str, float]) -> str:
    """Such as: 16 m, 0.15° az, Pd 0.008; what is only rounding is not told."""
    told = {name: error for name, error in errors.items() if error > NEGLIGIBLE}
    return (
        ", ".join(WORDS.get(name, "{}").format(f"{e:.2g}") for name, e in told.items())
        or "no error"
    )


def share_text(share: float | None) -> str:
    """A share of the sensor's own error."""
    if share is None:
        return "all"
    if share >= 100:
        return f"{share:,.0f}"
    return f"{share:.2g}" if share > NEGLIGIBLE else "0"


def ns_text(ns: float) -> str:
    """Three figures."""
    return f"{ns:,.0f}" if ns >= 100 else f"{ns:.3g}"


def in_turns(calls: Sequence[Call], *, rounds: int, seconds: float) -> Floats:
    """Nanoseconds of each call, mean of a turn; (rounds, calls). A turn lasts at least `seconds`.

    Garbage is not collected meanwhile: when that happens has nothing to do with who is timed.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        counts = [_count(call, seconds) for call in calls]
        turns = [
            [_mean_ns(call, count) for call, count in zip(calls, counts, strict=True)]
            for _ in range(rounds)
        ]
    finally:
        if was_enabled:
            gc.enable()
    return np.array(turns, dtype=np.float64).reshape(rounds, len(calls))


def _count(call: Call, seconds: float) -> int:
    """How often a call goes into that time; it has then been warmed up."""
    call()
    return int(np.clip(seconds * 1e9 / max(_mean_ns(call, 1), 1.0), 1, MOST_CALLS))


def _mean_ns(call: Call, count: int) -> float:
    start_ns = now_ns()
    for _ in range(count):
        call()
    return (now_ns() - start_ns) / count
