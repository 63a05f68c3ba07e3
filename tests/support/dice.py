"""Draws of one random scene, by its seed."""

from __future__ import annotations

from typing import Any

import numpy as np

Keys = dict[str, Any]


class Dice:
    """Draws of one scene."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def between(self, low: float, high: float) -> float:
        return round(float(self._rng.uniform(low, high)), 4)

    def log_between(self, low: float, high: float) -> float:
        return float(f"{np.exp(self._rng.uniform(np.log(low), np.log(high))):.4g}")

    def one_of(self, *choices: Any) -> Any:
        return choices[int(self._rng.integers(len(choices)))]

    def happens(self, chance: float) -> bool:
        return bool(self._rng.random() < chance)

    def some_of(self, *choices: Any) -> list[Any]:
        """At least one."""
        kept = [choice for choice in choices if self.happens(0.5)]
        return kept or [self.one_of(*choices)]

    def place(self, far_m: float, low_m: float = 20.0, high_m: float = 150.0) -> Keys:
        return {
            "east_m": self.between(-far_m, far_m),
            "north_m": self.between(-far_m, far_m),
            "above_site_m": self.between(low_m, high_m),
        }
