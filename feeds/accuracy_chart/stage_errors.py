"""What noise does to plots: how wrong a detection is measured, and false alarms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from plotfeed.feeds.accuracy_chart.case import (
    Case,
    ErrorLaw,
    Rng,
    Sigmas,
    alarm_moments,
    error_law,
)
from plotfeed.feeds.accuracy_chart.stage import FALSE_ALARMS, ChartStage
from plotfeed.models.beam.scan import Timetable
from plotfeed.models.state import Floats

FLUCTUATING, STEADY = "exact draw, given the hit", "by the level"
FLOOR_ONLY = "floor only"
OUR_ALARMS = "binomial over cells"
SOME_SCAN = 1000


def errors_stage(case: Case) -> ChartStage | None:
    """Ratios of detections, sigmas and noise; None for a sensor whose errors are always alike."""
    law = error_law(case.model, case.seen_targets())
    if law is None:
        return None
    true = law.sigmas(1 / law.inverse)
    found: dict[str, tuple[Sigmas, Callable[[Rng], Floats]]] = {}
    if law.draw is not None:
        found[FLUCTUATING] = law.sigmas, law.draw
    found[STEADY if law.draw is None else "by the mean ratio"] = law.sigmas, lambda _: law.mean_snr
    if law.printed is not None:
        found["mean ratio, as printed"] = law.printed, lambda _: law.mean_snr
    strong = np.full(len(law.mean_snr), np.inf)
    found[FLOOR_ONLY] = law.sigmas, lambda _: strong
    return ChartStage.of(
        "errors",
        "How to draw the errors of measurements",
        [
            (
                name,
                partial(_noise, sigmas, ratios, case.rng),
                _missing(sigmas(_effective(name, law, strong)), true),
            )
            for name, (sigmas, ratios) in found.items()
        ],
        units=len(case.seen),
        ours=next(iter(found)),
        need_ratio=found.keys() - {FLOOR_ONLY},
    )


def _effective(name: str, law: ErrorLaw, strong: Floats) -> Floats:
    """The ratio that gives the rms errors of a method, over many detections of each target."""
    if name == FLUCTUATING:
        return 1 / law.inverse  # right in law
    return strong if name == FLOOR_ONLY else law.mean_snr


def _missing(sigmas: Mapping[str, Floats], true: Mapping[str, Floats]) -> dict[str, float]:
    """What, in quadrature, makes the true rms errors of those of a method, or the reverse."""
    return {
        name: float(np.sqrt(np.mean(np.abs(sigmas[name] ** 2 - value**2))))
        for name, value in true.items()
    }


def _noise(sigmas: Sigmas, ratios: Callable[[Rng], Floats], rng: Rng) -> object:
    """The errors of one look at each target, by quantity."""
    return [sigma * rng.standard_normal(len(sigma)) for sigma in sigmas(ratios(rng)).values()]


class PoissonGenerator(np.random.Generator):
    """Draws Poisson numbers where it is asked for binomial ones."""

    def binomial(self, n: Any, p: Any, size: Any = None) -> Any:
        """Poisson, of the same mean."""
        return self.poisson(np.multiply(n, p), size)


def false_alarms_stage(case: Case) -> ChartStage | None:
    """A whole scan's, shared between the targets at once; None for a sensor without any."""
    mean, variance = alarm_moments(case.model)
    if mean == 0 or FALSE_ALARMS not in case.own:
        return None
    excess = float(np.sqrt(mean - variance))  # of the Poisson number over the binomial one
    scan = case.sensor.scan
    turn = replace(Timetable(scan.period_ns, 1).sector(SOME_SCAN, 0), stares=not scan.rotates)
    draw, poisson = case.model.draw_false_alarms, PoissonGenerator(np.random.Philox(case.seed))
    return ChartStage.of(
        "false alarms",
        "How to draw false alarms",
        [
            ("off", lambda: None, {FALSE_ALARMS: mean}),
            ("Poisson", partial(draw, turn, poisson), {FALSE_ALARMS: excess}),
            (OUR_ALARMS, partial(draw, turn, case.rng), {FALSE_ALARMS: 0.0}),
        ],
        units=len(case.seen),
        ours=OUR_ALARMS,
    )
