"""Byte for byte what libasterix sends; vectors/make_vectors.py made and explains them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.asterix_input import plots

from plotfeed.proto.asterix.cat048 import PlotEncoder048, ServiceEncoder034

FIRST = np.array([0])

VECTORS = json.loads((Path(__file__).parent / "vectors" / "vectors.json").read_text())
SOURCE = VECTORS["sac"], VECTORS["sic"]


@pytest.mark.parametrize("vector", VECTORS["plots"], ids=lambda v: v["case"])
@pytest.mark.parametrize("n", [1, 1000])
def test_plots(vector: dict[str, Any], n: int) -> None:
    expected = bytes.fromhex(vector["block"])
    encoder = PlotEncoder048(*SOURCE, max_octets=3 + len(expected[3:]) * 2 - 1 if n > 1 else 1400)
    many = plots(**{name: [value] * n for name, value in vector["plot"].items()})
    assert encoder.blocks(many) == [expected] * n


@pytest.mark.parametrize("vector", VECTORS["services"], ids=lambda v: v["case"])
def test_service_messages(vector: dict[str, Any]) -> None:
    encoder = ServiceEncoder034(
        *SOURCE, antenna_period_s=VECTORS["antenna_period_s"], place=VECTORS["place"]
    )
    t_utc_ns, azimuth_deg = vector["t_utc_ns"], vector["azimuth_deg"]
    (block,) = (
        encoder.north_markers([t_utc_ns], FIRST)
        if azimuth_deg is None
        else encoder.sector_crossings([t_utc_ns], [azimuth_deg], FIRST)
    )
    assert block == bytes.fromhex(vector["block"])
