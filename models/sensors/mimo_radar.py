"""The MIMO radar: section 3.1.2 of the paper, equations 16 to 23 in right form.

Transmitters far apart and one receiver that tells their signals from each other. A target's echoes
fluctuate independently from transmitter to transmitter and from scan to scan (Swerling 2); their
powers are summed, and a CFAR detector compares the sum with that of the reference samples of all
signals. Positions are measured from the receiver, as by the quasi-monostatic radar.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plotfeed.models import detection, propagation
from plotfeed.models.propagation import C_M_S, NEAREST_M
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.state import Floats


@dataclass(frozen=True, kw_only=True)
class MimoTransmitter:
    """A transmitter, east, north and up of the receiver, and what it radiates on average."""

    position_enu_m: tuple[float, float, float]
    power_w: float
    gain_dbi: float


@dataclass(frozen=True, kw_only=True)
class MimoRadar(PolarRadar):
    """`n_reference` counts the reference cells of the CFAR in each transmitter's signal."""

    transmitters: tuple[MimoTransmitter, ...]

    @property
    def n_signals(self) -> int:
        """A signal a transmitter."""
        return len(self.transmitters)

    @property
    def n_reference_total(self) -> int:
        """Reference samples of all signals together."""
        return self.n_reference * self.n_signals

    def signal_snrs(self, position_enu_m: Floats, rcs_m2: Floats) -> Floats:
        """Mean ratio of each transmitter's echo (eqs 17, 21); (n, 3) and (n,) in, (n, K) out."""
        places_enu_m = np.array([t.position_enu_m for t in self.transmitters])
        range_tx_m = np.linalg.norm(position_enu_m[:, None] - places_enu_m, axis=-1)
        range_rx_m = np.linalg.norm(position_enu_m, axis=-1)[:, None]
        snrs = propagation.radar_snr(
            [t.power_w for t in self.transmitters],
            [t.gain_dbi for t in self.transmitters],
            self.gain_rx_dbi,
            C_M_S / self.frequency_hz,
            rcs_m2[:, None],
            self.integration_s,
            np.maximum(range_tx_m, NEAREST_M),
            np.maximum(range_rx_m, NEAREST_M),
            self.loss_db,
            self.noise_figure_db,
        )
        if self.multipath is not None:
            target_enu_m, wavelength_m = position_enu_m[:, None], C_M_S / self.frequency_hz
            snrs *= self.multipath.power_factor(target_enu_m, wavelength_m)
            snrs *= self.multipath.power_factor(target_enu_m, wavelength_m, places_enu_m)
        return snrs

    def pd(self, snrs: Floats) -> Floats:
        """Probability of detection (eqs 22, 23, each echo with its own ratio); (n, K) to (n,)."""
        return detection.pd_noncoherent_unequal_cfar(snrs, self.pfa, self.n_reference_total)

    def draw_detected(self, snrs: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Powers a transmitter of detections, and thresholds; (n, K) in, (n,) out."""
        power, threshold = detection.draw_detected_power_noncoherent(
            snrs, self.pfa, self.n_reference_total, rng
        )
        return power / self.n_signals, threshold / self.n_signals

    def inverse_detected(self, snrs: Floats) -> Floats:
        """Mean of 1/x over detections of power x a transmitter; (n, K) in, (n,) out."""
        return self.n_signals * detection.inverse_detected_power_noncoherent(
            snrs, self.pfa, self.n_reference_total
        )
