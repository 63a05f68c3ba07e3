"""One sample of telemetry given to trajectories, as tests have them, one at a time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plotfeed.models.state import Signature, Signatures
from plotfeed.models.truth import FlightSamples, Trajectories


def add_sample(
    into: Trajectories,
    drone: str,
    t_utc_ns: int,
    *,
    latitude_deg: float,
    longitude_deg: float,
    height_m: float,
    velocity_enu_m_s: Sequence[float] | None,
    sigma_m: float | None,
    signature: Signature,
) -> None:
    """Add it as `add_samples` does."""
    samples = FlightSamples(
        t_utc_ns=np.array([t_utc_ns], np.int64),
        latitude_deg=np.array([latitude_deg]),
        longitude_deg=np.array([longitude_deg]),
        height_m=np.array([height_m]),
        velocity_enu_m_s=np.array([velocity_enu_m_s or [np.nan] * 3], float),
        sigma_m=np.array([np.nan if sigma_m is None else sigma_m]),
    )
    into.add_samples([drone], samples, Signatures.of_one(signature))
