"""A sensor that does worse than it takes itself to do: in one respect, and in no other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from plotfeed.models.state import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Degradation:
    """Factors on the Pd of every look, on the number of false alarms, and on errors by noise.

    What plots state of their errors stays, and so do the ratios of detections. Of many sensors,
    columns (n,).
    """

    pd_factor: float | Floats = 1.0
    false_alarm_factor: float = 1.0
    error_factor: float | Floats = 1.0
