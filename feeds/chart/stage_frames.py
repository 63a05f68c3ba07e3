"""Frames: from where a drone is on Earth to what of it is measured from the sensor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Decimal
from functools import partial

import numpy as np

from plotfeed.feeds.chart import alternatives_frames as alternatives
from plotfeed.feeds.chart.case import Case
from plotfeed.feeds.chart.stage import Alternative, Stage, rms
from plotfeed.models.frames import enu_to_aer, geodetic_to_ecef, wrap_180
from plotfeed.models.state import Floats
from plotfeed.proto.errors import PlotfeedError

OURS = "ECEF and rotation"


def frames(case: Case) -> Stage:
    """From truth in the form in which each way keeps it, geodetic or ECEF."""
    n = min(case.effort.references, len(case.seen))
    true = [case.precisely(row) for row in range(n)]
    return Stage(
        name="frames",
        question="How to turn places on Earth into range and angles",
        alternatives=tuple(
            Alternative(
                name=name,
                run=partial(_measured, way),
                units=len(case.seen),
                errors=errors_beside(case.measured(way()[:n], np.arange(n)), true),
                ours=name == OURS,
            )
            for name, way in _ways(case).items()
        ),
    )


def errors_beside(
    measured: dict[str, Floats], true: Sequence[dict[str, Decimal]]
) -> dict[str, float]:
    """Rms errors by quantity; each difference is taken before it is rounded to a float."""
    errors = {}
    for name, values in measured.items():
        pairs = zip(values.tolist(), true, strict=True)
        differences = np.array([float(Decimal(value) - exact[name]) for value, exact in pairs])
        errors[name] = rms(wrap_180(differences) if name.endswith("_deg") else differences)
    return errors


def _measured(way: Callable[[], Floats]) -> object:
    return enu_to_aer(way())


def _ways(case: Case) -> dict[str, Callable[[], Floats]]:
    here, seen = case.frame, case.seen
    geodetic = (seen.latitude_deg, seen.longitude_deg, seen.height_m)
    ecef_m = seen.ecef_m
    ways: dict[str, Callable[[], Floats]] = {
        "flat Earth": partial(alternatives.flat_earth(here), *geodetic),
        "flat, ellipsoidal": partial(alternatives.ellipsoidal_flat(here), *geodetic),
        "second order": partial(alternatives.second_order(here), *geodetic),
        "ECEF in float32": partial(alternatives.single_ecef(here), ecef_m.astype(np.float32)),
        OURS: partial(here.from_ecef, ecef_m),
        "geodetic, by ECEF": lambda: here.from_ecef(geodetic_to_ecef(*geodetic)),
    }
    try:
        return ways | {"pyproj": partial(alternatives.by_pyproj(here), *geodetic)}
    except PlotfeedError:
        return ways
