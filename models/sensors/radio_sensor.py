"""What sensors of radio waves share: what changes powers on their way, and what disturbs them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.sensors.sensor_model import SensorModel
from plotfeed.models.state import Floats

if TYPE_CHECKING:
    from plotfeed.models.effects.multipath import Multipath


@dataclass(frozen=True, kw_only=True)
class RadioSensor(SensorModel, ABC):
    """A sensor of radio waves, over ground that may reflect them."""

    multipath: Multipath | None = None

    is_radio: ClassVar[bool] = True

    @property
    @abstractmethod
    def receiver_noise_w_hz(self) -> Floats:
        """Density of what disturbs its receiver, by signal, watts in a hertz; (K,)."""

    @property
    def is_in_free_space(self) -> bool:
        """Whether nothing changes the powers of its signals on their way."""
        return self.multipath is None and self.surroundings is None

    def way_factor(
        self, place_enu_m: Floats, wavelength_m: ArrayLike, from_enu_m: ArrayLike = (0.0, 0.0, 0.0)
    ) -> Floats:
        """Factor of power one way between places, (..., 3), by all that changes it; (...) out."""
        factor = np.ones(place_enu_m.shape[:-1])
        for each in (self.multipath, self.surroundings):
            if each is not None:
                factor = factor * each.power_factor(place_enu_m, wavelength_m, from_enu_m)
        return factor
