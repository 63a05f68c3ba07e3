"""Stone Soup's tracker as a tracker under test: plots of one radar in by MQTT, tracks out.

In an environment of its own, from the clone:

    python3 -m venv .venv-stonesoup
    .venv-stonesoup/bin/pip install stonesoup paho-mqtt -e .
    .venv-stonesoup/bin/python examples/stonesoup_tracker.py [HOST [PORT [PREFIX [TOPIC [SENSOR]]]]]

It follows SENSOR, or the first that tells ranges, an extended Kalman filter and global nearest
neighbour at the end of every scan, and publishes its tracks on TOPIC as JSON.
"""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from datetime import datetime, timedelta
from typing import Any

import numpy as np
import paho.mqtt.client as paho
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.deleter.time import UpdateTimeStepsDeleter
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.initiator.simple import MultiMeasurementInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.measurement.nonlinear import CartesianToElevationBearingRange
from stonesoup.models.transition.linear import (
    CombinedLinearGaussianTransitionModel,
    ConstantVelocity,
)
from stonesoup.predictor.kalman import ExtendedKalmanPredictor
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.types.track import Track
from stonesoup.updater.kalman import ExtendedKalmanUpdater

from plotfeed.models.frames import LocalFrame
from plotfeed.proto import plotfeed_pb2 as pb

EPOCH = datetime(1970, 1, 1)  # noqa: DTZ001 - UTC, as Stone Soup's times are
UNMEASURED_DEG = 3.0  # Standard deviation of the elevation where a radar measures none


class Tracker:
    """Stone Soup's parts, fed scan by scan with one radar's plots."""

    def __init__(self, told: dict[str, Any]) -> None:
        self.frame = LocalFrame(told["latitude_deg"], told["longitude_deg"], told["height_m"])
        self.sectors = int(told.get("sectors", 1))
        self.period_s = float(told["scan_period_s"])
        motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(9.0)] * 3)
        predictor, self.updater = ExtendedKalmanPredictor(motion), ExtendedKalmanUpdater(None)
        hypothesiser = DistanceHypothesiser(
            predictor, self.updater, Mahalanobis(), missed_distance=4
        )
        self.associator = GNNWith2DAssignment(hypothesiser)
        self.deleter = UpdateTimeStepsDeleter(5)
        at_rest = GaussianState([[0.0]] * 6, np.diag([0.0, 225.0] * 3))
        self.initiator = MultiMeasurementInitiator(
            at_rest, self.deleter, self.associator, self.updater,
            measurement_model=None, min_points=3,
        )  # fmt: skip
        self.tracks: set[Track] = set()
        self.numbers: dict[str, int] = {}
        self.plots: list[pb.Plot] = []
        self.scan: int | None = None

    def take(self, batch: pb.PlotBatch) -> bytes:
        """The tracks at the end of a scan, as JSON; nothing before."""
        told = b""
        if self.scan is not None and batch.scan > self.scan:  # its last sector was lost
            told = self.ended()
        self.scan = batch.scan
        self.plots.extend(p for p in batch.plots if p.HasField("range_m"))
        return self.ended() if batch.sector == self.sectors - 1 else told

    def ended(self) -> bytes:
        """Work out what waits."""
        scan, self.scan = self.scan, None
        at = EPOCH + timedelta(seconds=(scan + 1) * self.period_s)
        detections, self.plots = {self.detection(plot, at) for plot in self.plots}, []
        used = set()
        hypotheses = self.associator.associate(self.tracks, detections, at)
        for track, hypothesis in hypotheses.items():
            if hypothesis:
                track.append(self.updater.update(hypothesis))
                used.add(hypothesis.measurement)
            else:
                track.append(hypothesis.prediction)
        self.tracks -= self.deleter.delete_tracks(self.tracks)
        self.tracks |= self.initiator.initiate(detections - used, at)
        return json.dumps([self.entry(track, at) for track in self.tracks]).encode()

    def detection(self, plot: pb.Plot, at: datetime) -> Detection:
        """A plot, as if it had been measured at the end of its scan."""
        # Bearings of Stone Soup count from x, which is east, towards y, which is north.
        bearing = (np.radians(90.0 - plot.azimuth_deg) + np.pi) % (2 * np.pi) - np.pi
        has = plot.HasField("elevation_deg")
        sigma_deg = plot.sigma_elevation_deg if has else UNMEASURED_DEG
        sigma = [np.radians(sigma_deg), np.radians(plot.sigma_azimuth_deg), plot.sigma_range_m]
        model = CartesianToElevationBearingRange(
            ndim_state=6, mapping=(0, 2, 4), noise_covar=np.diag(np.square(sigma))
        )
        state = [[np.radians(plot.elevation_deg)], [bearing], [plot.range_m]]
        return Detection(state, timestamp=at, measurement_model=model)

    def entry(self, track: Track, at: datetime) -> dict[str, Any]:
        """A track on the Earth."""
        number = self.numbers.setdefault(track.id, len(self.numbers) + 1)
        state = np.array(track.state_vector, np.float64).ravel()
        latitude_deg, longitude_deg, height_m = self.frame.to_geodetic(state[[0, 2, 4]])
        return {
            "track": number,
            "time_utc": at.isoformat(timespec="microseconds") + "Z",
            "latitude_deg": float(latitude_deg),
            "longitude_deg": float(longitude_deg),
            "height_m": float(height_m),
            "velocity_east_m_s": float(state[1]),
            "velocity_north_m_s": float(state[3]),
        }


def main() -> None:
    """Follow what comes until the broker or the user ends it."""
    usual = ("127.0.0.1", "1883", "plotfeed", "tracker/tracks", "")
    host, port, prefix, topic, wanted = (*sys.argv[1:], *usual[len(sys.argv) - 1 :])
    trackers: dict[str, Tracker] = {}

    def connected(client: paho.Client, *_: Any) -> None:
        client.subscribe([(f"{prefix}/+/description", 1), (f"{prefix}/+/plots", 0)])
        print(f"tracks of {prefix}/+/plots go to {topic}", flush=True)

    def described(_client: paho.Client, _userdata: Any, message: paho.MQTTMessage) -> None:
        told = json.loads(message.payload)
        is_it = told["sensor"] == wanted or (not wanted and told.get("range_kind") == "SLANT")
        if is_it and not trackers:
            trackers[told["sensor"]] = Tracker(told)

    def plotted(client: paho.Client, _userdata: Any, message: paho.MQTTMessage) -> None:
        tracker = trackers.get(message.topic.split("/")[-2])
        if tracker is not None:
            told = tracker.take(pb.PlotBatch.FromString(message.payload))
            if told:
                client.publish(topic, told)

    client = paho.Client(paho.CallbackAPIVersion.VERSION2)
    client.on_connect = connected
    client.message_callback_add(f"{prefix}/+/description", described)
    client.message_callback_add(f"{prefix}/+/plots", plotted)
    client.connect(host, int(port))
    with suppress(KeyboardInterrupt):
        client.loop_forever()


if __name__ == "__main__":
    main()
