"""Targets that are as strong as a moment ago: how they fluctuate over scans that follow soon.

The amplitude of each is a complex Gauss-Markov process, a <- rho a + sqrt(1 - rho^2) CN(0, 1) with
rho = exp(-t/tau), new in each period of the sensor; of Swerling 3 the mean power of two such.
Given it, a look is at a target that does not fluctuate.
"""

from __future__ import annotations

import numpy as np

from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.effects.readings import Drift
from plotfeed.models.fluctuation import STEADY
from plotfeed.models.state import Floats, Ints

PARTS = 4  # Real processes of a target: two of each amplitude
FEWEST = 64  # Targets that there is room for at first
ONE_AMPLITUDE, TWO_AMPLITUDES = 1.0, 2.0  # Orders of the gamma law of one look


class TargetStrengths:
    """Powers of the amplitudes of all targets of one sensor, by their index."""

    def __init__(self, chance: Chance, *, step_ns: int, time_constant_ns: float) -> None:
        """`step_ns` is the sensor's period."""
        self._chance, self._step_ns, self._time_constant_ns = chance, step_ns, time_constant_ns
        self._drift = self._with_room(FEWEST)
        self._room = FEWEST

    def applied(
        self, snrs: Floats, order: Floats | None, drone: Ints, t_utc_ns: Ints
    ) -> tuple[Floats, Floats]:
        """Ratios (n, K) and orders (n,) of looks, given the strengths at those times."""
        if order is None:
            order = np.full(len(drone), ONE_AMPLITUDE)
        if not len(drone):
            return snrs, order
        while drone.max() >= self._room:
            self._room *= 2  # more targets leave the first ones as they are
            self._drift = self._with_room(self._room)
        squares = self._drift.of(t_utc_ns, drone, PARTS) ** 2
        one, two = squares[:, :2].sum(axis=1) / 2, squares.sum(axis=1) / PARTS
        factor = np.where(order == ONE_AMPLITUDE, one, np.where(order == TWO_AMPLITUDES, two, 1.0))
        return snrs * factor[:, None], np.full(len(drone), STEADY)

    def _with_room(self, targets: int) -> Drift:
        return Drift(
            self._chance,
            step_ns=self._step_ns,
            time_constant_ns=self._time_constant_ns,
            n=PARTS * targets,
            purpose=Purpose.FLUCTUATION,
        )
