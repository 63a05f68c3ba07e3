"""The paper's scenario from end to end: what each sensor's equations give along the approach.

A Phantom 4 (0.01 m2, 80 dB, 50 m up) flies straight in; Pfa 1e-6, 16 reference cells. The values
were worked out apart from this code, for the right forms of the equations.
"""

from __future__ import annotations

import numpy as np
import pytest

from plotfeed.models import detection, propagation
from plotfeed.models.propagation import C_M_S

RCS_M2 = 0.01
PFA = 1e-6


def test_active_radar():
    ranges = np.array([7e3, 5e3, 4e3])
    case = (500, 20, 35.4, C_M_S / 10e9, RCS_M2, 0.06, ranges, ranges, 4, 5)
    pd = detection.pd_cfar_swerling1(propagation.radar_snr(*case), PFA, 16)
    assert pd == pytest.approx([0.965, 0.991, 0.996], abs=5e-4)


def test_mimo_radar_of_three_transmitters():
    ranges = np.array([5e3, 4e3, 3e3])
    case = (2000, 11.6, 11.6, C_M_S / 15e9, RCS_M2, 0.06, ranges, ranges, 2, 5)
    snr = propagation.radar_snr(*case)
    pd = detection.pd_noncoherent_swerling2(snr, PFA, 3)
    assert pd == pytest.approx([0.268, 0.739, 0.977], abs=5e-4)
    looks = np.repeat(snr[:, None], 3, axis=1)
    assert detection.pd_noncoherent_unequal(looks, PFA) == pytest.approx(pd, rel=1e-12)


def test_microphone():
    ranges = np.array([200.0, 150.0, 100.0, 75.0])
    ground_db = propagation.ground_attenuation_db((50 + 1.5) / 2, ranges)
    attenuation_db = propagation.sound_divergence_db(ranges) + 0.005 * ranges + ground_db + 3 + 3
    level_db = propagation.sound_level_db(80, 3, attenuation_db)
    pd = detection.pd_logistic(level_db + 9.03, 32)
    assert pd == pytest.approx([0.018, 0.224, 0.926, 0.994], abs=5e-4)
