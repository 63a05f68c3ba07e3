"""Plots of a radar as detections of Stone Soup, and its own tracker on them.

    plotfeed run examples/scenes/radar-udp.toml --speed max --duration 60 --record radar.mcap
    plotfeed convert radar.mcap radar-plots.parquet
    python examples/stonesoup_tracks.py radar-plots.parquet

Needs stonesoup and pyarrow.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from datetime import datetime, timedelta

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
from stonesoup.base import Property
from stonesoup.buffered_generator import BufferedGenerator
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
from stonesoup.reader.base import DetectionReader
from stonesoup.tracker.simple import MultiTargetTracker
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.updater.kalman import ExtendedKalmanUpdater

COLUMNS = ("range_m", "azimuth_deg", "elevation_deg")
SIGMAS = ("sigma_range_m", "sigma_azimuth_deg", "sigma_elevation_deg")


class PlotfeedParquetReader(DetectionReader):
    """Detections of one sensor, a scan at a time; east, north and up of it, with stated errors."""

    path: str = Property(doc="A table of plots, as plotfeed converts recordings to.")
    sensor: str = Property(doc="Whose plots.")
    period_s: float = Property(default=1.0, doc="Of its scans.")

    @BufferedGenerator.generator_method
    def detections_gen(self) -> Iterator[tuple[datetime, set[Detection]]]:
        """Scans that have plots, at their ends."""
        names = ["time_utc", "sensor", "category", *COLUMNS, *SIGMAS]
        table = pq.read_table(self.path, columns=names)
        # The batches, not the blocks of ASTERIX that tell of the same plots less exactly.
        table = table.filter(pc.equal(table["sensor"], self.sensor))
        table = table.filter(pc.is_null(table["category"]))
        time_ns = table["time_utc"].cast("int64").to_numpy()
        values = np.stack([table[name].to_numpy() for name in (*COLUMNS, *SIGMAS)], axis=1)
        scans = time_ns // round(self.period_s * 1e9)
        for scan in np.unique(scans):
            since = timedelta(seconds=(int(scan) + 1) * self.period_s)
            end = datetime(1970, 1, 1) + since  # noqa: DTZ001 - UTC, as Stone Soup's times are
            yield end, {self._detection(row, end) for row in values[scans == scan]}

    @staticmethod
    def _detection(row: np.ndarray, end: datetime) -> Detection:
        range_m, azimuth_deg, elevation_deg, *sigmas = row
        # Bearings of Stone Soup count from x, which is east, towards y, which is north.
        bearing = np.radians(90.0 - azimuth_deg)
        bearing = (bearing + np.pi) % (2 * np.pi) - np.pi
        sigma = [np.radians(sigmas[2]), np.radians(sigmas[1]), sigmas[0]]
        model = CartesianToElevationBearingRange(
            ndim_state=6, mapping=(0, 2, 4), noise_covar=np.diag(np.square(sigma))
        )
        state = [[np.radians(elevation_deg)], [bearing], [range_m]]
        return Detection(state, timestamp=end, measurement_model=model)


def tracker_of(detector: DetectionReader) -> MultiTargetTracker:
    """Constant velocity, global nearest neighbour, three plots to begin, five misses to end."""
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(9.0)] * 3)
    predictor, updater = ExtendedKalmanPredictor(motion), ExtendedKalmanUpdater(None)
    hypothesiser = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=4)
    associator, deleter = GNNWith2DAssignment(hypothesiser), UpdateTimeStepsDeleter(5)
    at_rest = GaussianState([[0.0]] * 6, np.diag([0.0, 225.0] * 3))
    initiator = MultiMeasurementInitiator(
        at_rest, deleter, associator, updater, measurement_model=None, min_points=3
    )
    return MultiTargetTracker(initiator, deleter, detector, associator, updater)


def main() -> None:
    """Print where each track ended, east, north and up of the sensor."""
    sensor = sys.argv[2] if len(sys.argv) > 2 else "radar"
    tracks = set()
    for _, living in tracker_of(PlotfeedParquetReader(sys.argv[1], sensor)):
        tracks |= living
    for track in sorted(tracks, key=len, reverse=True):
        east_m, north_m, up_m = (float(track.state_vector[i]) for i in (0, 2, 4))
        print(f"{len(track)} scans, at the end {east_m:.0f} {north_m:.0f} {up_m:.0f} m")


if __name__ == "__main__":
    main()
