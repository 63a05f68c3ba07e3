"""The quasi-monostatic active radar: section 3.1.1 of the paper, equations 1 to 15 in right form.

One transmitter beside the receiver; a target that fluctuates from scan to scan (Swerling 1); a
cell-averaging CFAR detector.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plotfeed.models import detection, propagation
from plotfeed.models.frames import distance_m
from plotfeed.models.propagation import C_M_S
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.state import Floats


@dataclass(frozen=True, kw_only=True)
class ActiveRadar(PolarRadar):
    """`n_reference` counts the reference cells of the CFAR, `power_w` is the average one."""

    power_w: float
    gain_tx_dbi: float

    @property
    def n_signals(self) -> int:
        """A single signal."""
        return 1

    @cached_property
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
        range_m = np.maximum(distance_m(position_enu_m), propagation.NEAREST_M)
        snr = self.mean_snr(range_m, rcs_m2)
        if self.multipath is not None:
            snr *= self.multipath.power_factor(position_enu_m, C_M_S / self.frequency_hz) ** 2
        return snr[:, None]

    def pd(self, snrs: Floats) -> Floats:
        """Probability of detection (eqs 6, 7); (n, 1) in, (n,) out."""
        return detection.pd_cfar_swerling1(snrs[..., 0], self.pfa, self.n_reference)

    def draw_detected(self, snrs: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Powers and thresholds of detections, given the mean ratios; (n, 1) in, (n,) out."""
        return detection.draw_detected_snr_swerling1(snrs[..., 0], self.pfa, self.n_reference, rng)

    def inverse_detected(self, snrs: Floats) -> Floats:
        """Mean of 1/x over detections of power x; (n, 1) in, (n,) out."""
        return detection.inverse_detected_snr(snrs[..., 0], self.pfa, self.n_reference)
