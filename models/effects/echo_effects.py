"""What becomes of the power of echoes by where and how targets are: factors of each look.

Each effect is a factor on the mean ratio of a look, by the signal; a radar has their product.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from plotfeed.models.frames import enu_to_aer
from plotfeed.models.state import Floats

if TYPE_CHECKING:
    from plotfeed.models.effects.antenna import Antenna


@dataclass(frozen=True, slots=True, kw_only=True)
class EchoPaths:
    """How echoes come, (n,): directions by the sensor's own axes, places east, north and up.

    `transmitters_enu_m` are those of the signals, each (3,) or (n, 3), or None where the sensor
    itself transmits; `measured_m` what is measured of range by each signal, (n, K), and `rates_m_s`
    how fast that grows, None where it is not known.
    """

    azimuth_deg: Floats
    elevation_deg: Floats
    place_enu_m: Floats
    transmitters_enu_m: Sequence[Floats] | None
    measured_m: Floats
    rates_m_s: Floats | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Straddling:
    """What is lost between the middles of range and Doppler cells, by the shape of a cell.

    Widths of cells by signal, (K,); a shape is one of `CELL_SHAPES`, None where nothing is lost.
    """

    range_cells_m: tuple[float, ...]
    range_shape: str | None
    doppler_cells_m_s: tuple[float, ...]
    doppler_shape: str | None

    def power_factor(self, paths: EchoPaths) -> Floats:
        """Factor of power by where in their cells echoes are; (n, K)."""
        factor = np.ones_like(paths.measured_m)
        if self.range_shape is not None:
            factor *= cell_factor(paths.measured_m / np.array(self.range_cells_m), self.range_shape)
        if self.doppler_shape is not None and paths.rates_m_s is not None:
            cells = paths.rates_m_s / np.array(self.doppler_cells_m_s)
            factor *= cell_factor(cells, self.doppler_shape)
        return factor


# Amplitudes off the middle of a cell: of a flat spectrum or window, of the correlation of a flat
# pulse with itself, of Hann's window, whose noise is 1.76 dB more beside.
CELL_SHAPES: dict[str, Callable[[Floats], Floats]] = {
    "sinc": np.sinc,
    "triangle": lambda offset: 1 - np.abs(offset),
    "hann": lambda offset: np.asarray(np.sinc(offset) / (1 - offset * offset)),
}


def cell_factor(cells: Floats, shape: str) -> Floats:
    """What is left of a power at places counted in cells, of which whole ones are the middles."""
    offset = cells - np.rint(cells)
    return np.asarray(CELL_SHAPES[shape](offset) ** 2)


class EchoEffect(Protocol):
    """Something that changes the ratio of an echo by where its target is."""

    def power_factor(self, paths: EchoPaths) -> Floats:
        """Factor of the mean ratio; (n, 1) or (n, K)."""


def antenna_factor(antenna: Antenna, paths: EchoPaths) -> Floats:
    """Gain over the peak, out and back; (n, 1), or (n, K) of transmitters elsewhere."""
    factor = np.ones((len(paths.azimuth_deg), 1))
    if antenna.receive is not None:
        factor[:, 0] = antenna.receive.gain(paths.azimuth_deg, paths.elevation_deg)
    if antenna.transmit is None:
        return factor
    if paths.transmitters_enu_m is None:
        out = antenna.transmit.gain(paths.azimuth_deg, paths.elevation_deg)
        return np.asarray(factor * out[:, None])
    gains = []
    for place_enu_m in paths.transmitters_enu_m:
        azimuth_deg, elevation_deg, _ = enu_to_aer(paths.place_enu_m - place_enu_m)
        gains.append(antenna.transmit.gain(azimuth_deg, elevation_deg))
    return np.asarray(factor * np.stack(gains, axis=-1))


@dataclass(frozen=True, slots=True, kw_only=True)
class EchoEffects:
    """Effects that a scene names, at least one."""

    antenna: Antenna | None = None
    straddling: Straddling | None = None
    in_the_world: tuple[EchoEffect, ...] = ()
    """Weather, and what drowns echoes."""

    def power_factor(self, paths: EchoPaths) -> Floats:
        """The product of all; (n, 1) or (n, K)."""
        factor = np.ones((len(paths.azimuth_deg), 1))
        if self.antenna is not None:
            factor = factor * antenna_factor(self.antenna, paths)
        if self.straddling is not None:
            factor = factor * self.straddling.power_factor(paths)
        for effect in self.in_the_world:
            factor = factor * effect.power_factor(paths)
        return factor
