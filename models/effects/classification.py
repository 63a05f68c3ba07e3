"""Classifiers that are sometimes wrong: what is claimed of each class, by a confusion matrix.

A claim is drawn for each plot by itself, or stays for a while: what fooled a classifier, an aspect
or a wing beat, is there in the next looks too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.chance import Chance, Purpose, ScanDraws
from plotfeed.models.state import Floats, Ints, Looks, Texts

# Of its multiples the fractions are spread evenly: drones change their claims one by one.
GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True, kw_only=True)
class Confusion:
    """Probabilities of each claim, a row for each true class that the matrix names.

    `otherwise` is the row of any other class, and of false alarms; without it, nothing is claimed
    of those. Claims of a drone stay for `held_ns`, 0 for one plot.
    """

    claims: tuple[str, ...]
    true_classes: tuple[str, ...]
    rows: tuple[tuple[float, ...], ...]
    otherwise: tuple[float, ...] | None = None
    held_ns: int = 0

    def claimed(
        self, true_class: Texts, rng: np.random.Generator, drawn: Floats | None = None
    ) -> tuple[Texts, Floats]:
        """What is claimed of targets of those classes, and how surely; "" and NaN for nothing.

        `drawn` are uniform numbers that are held, (n,); without them, each claim is drawn anew.
        """
        if drawn is None:
            drawn = rng.random((len(true_class),))
        is_class = true_class[:, None] == np.array(self.true_classes, np.object_)
        row = np.where(is_class.any(axis=1), is_class.argmax(axis=1), len(self.true_classes))
        # Rows add up to one but for rounding: what is drawn beyond is the last claim.
        claim = (drawn[:, None] >= self._cumulated[row][:, :-1]).sum(axis=1)
        names = np.array([*self.claims, ""], np.object_)
        if self.otherwise is None:
            claim = np.where(row == len(self.true_classes), len(self.claims), claim)
        return names[claim], np.append(self.certainties, np.nan)[claim]

    def columns(
        self, true_class: Texts, rng: np.random.Generator, drawn: Floats | None = None
    ) -> dict[str, NDArray[Any]]:
        """Columns of plots of targets of those classes, (n,)."""
        kind, probability = self.claimed(true_class, rng, drawn)
        return {"kind": kind, "kind_probability": probability}

    def columns_of_nothing(self, n: int, rng: np.random.Generator) -> dict[str, NDArray[Any]]:
        """Columns of false alarms, (n,)."""
        return self.columns(np.full(n, None, np.object_), rng)

    @cached_property
    def certainties(self) -> Floats:
        """Probability that each claim is right, were all true classes of the matrix as frequent.

        0 for a claim that is none of them. (claims,)
        """
        rows = np.array(self.rows)
        right = np.array(
            [
                rows[self.true_classes.index(claim), j] if claim in self.true_classes else 0.0
                for j, claim in enumerate(self.claims)
            ]
        )
        said = rows.sum(axis=0)
        return np.asarray(np.divide(right, said, out=np.zeros(len(said)), where=said > 0))

    @cached_property
    def _cumulated(self) -> Floats:
        other = self.otherwise or tuple(1.0 / len(self.claims) for _ in self.claims)
        return np.asarray(np.cumsum(np.array([*self.rows, other]), axis=1))


class ClaimDraws:
    """Uniform numbers of sensors and drones, which stay for a time, by their indices."""

    def __init__(self, chances: Sequence[Chance]) -> None:
        self._draws = ScanDraws(chances, Purpose.CLAIMS)

    def of(self, sensor: Ints, drone: Ints, t_utc_ns: Ints, held_ns: int) -> Floats:
        """Numbers of sensors and drones at times, each (n,), which stay for so long."""
        shift_ns = np.rint(drone * GOLDEN % 1.0 * held_ns).astype(np.int64)
        spell = (t_utc_ns + shift_ns) // held_ns
        return self._draws.of(sensor, spell, drone).random((len(drone),))

    def trim(self, drones: int) -> None:
        """Keep no room for many more drones than that."""
        self._draws.trim(drones)


@dataclass(frozen=True, slots=True)
class HeldClaims:
    """Draws of the sensors of a pass, or of one that is alone, which stay for `held_ns`."""

    draws: ClaimDraws
    sensor: int
    held_ns: int

    def of(self, looks: Looks) -> Floats:
        """Numbers of looks; (n,)."""
        sensor = np.full(len(looks), self.sensor) if looks.sensor is None else looks.sensor
        return self.draws.of(sensor, looks.drone, looks.t_utc_ns, self.held_ns)
