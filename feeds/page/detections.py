"""Detections against range: how often sensors saw what they looked at, and should have."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from plotfeed.models.state import Floats, Looks

BINS = 25
MAX_PARTS = 48
"""Sectors that are counted at once: the session must not wait for all of an update's."""


class DetectionRecord:
    """Looks of all sensors in bins of range, since each sensor's settings last changed."""

    def __init__(self, range_max_m: Floats) -> None:
        self._width_m = range_max_m / BINS
        self._waiting: list[tuple[int, Looks]] = []
        self._counts = np.zeros((4, len(range_max_m), BINS))

    def add(self, sensor: int, looks: Looks) -> None:
        """Looks of one sector of a sensor, by number."""
        if not len(looks):
            return
        self._waiting.append((sensor, looks))
        if len(self._waiting) >= MAX_PARTS:
            self.fold()

    def begin(self, sensor: int) -> None:
        """That sensor's settings changed."""
        self.fold()
        self._counts[:, sensor] = 0

    def fold(self) -> None:
        """Count what waits, all at once."""
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return
        sensor = np.repeat([s for s, _ in waiting], [len(looks) for _, looks in waiting])
        range_m, pd = _joined(waiting, "range_m"), _joined(waiting, "pd")
        detected = _joined(waiting, "detected")
        at = np.clip((range_m / self._width_m[sensor]).astype(np.int64), 0, BINS - 1)
        cell = sensor * BINS + at
        for row, weights in enumerate((np.ones(len(pd)), detected, pd, pd * (1 - pd))):
            counted = np.bincount(cell, weights, minlength=self._counts[row].size)
            self._counts[row] += counted.reshape(self._counts[row].shape)

    def summary(self, sensor: int) -> dict[str, Any]:
        """By range, from 0 in steps of `width_m`: looks, detections, sum and variance expected."""
        looks, detected, expected, variance = self._counts[:, sensor]
        return {
            "width_m": float(self._width_m[sensor]),
            "looks": looks.astype(int).tolist(),
            "detected": detected.astype(int).tolist(),
            "expected": np.round(expected, 3).tolist(),
            "variance": np.round(variance, 3).tolist(),
        }


def _joined(parts: Sequence[tuple[int, Looks]], column: str) -> Floats:
    return np.concatenate([getattr(looks, column) for _, looks in parts], dtype=np.float64)
