"""The equations of the passive radar put together, as the paper's tables have them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from plotfeed.models import propagation
from plotfeed.models.numerics import as_floats
from plotfeed.models.state import Floats


def passive_snr(
    *,
    erp_w: ArrayLike,
    gain_rx_dbi: ArrayLike,
    wavelength_m: ArrayLike,
    rcs_m2: ArrayLike,
    integration_s: ArrayLike,
    bandwidth_hz: ArrayLike,
    range_tx_m: ArrayLike,
    range_rx_m: ArrayLike,
    baseline_m: ArrayLike,
    loss_db: ArrayLike,
    external_noise_db: ArrayLike,
    sidelobe_db: ArrayLike,
    cancellation_db: ArrayLike,
    line_loss_db: ArrayLike = 0.5,
    antenna_loss_db: ArrayLike = 0.5,
    noise_figure_db: ArrayLike = 4.0,
) -> Floats:
    """Mean signal-to-noise ratio, linear, of a passive radar without clutter (eqs 24 to 31)."""
    target_w = passive_target_power_w(
        erp_w=erp_w,
        gain_rx_dbi=gain_rx_dbi,
        wavelength_m=wavelength_m,
        rcs_m2=rcs_m2,
        range_tx_m=range_tx_m,
        range_rx_m=range_rx_m,
        loss_db=loss_db,
    )
    direct_w = propagation.direct_signal_power_w(
        erp_w=erp_w,
        gain_rx_dbi=gain_rx_dbi,
        sidelobe_db=sidelobe_db,
        cancellation_db=cancellation_db,
        wavelength_m=wavelength_m,
        baseline_m=baseline_m,
    )
    noise_w = propagation.passive_noise_power_w(
        bandwidth_hz, external_noise_db, line_loss_db, antenna_loss_db, noise_figure_db
    )
    time_bandwidth = np.multiply(integration_s, bandwidth_hz)
    return propagation.correlated_snr(target_w, direct_w + noise_w, time_bandwidth)


def passive_target_power_w(
    *,
    erp_w: ArrayLike,
    gain_rx_dbi: ArrayLike,
    wavelength_m: ArrayLike,
    rcs_m2: ArrayLike,
    range_tx_m: ArrayLike,
    range_rx_m: ArrayLike,
    loss_db: ArrayLike,
) -> Floats:
    """Echo of a broadcast before the correlator (eqs 24, 26); ERP is stated over a dipole."""
    return propagation.echo_power_w(
        power_w=erp_w,
        gains_db=propagation.DIPOLE_GAIN_DBI + as_floats(gain_rx_dbi) - as_floats(loss_db),
        wavelength_m=wavelength_m,
        rcs_m2=rcs_m2,
        range_tx_m=range_tx_m,
        range_rx_m=range_rx_m,
    )
