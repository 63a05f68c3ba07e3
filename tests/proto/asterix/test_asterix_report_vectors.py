"""Byte for byte what libasterix sends; vectors/make_reports.py made and explains the vectors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.asterix_input import plots, tracks

from plotfeed.proto.asterix.cat015 import Geometry, PlotEncoder015
from plotfeed.proto.asterix.cat016 import Component, Pair, System, SystemEncoder016
from plotfeed.proto.asterix.cat025 import StatusEncoder025
from plotfeed.proto.asterix.cat062 import StatusEncoder063, TrackEncoder062
from plotfeed.proto.asterix.cat205 import BearingEncoder205

VECTORS = json.loads((Path(__file__).parent / "vectors" / "reports.json").read_text())
SOURCE = 25, 3
SECOND_NS = 1_700_006_401 * 10**9
BOTH_PATHS = pytest.mark.parametrize("n", [1, 100])
SITE = {"latitude_deg": 40.45, "longitude_deg": -3.73}


def repeated(columns: dict[str, Any], n: int) -> dict[str, list[Any]]:
    """Columns of n equal rows."""
    return {name: [value] * n for name, value in columns.items()}


def records(blocks: list[bytes]) -> bytes:
    """What is in data blocks."""
    assert all(int.from_bytes(block[1:3], "big") == len(block) for block in blocks)
    return b"".join(block[3:] for block in blocks)


@BOTH_PATHS
@pytest.mark.parametrize("vector", VECTORS["plots"], ids=lambda v: v["case"])
def test_plots_in_015(vector: dict[str, Any], n: int) -> None:
    expected = bytes.fromhex(vector["block"])
    geometry = Geometry(vector["geometry"])
    encoder = PlotEncoder015(*SOURCE, geometry=geometry, classes={"multirotor": 300})
    many = plots(**repeated({"range_m": np.nan} | vector["plot"], n))
    sent = encoder.blocks(many, 41)
    if n == 1:
        assert sent == [expected]
    elif geometry is Geometry.MULTISTATIC:  # observations count on
        assert len(records(sent)) == len(expected[3:]) * n
        assert records(sent).startswith(expected[3:])
    else:
        assert records(sent) == expected[3:] * n


@BOTH_PATHS
@pytest.mark.parametrize("vector", VECTORS["bearings"], ids=lambda v: v["case"])
def test_bearings_in_205(vector: dict[str, Any], n: int) -> None:
    expected = bytes.fromhex(vector["block"])
    encoder = BearingEncoder205(*SOURCE, **SITE)
    sent = encoder.blocks(plots(**repeated(vector["plot"], n)), vector["sent_utc_ns"], 255)
    assert sent[0] == expected
    number = expected.index(b"\xff\x00\x73")
    assert {block[:number] + block[number + 1 :] for block in sent} == {
        expected[:number] + expected[number + 1 :]
    }
    assert [block[number] for block in sent] == [(255 + row) % 256 for row in range(n)]


@BOTH_PATHS
@pytest.mark.parametrize("vector", VECTORS["tracks"], ids=lambda v: v["case"])
def test_tracks_in_062(vector: dict[str, Any], n: int) -> None:
    expected = bytes.fromhex(vector["block"])
    sent = TrackEncoder062(*SOURCE).blocks(tracks(**repeated(vector["track"], n)))
    assert records(sent) == expected[3:] * n


def test_systems_in_016() -> None:
    system = VECTORS["system"]
    transmitters = [Component(**station) for station in system["transmitters"]]
    receiver = Component(**system["receiver"])
    encoder = SystemEncoder016(
        [
            System(
                sac=SOURCE[0],
                sic=SOURCE[1],
                pairs=[Pair(identity=p, transmitter=t, receiver=r) for p, t, r in system["pairs"]],
                transmitters=transmitters,
                receivers=[receiver],
                reference=receiver,
            )
        ],
        period_s=10,
        geoid_undulation_m=52.0,
    )
    assert [block.hex() for block in encoder.blocks(SECOND_NS)] == system["blocks"]


def test_status_in_025_and_063() -> None:
    system = StatusEncoder025(*SOURCE, **SITE, height_m=652.0, geoid_undulation_m=52.0)
    once = np.array([SECOND_NS]), np.array([0])
    assert [block.hex() for block in system.blocks(*once)] == [VECTORS["status"]]
    tracker = StatusEncoder063(*SOURCE).blocks(*once)
    assert [block.hex() for block in tracker] == [VECTORS["tracker"]]
