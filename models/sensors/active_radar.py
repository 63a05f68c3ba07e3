"""The quasi-monostatic active radar and the MIMO radar: equations 1 to 23 in right form.

Section 3.1.1 of the paper, equations 1 to 15: one transmitter beside the receiver; a target that
fluctuates from scan to scan (Swerling 1); a cell-averaging CFAR detector.

Section 3.1.2, equations 16 to 23: transmitters far apart and one receiver that tells their signals
from each other. A target's echoes fluctuate independently from transmitter to transmitter and from
scan to scan (Swerling 2); their powers are summed, and a CFAR detector compares the sum with that
of the reference samples of all signals. Positions are measured from the receiver by both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plotfeed.models import propagation
from plotfeed.models.fluctuation import OF_EACH
from plotfeed.models.frames import distance_m
from plotfeed.models.propagation import C_M_S, NEAREST_M
from plotfeed.models.sensors.polar_radar import FarTransmitters, PolarRadar
from plotfeed.models.sensors.sensor_model import sensor_property
from plotfeed.models.state import Floats


@dataclass(frozen=True, kw_only=True)
class ActiveRadar(PolarRadar):
    """`n_reference` counts the reference cells of the CFAR, `power_w` is the average one."""

    power_w: float
    gain_tx_dbi: float

    @sensor_property
    def snr_of_unit(self) -> float:
        """Signal-to-noise ratio, linear, of 1 m2 at 1 m (eq 1)."""
        return float(
            propagation.radar_snr(
                self.power_w,
                self.gain_tx_dbi,
                self.gain_rx_dbi,
                C_M_S / self.frequency_hz,
                1.0,
                self.integration_s,
                1.0,
                1.0,
                self.loss_db,
                self.noise_figure_db,
            )
        )

    def mean_snr(self, range_m: Floats, rcs_m2: Floats) -> Floats:
        """Signal-to-noise ratio before fluctuation, linear (eq 1, one range for both ways)."""
        square_m2 = range_m * range_m
        return self.snr_of_unit * rcs_m2 / (square_m2 * square_m2)

    def signal_snrs(self, position_enu_m: Floats, rcs_m2: Floats) -> Floats:
        """Mean ratio of its one signal; (n, 3) and (n,) in, (n, 1) out."""
        range_m = np.maximum(distance_m(position_enu_m), NEAREST_M)
        snr = self.mean_snr(range_m, rcs_m2)
        if not self.is_in_free_space:
            snr *= self.way_factor(position_enu_m, C_M_S / self.frequency_hz) ** 2
        return snr[:, None]


@dataclass(frozen=True, kw_only=True)
class MimoTransmitter:
    """A transmitter, east, north and up of the receiver, and what it radiates on average."""

    position_enu_m: tuple[float, float, float]
    power_w: float
    gain_dbi: float


@dataclass(frozen=True, kw_only=True)
class MimoRadar(FarTransmitters, PolarRadar):
    """`n_reference` counts the reference cells of the CFAR in each transmitter's signal."""

    transmitters: tuple[MimoTransmitter, ...]

    @sensor_property
    def n_looks(self) -> int:
        """A signal a transmitter."""
        return len(self.transmitters)

    @property
    def usual_order(self) -> float:
        """`OF_EACH`: echoes of transmitters far apart fluctuate by themselves (Swerling 2)."""
        return OF_EACH

    def signal_snrs(self, position_enu_m: Floats, rcs_m2: Floats) -> Floats:
        """Mean ratio of each transmitter's echo (eqs 17, 21); (n, 3) and (n,) in, (n, K) out."""
        return self._echoes(
            position_enu_m,
            rcs_m2,
            self._radiated_w,
            [C_M_S / self.frequency_hz] * self.n_looks,
            self.positions_enu_m,
            self.integration_s,
            self._noise_density_w_hz,
        )

    @sensor_property
    def _radiated_w(self) -> Floats:
        """What each transmitter radiates, with the gains, less the loss; (K,)."""
        gains_db = np.array([t.gain_dbi for t in self.transmitters]) + self.gain_rx_dbi
        power_w = np.array([t.power_w for t in self.transmitters])
        return propagation.radiated_w(power_w, gains_db - self.loss_db)

    @sensor_property
    def _noise_density_w_hz(self) -> float:
        return float(propagation.noise_density_w_hz(self.noise_figure_db))
