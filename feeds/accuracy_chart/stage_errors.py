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
from plotfeed.feeds.accuracy_chart.stage import FALSE_ALARMS, ChartStage, Method
from plotfeed.feeds.scene.sensors.sensor_keys import RotatingScan
from plotfeed.models.beam.scan import Sector, nth_sector
from plotfeed.models.state import Floats
from plotfeed.proto.utc import NS

FLUCTUATING, STEADY = "exact draw, given the hit", "by the level"
FLOOR_ONLY = "floor only"
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
    ours = next(iter(found))
    return ChartStage(
        name="errors",
        question="How to draw the errors of measurements",
        methods=tuple(
            Method(
                name=name,
                run=partial(_noise, sigmas, ratios, case.rng),
                units=len(case.seen),
                errors=_missing(sigmas(_effective(name, law, strong)), true),
                ours=name == ours,
                needs_ratio=name != FLOOR_ONLY,
            )
            for name, (sigmas, ratios) in found.items()
        ),
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
    turn = _turn(case)
    poisson = PoissonGenerator(np.random.Philox(case.seed))
    found: list[tuple[str, Callable[[], object], float]] = [
        ("off", lambda: None, mean),
        ("Poisson", partial(case.model.draw_false_alarms, turn, poisson), excess),
        ("binomial over cells", partial(case.model.draw_false_alarms, turn, case.rng), 0.0),
    ]
    ours = found[-1][0]
    return ChartStage(
        name="false alarms",
        question="How to draw false alarms",
        methods=tuple(
            Method(
                name=name,
                run=run,
                units=len(case.seen),
                errors={FALSE_ALARMS: error},
                ours=name == ours,
            )
            for name, run, error in found
        ),
    )


def _turn(case: Case) -> Sector:
    """A whole scan."""
    scan = case.sensor.scan
    whole = nth_sector(SOME_SCAN, 0, round(scan.period_s * NS), 1)
    return replace(whole, stares=not isinstance(scan, RotatingScan))
