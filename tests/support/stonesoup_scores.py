"""GOSPA and OSPA of sets by Stone Soup: run by the Python of .venv-stonesoup, JSON in and out.

In: {"cutoff_m", "order", "steps": [[drones, tracks], ...]}, places as lists of [x, y]. Out: GOSPA
with its parts, and OSPA, of each step, and the seconds of processor time that they took. Stone Soup
pairs for OSPA by distances and not by their powers: beyond order 1 its OSPA may be the larger.
"""

from __future__ import annotations

import datetime
import json
import sys
import time
import warnings
from typing import Any


def main() -> None:
    """Answer one question."""
    warnings.simplefilter("ignore")
    from stonesoup.measures import Euclidean
    from stonesoup.metricgenerator.ospametric import GOSPAMetric, OSPAMetric
    from stonesoup.types.state import State

    asked = json.load(sys.stdin)
    how = {"p": asked["order"], "c": asked["cutoff_m"], "measure": Euclidean(mapping=[0, 1])}
    gospa, ospa = GOSPAMetric(**how), OSPAMetric(**how)
    found: dict[str, Any] = {"gospa": [], "ospa": []}
    at = datetime.datetime(2026, 1, 1)  # noqa: DTZ001 - as Stone Soup's times are
    sets = [
        [[State([[x], [y]], timestamp=at) for x, y in places] for places in step]
        for step in asked["steps"]
    ]
    begin = time.process_time()
    for truth, measured in sets:
        value = gospa.compute_gospa_metric(measured, truth)[0].value
        found["gospa"].append({name: float(part) for name, part in value.items()})
        found["ospa"].append(float(ospa.compute_OSPA_distance(measured, truth).value))
    found["seconds"] = time.process_time() - begin
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
