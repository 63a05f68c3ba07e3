"""Drones as a sensor model is given them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Emitter, Signature, Signatures
from plotfeed.models.truth import FlightSamples, Trajectories


def targets_at(
    places_enu_m: Any,
    *,
    rcs_m2: float = 0.01,
    sound_power_db: Any = 80.0,
    emitters: Sequence[tuple[Emitter, ...]] | None = None,
    size_m: float = np.nan,
    t_utc_ns: int = 0,
    true_enu_m: Any = None,
    velocity_enu_m_s: Any = None,
) -> Targets:
    """A drone at each place, (n, 3) or (3,), all alike, looked at then."""
    places_m = np.asarray(places_enu_m, dtype=np.float64).reshape(-1, 3)
    n = len(places_m)
    velocity = None if velocity_enu_m_s is None else np.broadcast_to(velocity_enu_m_s, (n, 3))
    return Targets(
        drone=np.arange(n),
        t_utc_ns=np.full(n, t_utc_ns, np.int64),
        position_enu_m=places_m,
        true_position_enu_m=places_m if true_enu_m is None else true_enu_m,
        velocity_enu_m_s=velocity,
        signatures=Signatures(
            rcs_m2=np.full(n, rcs_m2),
            sound_power_db=np.broadcast_to(np.float64(sound_power_db), n),
            emitters=[()] * n if emitters is None else list(emitters),
            size_m=np.full(n, size_m),
        ),
    )


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
