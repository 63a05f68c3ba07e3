from __future__ import annotations

import numpy as np
import pytest

from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.feeds.telemetry.position_report import AltitudeDatum, Reason, Refused
from plotfeed.models.frames import geoid_undulation_m
from plotfeed.models.state import AltitudeReference

REFERENCES = list(AltitudeReference)
LATITUDES, LONGITUDES = [40.45, 5.0, -8.0], [-3.73, 79.0, 147.0]


def heights(datum: AltitudeDatum, reference: AltitudeReference) -> list[float]:
    found: list[float] = datum.heights_m(LATITUDES, LONGITUDES, [100.0] * 3, [reference] * 3)
    return list(found)


def test_each_reference_gives_a_height_above_the_ellipsoid() -> None:
    datum = AltitudeDatum(takeoff_height_m=650.0, sea_level=SeaLevel(51.0))
    assert heights(datum, AltitudeReference.ELLIPSOID) == [100.0] * 3
    assert heights(datum, AltitudeReference.ABOVE_TAKEOFF) == [750.0] * 3
    assert heights(datum, AltitudeReference.MEAN_SEA_LEVEL) == [151.0] * 3


def test_sea_level_is_that_of_each_place_unless_it_is_stated() -> None:
    found = heights(AltitudeDatum(), AltitudeReference.MEAN_SEA_LEVEL)
    assert found == list(100.0 + geoid_undulation_m(LATITUDES, LONGITUDES))
    assert np.ptp(found) > 150.0


def test_references_may_be_mixed() -> None:
    datum = AltitudeDatum(650.0)
    found = datum.heights_m(LATITUDES, LONGITUDES, [100.0] * 3, REFERENCES)
    for i, reference in enumerate(REFERENCES):
        assert found[i] == heights(datum, reference)[i]


def test_without_a_takeoff_height_the_key_is_named() -> None:
    for reference in REFERENCES:
        AltitudeDatum(650.0).check(reference)
    AltitudeDatum().check(AltitudeReference.MEAN_SEA_LEVEL)
    with pytest.raises(Refused, match=r"telemetry\.takeoff_height_m") as caught:
        AltitudeDatum().check(AltitudeReference.ABOVE_TAKEOFF)
    assert caught.value.reason is Reason.ALTITUDE
