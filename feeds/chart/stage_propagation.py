"""Propagation: from distances to mean signal-to-noise ratios."""

from __future__ import annotations

from functools import partial

import numpy as np

from plotfeed.feeds.chart.alternatives_propagation import ways
from plotfeed.feeds.chart.case import Case
from plotfeed.feeds.chart.stage import PD, Alternative, Stage, rms
from plotfeed.models.state import Floats

GATE = "range gate"


def propagation(case: Case) -> Stage | None:
    """The errors are differences in Pd from what the scene asks for: what another way would change.

    None for a sensor that asks for no more than a gate.
    """
    antenna_m = case.sensor.position_enu_m[2]
    timed = ways(case.model, case.seen_targets(), antenna_m)
    judged = ways(case.model, case.anywhere_targets(), antenna_m)
    if timed is None or judged is None:
        return None
    true = judged.pd_of(judged.ratios[judged.ours]())
    places_m = case.seen_targets().position_enu_m
    gate = Alternative(
        name=GATE,
        run=partial(_within, places_m, case.sensor.range_max_m),
        units=len(case.seen),
        errors={PD: rms(1 - true)},
        gives_ratio=False,
    )
    others = [
        Alternative(
            name=name,
            run=way,
            units=len(case.seen),
            errors={PD: rms(judged.pd_of(judged.ratios[name]()) - true)},
            ours=name == timed.ours,
        )
        for name, way in timed.ratios.items()
    ]
    return Stage(
        name="propagation",
        question="How strong a signal arrives",
        alternatives=(gate, *others),
    )


def _within(places_m: Floats, range_max_m: float) -> object:
    """Whoever is near enough."""
    return np.einsum("ij,ij->i", places_m, places_m) <= range_max_m**2
