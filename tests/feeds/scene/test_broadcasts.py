"""Kinds of broadcast as illuminators: what they give, and that a scene goes before them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from plotfeed.feeds.scene.scene import Scene, SceneError
from plotfeed.feeds.scene.sensors.illuminator_keys import OF_A_KIND, broadcasts
from plotfeed.models.propagation import C_M_S
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.testing import scene, staring, waypoint

PLACE = waypoint(90.0, 0.2, 20_000.0)


def passive(*transmitters: dict[str, Any]) -> dict[str, Any]:
    return {
        "id": "passive", "type": "passive_radar", "scan": staring(), "gain_rx_dbi": 10.0,
        "transmitters": [{"place": PLACE} | each for each in transmitters],
        "azimuth_beamwidth_deg": 10.0, "integration_s": 0.3, "external_noise_db": 0.0,
        "range_max_m": 10_000.0,
    }  # fmt: skip


def of(*transmitters: dict[str, Any]) -> Scene:
    return scene([passive(*transmitters)], seed=1)


@pytest.mark.parametrize("kind", broadcasts())
def test_a_kind_gives_what_the_scene_does_not(kind: str) -> None:
    (found,) = of({"id": "a", "preset": kind}).sensor[0].illuminators
    told = broadcasts()[kind]
    assert {key: getattr(found, key) for key in OF_A_KIND} == {
        k: told[k]["value"] for k in OF_A_KIND
    }
    (other,) = of({"id": "a", "preset": kind, "erp_w": 77.0}).sensor[0].illuminators
    assert (other.erp_w, other.frequency_hz) == (77.0, found.frequency_hz)
    assert all(told[key]["note"] for key in OF_A_KIND)  # why it is that


def test_cells_of_range_are_those_of_the_bandwidth() -> None:
    """The broadcast of the paper's 189 MHz is resolved to 195 m, television to 39 m."""
    made = of(*({"id": kind, "preset": kind} for kind in broadcasts()))
    model = made.sensor[0].model(made.scene.site)
    assert isinstance(model, PassiveRadar)
    cells_m = dict(zip(broadcasts(), model.range_resolution_m, strict=True))
    assert cells_m["dab"] == pytest.approx(195.2, abs=0.1)
    assert cells_m["dvb-t"] == pytest.approx(39.4, abs=0.1)
    assert cells_m["gsm"] == pytest.approx(C_M_S / 200e3)
    assert np.rint(C_M_S / model.wavelengths_m[0] / 1e6) == 189


def test_a_kind_that_nobody_has_is_told_with_those_that_there_are() -> None:
    with pytest.raises(SceneError) as caught:
        of({"id": "a", "preset": "am", "erp_w": 1.0, "frequency_hz": 1e6, "bandwidth_hz": 1e4})
    ((key, text),) = caught.value.problems
    assert key == "sensor[0].transmitters[0].preset"
    assert "'dab', 'dvb-t', 'fm' or 'gsm'" in text
