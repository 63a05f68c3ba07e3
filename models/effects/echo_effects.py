"""What becomes of the power of echoes by where and how targets are: factors of each look.

Each effect is a factor on the mean ratio of a look, by the signal; a radar has their product. Gains
of antennas are one way, below the peak, which is the gain that the radar equation has; their angles
are along the sensor's own axes. A Gaussian beam of width B at 3 dB loses 12.04 (a/B)^2 dB at a.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models.frames import enu_to_aer, wrap_180
from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.state import Floats

GAUSSIAN_DB = float(40 * np.log10(2))  # Loss of a Gaussian beam one width off its middle: 12.04 dB


@nan_without_warnings
def gaussian_loss_db(offset_deg: ArrayLike, beamwidth_deg: ArrayLike) -> Floats:
    """Loss of a Gaussian beam, dB one way, so far off its middle."""
    return as_floats(GAUSSIAN_DB * (as_floats(offset_deg) / as_floats(beamwidth_deg)) ** 2)


@nan_without_warnings
def cosecant_peak_loss_db(from_deg: ArrayLike, to_deg: ArrayLike) -> Floats:
    """What a cosecant-squared beam has less at its peak than a fan beam of its lower part alone.

    10 lg(2 - e1 cot e2), e1 in radians (Skolnik).
    """
    spread = np.radians(as_floats(from_deg)) / np.tan(np.radians(as_floats(to_deg)))
    return as_floats(10 * np.log10(2 - spread))


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussianCut:
    """A beam, or several of one width side by side, of which the nearest counts.

    They are centred on the boresight, and close the circle if there are enough of them.
    """

    beamwidth_deg: float
    boresight_deg: float
    spacing_deg: float = 0.0
    beams: int = 1

    def loss_db(self, angle_deg: Floats) -> Floats:
        """Loss below the peak, by the offset from the nearest beam."""
        off_deg = wrap_180(angle_deg - self.boresight_deg)
        if self.beams > 1:
            first_deg = -self.spacing_deg * (self.beams - 1) / 2
            nearest = np.rint((off_deg - first_deg) / self.spacing_deg)
            if self.spacing_deg * self.beams < 360.0:
                nearest = np.clip(nearest, 0, self.beams - 1)
            off_deg = off_deg - first_deg - self.spacing_deg * nearest
        return gaussian_loss_db(off_deg, self.beamwidth_deg)


@dataclass(frozen=True, slots=True, kw_only=True)
class CosecantSquaredCut:
    """A beam that makes a target of one height as strong at any range, between two elevations.

    Beyond them the gain falls off like a Gaussian beam that is at its middle there.
    """

    from_deg: float
    to_deg: float
    beamwidth_deg: float

    def loss_db(self, angle_deg: Floats) -> Floats:
        """Loss below the gain at the lower end."""
        within_deg = np.clip(angle_deg, self.from_deg, self.to_deg)
        sines = np.sin(np.radians(within_deg)) / np.sin(np.radians(self.from_deg))
        beyond_db = gaussian_loss_db(angle_deg - within_deg, self.beamwidth_deg)
        return np.asarray(20 * np.log10(sines) + beyond_db)


@dataclass(frozen=True, slots=True, kw_only=True)
class TableCut:
    """Gains at angles off the boresight, which rise; linear in dB between, and as at the ends."""

    angles_deg: tuple[float, ...]
    gains_db: tuple[float, ...]
    boresight_deg: float

    def loss_db(self, angle_deg: Floats) -> Floats:
        """Loss below 0 dB of the table."""
        off_deg = wrap_180(angle_deg - self.boresight_deg)
        return np.asarray(-np.interp(off_deg, self.angles_deg, self.gains_db))


@dataclass(frozen=True, slots=True)
class OffBeam:
    """Directions that a beam does not point at: it has nothing there but its side lobes."""

    def loss_db(self, angle_deg: Floats) -> Floats:
        """Loss without bounds, of which a pattern leaves its side lobes."""
        return np.full(len(angle_deg), np.inf)


# The gain over one angle, azimuth or elevation.
BeamCut = GaussianCut | CosecantSquaredCut | TableCut | OffBeam


@dataclass(frozen=True, slots=True, kw_only=True)
class Pattern:
    """A beam's cuts, of which None is as wide as the cover, and its side lobes below the peak."""

    azimuth: BeamCut | None
    elevation: BeamCut | None
    sidelobe_db: float

    def gain(self, azimuth_deg: Floats, elevation_deg: Floats) -> Floats:
        """Gain over the peak, linear, one way; (n,)."""
        loss_db = np.zeros(len(azimuth_deg))
        if self.azimuth is not None:
            loss_db += self.azimuth.loss_db(azimuth_deg)
        if self.elevation is not None:
            loss_db += self.elevation.loss_db(elevation_deg)
        return np.asarray(10 ** (-np.minimum(loss_db, self.sidelobe_db) / 10))


@dataclass(frozen=True, slots=True, kw_only=True)
class Antenna:
    """The patterns by which a radar transmits and receives; None is as wide as the cover.

    With `shows_sidelobes`, targets are also reported that the beam does not point at.
    """

    transmit: Pattern | None = None
    receive: Pattern | None = None
    shows_sidelobes: bool = False

    def power_factor(self, paths: EchoPaths) -> Floats:
        """Gain over the peak, out and back; (n, 1), or (n, K) of transmitters elsewhere."""
        factor = np.ones((len(paths.azimuth_deg), 1))
        if self.receive is not None:
            factor[:, 0] = self.receive.gain(paths.azimuth_deg, paths.elevation_deg)
        if self.transmit is None:
            return factor
        if paths.transmitters_enu_m is None:
            out = self.transmit.gain(paths.azimuth_deg, paths.elevation_deg)
            return np.asarray(factor * out[:, None])
        gains = []
        for place_enu_m in paths.transmitters_enu_m:
            azimuth_deg, elevation_deg, _ = enu_to_aer(paths.place_enu_m - place_enu_m)
            gains.append(self.transmit.gain(azimuth_deg, elevation_deg))
        return np.asarray(factor * np.stack(gains, axis=-1))

    def turned_away(self, *, transmitter_too: bool) -> Antenna:
        """Patterns for targets that the beam does not point at, out and back or back alone."""
        out = self.transmit if not transmitter_too else _sidelobes_of(self.transmit)
        return Antenna(transmit=out, receive=_sidelobes_of(self.receive))


def _sidelobes_of(pattern: Pattern | None) -> Pattern | None:
    if pattern is None:
        return None
    return Pattern(azimuth=OffBeam(), elevation=None, sidelobe_db=pattern.sidelobe_db)


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
        for effect in (self.antenna, self.straddling, *self.in_the_world):
            if effect is not None:
                factor = factor * effect.power_factor(paths)
        return factor
