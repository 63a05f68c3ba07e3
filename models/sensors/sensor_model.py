"""What every sensor model takes, gives and can do, whatever the physics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.beam.scan import Sector
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.state import Floats, Ints, Looks, Plots, Signatures

if TYPE_CHECKING:
    from plotfeed.models.effects.readings import Readings

NO_PLOTS = Plots.of(t_utc_ns=np.zeros(0, np.int64))
NO_LOOKS = Looks.none()


@dataclass(frozen=True, slots=True, kw_only=True)
class Targets:
    """Drones seen from a sensor, (n, 3), at the times of measurement.

    `true_position_enu_m` is where the drone is at that time, east, north and up of the sensor,
    `position_enu_m` from where it is sensed, along the sensor's own axes: the same array, unless it
    is sound that comes from where the drone was, or the sensor stands askew. Velocities are east,
    north and up, for sensors that measure them; `readings` for sensors that err in them.
    """

    drone: Ints
    t_utc_ns: Ints
    position_enu_m: Floats
    true_position_enu_m: Floats
    signatures: Signatures
    velocity_enu_m_s: Floats | None = None
    readings: Readings | None = None

    def __len__(self) -> int:
        return len(self.drone)

    def rcs_m2(self, rows: Ints | slice = slice(None)) -> Floats:
        """Radar cross-sections of those rows; (m,)."""
        return self.signatures.rcs_m2[self.drone[rows]]

    def sound_power_db(self, rows: Ints | slice = slice(None)) -> Floats:
        """Sound power levels of those rows, dB re 1 pW; (m,)."""
        return self.signatures.sound_power_db[self.drone[rows]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """What to expect of a sensor's plots of targets, (n,); NaN for what it does not measure.

    `snr` is the mean one, linear, `pd` the probability that the target is reported at all, and the
    sigmas are rms errors over the reports, about what biased readings lead to.
    """

    snr: Floats
    pd: Floats
    sigma_range_m: Floats
    sigma_azimuth_deg: Floats
    sigma_elevation_deg: Floats
    sigma_range_rate_m_s: Floats | None = None


class SensorModel(Protocol):
    """A sensor, frozen: randomness is an argument."""

    @property
    def range_max_m(self) -> float:
        """Nothing further away is ever looked at."""

    @property
    def signal_speed_m_s(self) -> float | None:
        """How fast what it senses travels; None where that takes no time worth modelling."""

    @property
    def measures_range_rate(self) -> bool:
        """Whether it needs to know how fast targets are."""

    @property
    def false_alarms_per_scan(self) -> float:
        """Their mean number."""

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """One look at each target: those within cover, and the plots of those detected.

        Heights are left out: they take the sensor's place on Earth.
        """

    def draw_false_alarms(self, sector: Sector, rng: np.random.Generator) -> Plots:
        """The false alarms of one sector of a scan, with the times at which they came."""

    def predict(self, targets: Targets) -> Prediction:
        """What `observe` comes to over many scans, had the targets stayed there; all in cover.

        Rates of range count where velocities are given.
        """


def true_geometry(
    looks: Looks, targets: Targets, *rows: NDArray[Any] | slice
) -> dict[str, NDArray[Any]]:
    """The true columns of plots of those looks: these rows of the targets, of them these; (n,)."""
    azimuth_deg, elevation_deg, range_m = looks.azimuth_deg, looks.elevation_deg, looks.range_m
    if targets.true_position_enu_m is not targets.position_enu_m:
        position_enu_m = targets.true_position_enu_m
        for which in rows:
            position_enu_m = position_enu_m[which]
        azimuth_deg, elevation_deg, range_m = enu_to_aer(position_enu_m)
    return {
        "true_azimuth_deg": azimuth_deg,
        "true_elevation_deg": elevation_deg,
        "true_range_m": range_m,
    }
