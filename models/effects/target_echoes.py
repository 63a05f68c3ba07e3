"""How the echoes of targets differ: how they fluctuate, and what they are from which side.

Targets may be as strong as a moment ago, over scans that follow soon. The amplitude of each is then
a complex Gauss-Markov process, a <- rho a + sqrt(1 - rho^2) CN(0, 1) with rho = exp(-t/tau), new in
each period of the sensor; of Swerling 3 the mean power of two such. Given it, a look is at a target
that does not fluctuate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from plotfeed.models import special
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.effects.readings import Drift
from plotfeed.models.fluctuation import STEADY, order_of
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.state import Floats, Ints

NEPERS_A_DB = float(np.log(10) / 10)
NOT_STATED = -1


@dataclass(frozen=True, slots=True)
class LobedAspect:
    """Four lobes, A cos 4a in dB, as of a quadcopter with square arms; the mean power is kept."""

    depth_db: float

    def gain_db(self, aspect_deg: Floats) -> Floats:
        """A cos 4a less 10 lg I0(A ln 10/10)."""
        nepers = NEPERS_A_DB * self.depth_db
        mean_db = (np.log(special.i0e(nepers)) + nepers) / NEPERS_A_DB
        return np.asarray(self.depth_db * np.cos(np.radians(4 * aspect_deg)) - mean_db)


@dataclass(frozen=True, slots=True)
class AspectTable:
    """Gains at aspects from 0 to 360, as they were measured; linear in dB all around."""

    angles_deg: tuple[float, ...]
    gains_db: tuple[float, ...]

    def gain_db(self, aspect_deg: Floats) -> Floats:
        """Gains of the table, as they are."""
        return np.asarray(np.interp(aspect_deg, self.angles_deg, self.gains_db, period=360.0))


# Cross-section over its stated mean by the side from which a target is seen: decibels at aspects,
# clockwise from the nose, seen from above.
Aspect = LobedAspect | AspectTable


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetEcho:
    """What is stated of a target: Swerling's case, and its aspects; None for what is not."""

    swerling: int | None = None
    aspect: Aspect | None = None


@dataclass(frozen=True)
class TargetEchoes:
    """Echoes of all drones, by their index: which of the kinds each has, (n,), or `NOT_STATED`."""

    kinds: tuple[TargetEcho, ...]
    kind: Ints

    @classmethod
    def of(cls, echoes: Sequence[TargetEcho | None]) -> Self:
        """Echoes of drones, in their order."""
        kinds = tuple(dict.fromkeys(echo for echo in echoes if echo is not None))
        numbers = {echo: i for i, echo in enumerate(kinds)}
        found = [NOT_STATED if echo is None else numbers[echo] for echo in echoes]
        return cls(kinds, np.array(found, np.int64))

    def rows(self, drone: Ints) -> Self:
        """Echoes of some drones, which are numbered anew in that order."""
        return type(self)(self.kinds, self.kind[drone])

    @cached_property
    def has_aspects(self) -> bool:
        """Whether any of them depends on the aspect."""
        return any(echo.aspect is not None for echo in self.kinds)

    def orders(self, drone: Ints, usual: float, n_looks: int) -> Floats:
        """Orders by which drones fluctuate over that many looks, that one where none is stated."""
        cases = [echo.swerling for echo in self.kinds]
        orders = [usual if case is None else order_of(case, n_looks) for case in (*cases, None)]
        return np.array(orders)[self.kind[drone]]  # the last one, -1, is the usual

    @nan_without_warnings
    def rcs_factor(
        self,
        drone: Ints,
        place_enu_m: Floats,
        velocity_enu_m_s: Floats,
        transmitters_enu_m: Sequence[Floats] | None,
    ) -> Floats:
        """Cross-sections over the stated ones; (n, 1), or (n, K) of transmitters elsewhere.

        A target looks where it flies, and north while it hovers. With a transmitter elsewhere it
        is seen from between the two (Crispin's bisector).
        """
        course_deg = np.degrees(np.arctan2(velocity_enu_m_s[:, 0], velocity_enu_m_s[:, 1]))
        back = -_unit(place_enu_m)
        seen_from = [back]
        if transmitters_enu_m is not None:
            seen_from = [back - _unit(place_enu_m - each_m) for each_m in transmitters_enu_m]
        aspects_deg = np.stack(
            [np.degrees(np.arctan2(side[:, 0], side[:, 1])) - course_deg for side in seen_from],
            axis=-1,
        )
        factor = np.ones_like(aspects_deg)
        kind = self.kind[drone]
        for number, echo in enumerate(self.kinds):
            rows = np.flatnonzero(kind == number)
            if echo.aspect is not None and len(rows):
                factor[rows] = 10 ** (echo.aspect.gain_db(aspects_deg[rows]) / 10)
        return factor


def _unit(vector: Floats) -> Floats:
    return np.asarray(vector / np.linalg.norm(vector, axis=-1, keepdims=True))


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
