"""The paper's section 4 as it comes with plotfeed: Pd 0.965 at 7 km, computed and flown."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from support.significance import assert_sum

from plotfeed.feeds.scene.drones import Drone
from plotfeed.feeds.scene.scene import example
from plotfeed.testing import SITE, Feed, fly, held

TURNS = 20
DRONES = 200


@cache
def road() -> Feed:
    """Drones like its own held at 7 km all round its own radar, which turns on."""
    bundled = example("section-4")
    site = bundled.scene.site
    assert (site.latitude_deg, site.longitude_deg, site.height_m) == (
        SITE.latitude_deg,
        SITE.longitude_deg,
        SITE.height_m,
    )
    (phantom,) = bundled.drone
    drones = tuple(
        Drone.model_validate(
            held(f"d{i}", 1.8 * i + 0.5, 0.41, 7000.0, rcs_m2=phantom.rcs_m2), strict=False
        )
        for i in range(DRONES)
    )
    return fly(bundled.model_copy(update={"drone": drones}), TURNS)


def test_odds_at_7_km_are_those_of_the_paper() -> None:
    np.testing.assert_allclose(road().looks("active").pd, 0.965, rtol=0, atol=5e-4)


def test_detections_at_7_km_are_as_many() -> None:
    looks, plots = road().looks("active"), road().plots("active")
    assert len(looks) == pytest.approx(TURNS * DRONES, abs=DRONES)
    reported = int((plots.drone != "").sum())
    mean, variance = float(looks.pd.sum()), float((looks.pd * (1 - looks.pd)).sum())
    assert_sum(reported, mean, variance)
    assert reported / len(looks) == pytest.approx(0.965, abs=0.01)
    assert len(plots.rho_nm) == len(plots)


def test_the_approach_is_detected_from_its_start_on() -> None:
    """The bundled flight: its drone comes from 7 km at 20 m/s, and few turns miss it."""
    approach = fly(example("section-4"), 120)
    looks, plots = approach.looks("active"), approach.plots("active")
    assert looks.range_m[0] == pytest.approx(7000, abs=20)
    assert len(looks) >= 119
    reported = int((plots.drone != "").sum())
    assert_sum(reported, looks.pd.sum(), (looks.pd * (1 - looks.pd)).sum())
    assert looks.pd.min() > 0.96
