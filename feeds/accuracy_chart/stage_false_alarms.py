"""False alarms: how many there are in a scan, and where."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from plotfeed.feeds.accuracy_chart.case import Case
from plotfeed.feeds.accuracy_chart.stage import FALSE_ALARMS, Alternative, ChartStage
from plotfeed.feeds.scene.sensors.sensor_keys import RotatingScan
from plotfeed.models.beam.scan import Sector, nth_sector
from plotfeed.proto.utc import NS

OURS = "binomial over cells"
SOME_SCAN = 1000


class PoissonGenerator(np.random.Generator):
    """Draws Poisson numbers where it is asked for binomial ones."""

    def binomial(self, n: Any, p: Any, size: Any = None) -> Any:
        """Poisson, of the same mean."""
        return self.poisson(np.multiply(n, p), size)


def false_alarms(case: Case) -> ChartStage | None:
    """Of a whole scan, shared between the targets at once; None for a sensor without any."""
    cells, pfa = getattr(case.model, "resolution_cells", None), getattr(case.model, "pfa", 0.0)
    if cells is None or FALSE_ALARMS not in case.own:
        return None
    mean = float(np.sum(cells) * pfa)
    excess = np.sqrt(mean - mean * (1 - pfa))  # of the Poisson number over the binomial one
    turn, n = _turn(case), len(case.seen)
    poisson = PoissonGenerator(np.random.Philox(case.seed))
    return ChartStage(
        name="false alarms",
        question="How to draw false alarms",
        alternatives=(
            Alternative(name="off", run=_nothing, units=n, errors={FALSE_ALARMS: mean}),
            Alternative(
                name="Poisson",
                run=partial(case.model.draw_false_alarms, turn, poisson),
                units=n,
                errors={FALSE_ALARMS: float(excess)},
            ),
            Alternative(
                name=OURS,
                run=partial(case.model.draw_false_alarms, turn, case.rng),
                units=n,
                errors={FALSE_ALARMS: 0.0},
                ours=True,
            ),
        ),
    )


def _turn(case: Case) -> Sector:
    """A whole scan."""
    scan = case.sensor.scan
    whole = nth_sector(SOME_SCAN, 0, round(scan.period_s * NS), 1)
    return replace(whole, stares=not isinstance(scan, RotatingScan))


def _nothing() -> None:
    """No false alarms."""
