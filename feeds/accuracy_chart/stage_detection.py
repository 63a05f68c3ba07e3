"""Detection: from mean signal-to-noise ratios to which targets are detected."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from plotfeed.feeds.accuracy_chart.case import Case
from plotfeed.feeds.accuracy_chart.detection_methods import counted
from plotfeed.feeds.accuracy_chart.laws import AnyFloats, detection_law
from plotfeed.feeds.accuracy_chart.stage import PD, Alternative, ChartStage, rms
from plotfeed.models.detection import draw_hits
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Bools, Floats

OURS = "closed form"
MOST_NUMBERS = 1 << 20
"""That one call of a Monte Carlo may draw."""
Way = Callable[[], AnyFloats]


def detection_stage(case: Case) -> ChartStage | None:
    """Pd and a draw by it, or signals and a threshold; None for a sensor that always detects."""
    law = detection_law(case.model, case.seen_targets())
    judged = detection_law(case.model, case.anywhere_targets(case.effort.references))
    if law is None or judged is None:
        return None
    n = min(case.effort.references, len(case.anywhere))
    exact = np.array([float(judged.exact(row)) for row in range(n)])
    found = [_by_pd(OURS, law.ours, _error(judged.ours(), exact), case, ours=True)]
    for name, way in law.others.items():
        found.append(_by_pd(name, way, _error(judged.others[name](), exact), case))
    return ChartStage(
        name="detection",
        question="How to decide what is detected",
        alternatives=(*found, *_by_signals(case, judged.signals, exact), _everyone(case)),
    )


def _everyone(case: Case) -> Alternative:
    return Alternative(
        name="every target",
        run=lambda: None,
        units=len(case.seen),
        errors={PD: rms(1 - case.pd_anywhere)},
    )


def _error(pd: AnyFloats, exact: Floats) -> dict[str, float]:
    return {PD: rms(np.asarray(pd, dtype=np.float64) - exact)}


def _by_pd(
    name: str, way: Way, errors: dict[str, float], case: Case, *, ours: bool = False
) -> Alternative:
    rng = case.rng
    return Alternative(
        name=name,
        run=lambda: draw_hits(way(), rng),
        units=len(case.seen),
        errors=errors,
        ours=ours,
        needs_ratio=True,
    )


def _by_signals(case: Case, signals: int, exact: Floats) -> Iterator[Alternative]:
    """One trial that decides, right in law; and a Pd counted over many, if there is time for it."""
    hits, few = _hits(case, case.seen_targets, signals)
    if hits is not None:
        yield Alternative(
            name="signals, one trial",
            run=partial(hits, case.rng),
            units=few,
            errors={PD: 0.0},
            needs_ratio=True,
        )
    trials = case.effort.trials
    hits, few = _hits(case, case.seen_targets, signals * trials)
    judged, rows = _hits(case, case.anywhere_targets, signals * trials // 4)
    if hits is None or judged is None:
        return
    estimated = counted(judged, trials)(case.rng)
    yield Alternative(
        name=f"signals, {trials} trials",
        run=partial(_drawn, counted(hits, trials), case.rng),
        units=few,
        errors=_error(estimated, exact[:rows]),
        needs_ratio=True,
    )


def _drawn(pd: Callable[[np.random.Generator], Floats], rng: np.random.Generator) -> object:
    return draw_hits(pd(rng), rng)


def _hits(
    case: Case, targets: Callable[[int], Targets], numbers: int
) -> tuple[Callable[[np.random.Generator], Bools] | None, int]:
    """Of so few targets, at so many numbers each, that a call lasts no longer than a moment."""
    few = min(MOST_NUMBERS // max(numbers, 1), case.effort.references)
    some = targets(few)
    law = detection_law(case.model, some) if few else None
    return (law.hits, len(some)) if law is not None else (None, 0)
