"""Errors: from what is detected to how wrong it is measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from plotfeed.feeds.accuracy_chart.case import Case
from plotfeed.feeds.accuracy_chart.laws import ErrorLaw, error_law
from plotfeed.feeds.accuracy_chart.stage import Alternative, ChartStage
from plotfeed.models.state import Floats

FLUCTUATING, STEADY = "exact draw, given the hit", "by the level"
FLOOR_ONLY = "floor only"
Rng = np.random.Generator
Sigmas = Callable[[Floats], Mapping[str, Floats]]


def errors(case: Case) -> ChartStage | None:
    """Ratios of detections, sigmas and noise; None for a sensor whose errors are always alike."""
    law = error_law(case.model, case.seen_targets())
    if law is None:
        return None
    true = law.sigmas(1 / law.inverse)
    ways: dict[str, tuple[Sigmas, Callable[[Rng], Floats]]] = {}
    if law.draw is not None:
        ways[FLUCTUATING] = law.sigmas, law.draw
    ways[STEADY if law.draw is None else "by the mean ratio"] = law.sigmas, lambda _: law.mean_snr
    if law.printed is not None:
        ways["mean ratio, as printed"] = law.printed, lambda _: law.mean_snr
    strong = np.full(len(law.mean_snr), np.inf)
    ways[FLOOR_ONLY] = law.sigmas, lambda _: strong
    ours = next(iter(ways))
    return ChartStage(
        name="errors",
        question="How to draw the errors of measurements",
        alternatives=tuple(
            Alternative(
                name=name,
                run=partial(_noise, sigmas, ratios, case.rng),
                units=len(case.seen),
                errors=_missing(sigmas(_effective(name, law, strong)), true),
                ours=name == ours,
                needs_ratio=name != FLOOR_ONLY,
            )
            for name, (sigmas, ratios) in ways.items()
        ),
    )


def _effective(name: str, law: ErrorLaw, strong: Floats) -> Floats:
    """The ratio that gives the rms errors of a way, over many detections of each target."""
    if name == FLUCTUATING:
        return 1 / law.inverse  # right in law
    return strong if name == FLOOR_ONLY else law.mean_snr


def _missing(sigmas: Mapping[str, Floats], true: Mapping[str, Floats]) -> dict[str, float]:
    """What, in quadrature, makes the true rms errors of those of a way, or the other way round."""
    return {
        name: float(np.sqrt(np.mean(np.abs(sigmas[name] ** 2 - value**2))))
        for name, value in true.items()
    }


def _noise(sigmas: Sigmas, ratios: Callable[[Rng], Floats], rng: Rng) -> object:
    """The errors of one look at each target, by quantity."""
    return [sigma * rng.standard_normal(len(sigma)) for sigma in sigmas(ratios(rng)).values()]
