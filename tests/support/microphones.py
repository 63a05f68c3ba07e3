"""The microphone array of section 4 of the paper, and drones that it may hear."""

from __future__ import annotations

from typing import Any

import numpy as np

from plotfeed.models.beam import AzimuthCover
from plotfeed.models.sensors.acoustic import MicrophoneArray
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Signatures

SECTION_4 = MicrophoneArray(
    frequency_hz=1000.0,
    directivity_db=3.0,
    absorption_db_per_m=0.005,
    barrier_db=3.0,
    misc_db=3.0,
    array_gain_db=9.03,
    noise_db=0.0,
    sensitivity_db=32.0,
    slope_per_db=1.0,
    pfa=1e-6,
    range_max_m=1000.0,
    height_above_ground_m=1.5,
    sound_speed_m_s=343.2,
    azimuth_cover=AzimuthCover(-180.0, 180.0),
    azimuth_beamwidth_deg=11.0,
    elevation_beamwidth_deg=None,
    azimuth_floor_deg=0.0,
    elevation_floor_deg=0.0,
    kind="",
)


def sounding(
    t_utc_ns: int, position_enu_m: Any, sound_power_db: Any = 80.0, true_enu_m: Any = None
) -> Targets:
    """Drones as they are looked at then, from the array; the sound is of where they were."""
    positions = np.asarray(position_enu_m, dtype=np.float64).reshape(-1, 3)
    n = len(positions)
    return Targets(
        drone=np.arange(n),
        t_utc_ns=np.full(n, t_utc_ns),
        position_enu_m=positions,
        true_position_enu_m=positions if true_enu_m is None else true_enu_m,
        signatures=Signatures(
            rcs_m2=np.full(n, 0.01),
            sound_power_db=np.broadcast_to(np.float64(sound_power_db), n),
            emitters=[()] * n,
        ),
    )
