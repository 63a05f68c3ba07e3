"""Factors of a degraded sensor where they leave nothing of a probability."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.significance import assert_sum

from plotfeed.models.beam import Sector
from plotfeed.testing import scene, staring

BEAMS = 18
MICROPHONES: dict[str, Any] = {
    "id": "mic", "type": "acoustic", "scan": staring(), "noise_db": 0.0, "sensitivity_db": 0.0,
    "range_max_m": 1000.0, "azimuth_beamwidth_deg": 20.0, "pfa": 0.01, "report": ["plots"],
}  # fmt: skip


def test_more_alarms_than_there_are_cells_keep_their_mean() -> None:
    """A thousand times the alarms of a Pfa of 0.01: ten a cell, which no Pfa gives."""
    made = scene([MICROPHONES | {"degradation": {"false_alarm_factor": 1000.0}}], seed=1)
    model = made.sensor[0].model(made.scene.site)
    assert model.false_alarms_per_scan == pytest.approx(10 * BEAMS, rel=1e-12)
    sector = Sector(0, 0, 0, 1_000_000_000, 0.0, 360.0, stares=True)
    rng = np.random.default_rng(1)
    n = sum(len(model.draw_false_alarms(sector, rng)) for _ in range(100))
    assert_sum(float(n), 1000.0 * BEAMS, 1000.0 * BEAMS * 0.99, "alarms of 100 scans")
