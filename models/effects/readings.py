"""What a sensor reads in place of what it finds: a skewed mount, fixed errors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import ceil, cosh, log2, sqrt, tanh

import numpy as np

from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import LocalFrame, aer_to_enu, axes_enu
from plotfeed.models.state import Floats, Ints

UP = np.array([0.0, 0.0, 1.0])


def own_axes(azimuth_offset_deg: float, tilt_deg: float, tilt_azimuth_deg: float) -> Floats:
    """Rotation from true east, north and up to the sensor's own, which it takes for them; (3, 3).

    Azimuths read too high by the offset. The sensor's vertical leans by the tilt towards an
    azimuth: what is there reads too high by as much.
    """
    towards = aer_to_enu(tilt_azimuth_deg, 0.0, 1.0)
    right = aer_to_enu(tilt_azimuth_deg + 90.0, 0.0, 1.0)
    leaning_up = aer_to_enu(tilt_azimuth_deg, 90.0 - tilt_deg, 1.0)
    leaning_towards = aer_to_enu(tilt_azimuth_deg, -tilt_deg, 1.0)
    tilt = np.outer(right, right) + np.outer(towards, leaning_towards) + np.outer(UP, leaning_up)
    north = aer_to_enu(azimuth_offset_deg, 0.0, 1.0)
    east = aer_to_enu(azimuth_offset_deg + 90.0, 0.0, 1.0)
    return np.asarray(np.column_stack([east, north, UP]) @ tilt)


@dataclass(frozen=True, kw_only=True)
class SkewFrame(LocalFrame):
    """A local frame whose axes are a sensor's own."""

    azimuth_offset_deg: float = 0.0
    tilt_deg: float = 0.0
    tilt_azimuth_deg: float = 0.0

    @classmethod
    def at(cls, frame: LocalFrame, **skew: float) -> SkewFrame:
        """Skewed axes at the place of another frame."""
        return cls(frame.latitude_deg, frame.longitude_deg, frame.height_m, **skew)

    @cached_property
    def rotation_from_ecef(self) -> Floats:  # type: ignore[override]
        """The sensor's own axes as unit vectors in ECEF, one a row; (3, 3)."""
        axes = own_axes(self.azimuth_offset_deg, self.tilt_deg, self.tilt_azimuth_deg)
        return np.asarray(axes @ axes_enu(self.latitude_deg, self.longitude_deg))


# Time constants between anchors: what they would have in common is exp(-64), 2e-28.
INDEPENDENT = 64.0


class Drift:
    """Several independent processes at once, constant within steps of time."""

    def __init__(
        self,
        chance: Chance,
        *,
        step_ns: int,
        time_constant_ns: float,
        n: int,
        purpose: Purpose = Purpose.DRIFT,
    ) -> None:
        self._chance, self._purpose = chance, purpose
        self._step_ns = step_ns
        self._steps = step_ns / time_constant_ns  # of time, in time constants
        self._halvings = max(ceil(log2(INDEPENDENT / self._steps)), 0)
        self._n = n
        self._value_at = lru_cache(maxsize=64)(self._value)

    def at(self, t_utc_ns: Ints) -> Floats:
        """Values at times (m,); (m, n)."""
        values, place = self._values_at(t_utc_ns)
        return values[place]

    def of(self, t_utc_ns: Ints, which: Ints, size: int) -> Floats:
        """Values at times (m,) of groups of so many processes each, these; (m, size)."""
        values, place = self._values_at(t_utc_ns)
        found: Floats = values.reshape(len(values), -1, size)[place, which]
        return found

    def _values_at(self, t_utc_ns: Ints) -> tuple[Floats, Ints]:
        """Values of the steps that there are, and of which step each time is."""
        steps, place = np.unique(t_utc_ns // self._step_ns, return_inverse=True)
        values = [self._value_at(step) for step in steps.tolist()]
        return np.array(values).reshape(-1, self._n), place

    def _value(self, step: int) -> Floats:
        """Value of a step by the two half-way between which it lies; anchors are drawn alone."""
        width = step & -step
        if not width or width >> self._halvings:
            return self._draw(step)
        h = width * self._steps
        at_low, at_high = self._value_at(step - width), self._value_at(step + width)
        middle = (at_low + at_high) / (2 * cosh(h)) + sqrt(tanh(h)) * self._draw(step)
        return np.asarray(middle)

    def _draw(self, step: int) -> Floats:
        return self._chance.rng(self._purpose, step).standard_normal(self._n)


@dataclass(frozen=True, slots=True, kw_only=True)
class Readings:
    """A range r reads r (1 + scale) + offset, and drifts; an azimuth drifts.

    A fixed error of azimuth is not here: it is in the sensor's own axes. `drift` has two processes,
    of range and of azimuth, whose standard deviations are beside it.
    """

    range_scale: float = 0.0
    range_offset_m: float = 0.0
    drift: Drift | None = None
    sigma_range_m: float = 0.0
    sigma_azimuth_deg: float = 0.0

    def range_m(self, range_m: Floats, t_utc_ns: Ints) -> Floats:
        """Readings of ranges, or of bistatic ranges, at times; each (n,)."""
        read_m = range_m * (1 + self.range_scale) + self.range_offset_m
        if self.drift is None or not self.sigma_range_m:
            return read_m
        return read_m + self.sigma_range_m * self.drift.at(t_utc_ns)[:, 0]

    def azimuth_deg(self, azimuth_deg: Floats, t_utc_ns: Ints) -> Floats:
        """Readings of azimuths at times, not folded; each (n,)."""
        if self.drift is None or not self.sigma_azimuth_deg:
            return azimuth_deg
        return azimuth_deg + self.sigma_azimuth_deg * self.drift.at(t_utc_ns)[:, 1]
