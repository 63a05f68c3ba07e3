"""Transmitters that drown signals: noise from a direction, through a beam or its side lobes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.effects.echo_effects import EchoPaths
from plotfeed.models.effects.surroundings import OnTheWay
from plotfeed.models.frames import wrap_180
from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.propagation import C_M_S
from plotfeed.models.state import Floats

# Of a beam's gain one way, exp(-this (angle/width)^2): one half at half of its 3 dB width.
GAUSSIAN = 4 * np.log(2)


@nan_without_warnings
def jamming_over_noise(
    *,
    eirp_w: ArrayLike,
    jammer_hz: ArrayLike,
    jammer_width_hz: ArrayLike,
    range_m: ArrayLike,
    gain_dbi: ArrayLike,
    frequency_hz: ArrayLike,
    bandwidth_hz: ArrayLike,
    noise_w_hz: ArrayLike,
) -> Floats:
    """Density of a jammer's noise over that of a receiver, in the middle of its beam; (...).

    Of the receiver's band it counts by the share that it lies in.
    """
    f, width = as_floats(frequency_hz), as_floats(bandwidth_hz)
    low = np.maximum(f - width / 2, as_floats(jammer_hz) - as_floats(jammer_width_hz) / 2)
    high = np.minimum(f + width / 2, as_floats(jammer_hz) + as_floats(jammer_width_hz) / 2)
    share = np.clip((high - low) / width, 0.0, 1.0)
    wavelength_m = C_M_S / f
    spread = (wavelength_m / (4 * np.pi * np.maximum(as_floats(range_m), 1.0))) ** 2
    received_w_hz = as_floats(eirp_w) / as_floats(jammer_width_hz) * spread
    gain = 10 ** (as_floats(gain_dbi) / 10)
    return np.asarray(share * received_w_hz * gain / as_floats(noise_w_hz))


@dataclass(frozen=True, kw_only=True)
class Jammer:
    """One, as a sensor has it: where it is, and its noise over the sensor's in the beam's middle.

    `over_noise` is by signal, (K,); beside the beam no less is heard than `sidelobe_db`, negative.
    """

    position_enu_m: tuple[float, float, float]
    frequency_hz: float
    azimuth_deg: float
    elevation_deg: float
    over_noise: tuple[float, ...]
    sidelobe_db: float

    def times(self, factor: float) -> Jammer:
        """The jammer, with so much of its power."""
        return replace(self, over_noise=tuple(each * factor for each in self.over_noise))


@dataclass(frozen=True, kw_only=True)
class BandNoise:
    """A jammer as an antenna without a beam has it: its noise over the receiver's in a band."""

    position_enu_m: tuple[float, float, float]
    frequency_hz: float
    bandwidth_hz: float
    over_noise: float

    def times(self, factor: float) -> BandNoise:
        """The jammer, with so much of its power."""
        return replace(self, over_noise=self.over_noise * factor)

    def over_noise_at(self, frequency_hz: Floats) -> Floats:
        """What there is of it at those frequencies; (n,)."""
        beside_hz = np.abs(frequency_hz - self.frequency_hz)
        return np.where(beside_hz <= self.bandwidth_hz / 2, self.over_noise, 0.0)


@dataclass(frozen=True, kw_only=True)
class Jamming:
    """Jammers, at least one, and the widths of the receive beam that looks at each target.

    The CFAR keeps its false alarms: noise in all cells raises its threshold.
    """

    jammers: tuple[Jammer, ...]
    azimuth_beamwidth_deg: float
    elevation_beamwidth_deg: float | None = None

    def over_noise(self, azimuth_deg: Floats, elevation_deg: Floats) -> Floats:
        """Noise of all jammers over the receiver's, looking there; (n,) in, (n, K) out."""
        total = np.zeros((len(azimuth_deg), len(self.jammers[0].over_noise)))
        for jammer in self.jammers:
            off = (wrap_180(azimuth_deg - jammer.azimuth_deg) / self.azimuth_beamwidth_deg) ** 2
            if self.elevation_beamwidth_deg is not None:
                above_deg = elevation_deg - jammer.elevation_deg
                off = off + (above_deg / self.elevation_beamwidth_deg) ** 2
            gain = np.maximum(np.exp(-GAUSSIAN * off), 10 ** (jammer.sidelobe_db / 10))
            total += gain[:, None] * np.array(jammer.over_noise)
        return total

    def power_factor(self, paths: EchoPaths) -> Floats:
        """What is left of ratios, to noise and jammers; (n, K)."""
        return np.asarray(1 / (1 + self.over_noise(paths.azimuth_deg, paths.elevation_deg)))


J = TypeVar("J", Jammer, BandNoise)


def behind(jammers: Sequence[J], way: OnTheWay) -> tuple[J, ...]:
    """Jammers with what is left of their power on their way to the sensor."""
    return tuple(
        jammer.times(
            float(
                way.power_factor(np.array([jammer.position_enu_m]), C_M_S / jammer.frequency_hz)[0]
            )
        )
        for jammer in jammers
    )
