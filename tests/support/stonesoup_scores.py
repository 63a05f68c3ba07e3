"""Scores by Stone Soup: run by the Python of .venv-stonesoup, JSON in and out.

In: {"cutoff_m", "truths": {NAME: [[second, x, y], ...]}}, with "scans": [[second, [[x, y], ...]]]
and "sigma_m", on which three of its trackers run, or "tracks": {NUMBER: [[second, x, y], ...]}.
Out:
{TRACKER: {"tracks", "siap"}}, SIAP and ID-SIAP by their titles, where a track's identity is the
drone that it was nearest to at first.

Or sets, instant by instant.

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
    if "truths" in asked:
        json.dump(of_runs(asked), sys.stdout)
        return
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


BEGIN = datetime.datetime(2026, 1, 1)  # noqa: DTZ001 - as Stone Soup's times are


def of_runs(asked: dict[str, Any]) -> dict[str, Any]:
    """Tracks of each tracker with their scores, or the scores of given ones."""
    if "tracks" in asked:
        return {"given": {"siap": siap_of(asked, asked["tracks"])}}
    found = {}
    for name in ("gnn", "nearest", "jpda"):
        tracks = followed(asked, name)
        found[name] = {"tracks": tracks, "siap": siap_of(asked, tracks)}
    return found


def followed(asked: dict[str, Any], name: str) -> dict[str, list[list[float]]]:
    """What one of Stone Soup's trackers makes of scans: Kalman's filter, straight on."""
    import numpy as np
    from stonesoup.dataassociator.neighbour import GNNWith2DAssignment, NearestNeighbour
    from stonesoup.dataassociator.probability import JPDA
    from stonesoup.deleter.time import UpdateTimeStepsDeleter
    from stonesoup.hypothesiser.distance import DistanceHypothesiser
    from stonesoup.hypothesiser.probability import PDAHypothesiser
    from stonesoup.initiator.simple import MultiMeasurementInitiator
    from stonesoup.measures import Mahalanobis
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import (
        CombinedLinearGaussianTransitionModel,
        ConstantVelocity,
    )
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.tracker.simple import MultiTargetMixtureTracker, MultiTargetTracker
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import KalmanUpdater

    model = LinearGaussian(4, (0, 2), asked["sigma_m"] ** 2 * np.eye(2))
    predictor = KalmanPredictor(CombinedLinearGaussianTransitionModel([ConstantVelocity(1.0)] * 2))
    updater, deleter = KalmanUpdater(model), UpdateTimeStepsDeleter(4)
    by_distance = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=4)
    kinds = {"gnn": GNNWith2DAssignment, "nearest": NearestNeighbour}
    if name == "jpda":
        odds = PDAHypothesiser(predictor, updater, 1e-7, prob_detect=0.9)
        associator, kind = JPDA(odds), MultiTargetMixtureTracker
    else:
        associator, kind = kinds[name](by_distance), MultiTargetTracker
    prior = GaussianState([0, 0, 0, 0], np.diag([0.0, 15.0, 0.0, 15.0]) ** 2)
    initiator = MultiMeasurementInitiator(
        prior, deleter, GNNWith2DAssignment(by_distance), updater, model, min_points=3
    )
    scans = [
        (
            BEGIN + datetime.timedelta(seconds=second),
            {
                Detection([[x], [y]], timestamp=BEGIN + datetime.timedelta(seconds=second),
                          measurement_model=model)
                for x, y in places
            },
        )
        for second, places in asked["scans"]
    ]  # fmt: skip
    tracker = kind(initiator, deleter, iter(scans), associator, updater)
    numbers: dict[str, int] = {}
    found: dict[str, list[list[float]]] = {}
    for at, tracks in tracker:
        second = (at - BEGIN).total_seconds()
        for track in tracks:
            number = str(numbers.setdefault(track.id, len(numbers)))
            state = track.state.mean
            found.setdefault(number, []).append([second, float(state[0, 0]), float(state[2, 0])])
    return found


def siap_of(asked: dict[str, Any], tracks: dict[str, list[list[float]]]) -> dict[str, float]:
    """SIAP and ID-SIAP of tracks, (second, x, y), by their titles."""
    from stonesoup.dataassociator.tracktotrack import TrackToTruth
    from stonesoup.measures import Euclidean
    from stonesoup.metricgenerator.manager import MultiManager
    from stonesoup.metricgenerator.tracktotruthmetrics import IDSIAPMetrics
    from stonesoup.types.groundtruth import GroundTruthPath, GroundTruthState
    from stonesoup.types.state import State
    from stonesoup.types.track import Track

    def at(second: float) -> datetime.datetime:
        return BEGIN + datetime.timedelta(seconds=second)

    truths = {
        GroundTruthPath(
            [GroundTruthState([[x], [0], [y], [0]], timestamp=at(t), metadata={"who": name})
             for t, x, y in rows]
        )
        for name, rows in asked["truths"].items()
    }  # fmt: skip
    place = {(name, t): (x, y) for name, rows in asked["truths"].items() for t, x, y in rows}

    def nearest(row: list[float]) -> str:
        t, x, y = row
        there = {name: place[name, t] for name in asked["truths"] if (name, t) in place}
        return min(there, key=lambda name: (there[name][0] - x) ** 2 + (there[name][1] - y) ** 2)

    made = {
        Track(
            [State([[x], [0], [y], [0]], timestamp=at(t)) for t, x, y in rows],
            init_metadata={"who": nearest(rows[0])},
        )
        for rows in tracks.values()
    }
    measure = Euclidean(mapping=[0, 2])
    generator = IDSIAPMetrics(
        position_measure=measure,
        velocity_measure=Euclidean(mapping=[1, 3]),
        truth_id="who",
        track_id="who",
        tracks_key="tracks",
        truths_key="truths",
    )
    manager = MultiManager(
        [generator], TrackToTruth(asked["cutoff_m"], consec_pairs_confirm=2, measure=measure)
    )
    manager.add_data({"truths": truths, "tracks": made})
    found = manager.generate_metrics()[generator.generator_name]
    return {
        title: float(metric.value)
        for title, metric in found.items()
        if isinstance(metric.value, int | float)
    }


if __name__ == "__main__":
    main()
