"""What every sensor model takes, gives and can do, whatever the physics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plotfeed.models import false_alarms
from plotfeed.models.beam import AzimuthCover, Sector, beam_times_ns
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.sensors.stacking import Stackable
from plotfeed.models.state import Bools, Floats, Ints, Looks, Plots, Signature, Signatures, endless

if TYPE_CHECKING:
    from plotfeed.models.dwell_agenda import Agenda, PointedBeams
    from plotfeed.models.effects.classification import Confusion, HeldClaims
    from plotfeed.models.effects.decorrelation import TargetStrengths
    from plotfeed.models.effects.degradation import Degradation
    from plotfeed.models.effects.multipath import Multipath
    from plotfeed.models.effects.readings import Readings
    from plotfeed.models.effects.surroundings import OnTheWay, Surroundings


NO_PLOTS = Plots.of(t_utc_ns=np.zeros(0, np.int64))
NO_LOOKS = Looks.none()
ANYWHERE = endless(True, np.bool_)
NOWHERE = np.zeros((0, 3))
Claims = dict[str, NDArray[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Targets:
    """Drones seen from a sensor, (n, 3), at the times of measurement.

    `true_position_enu_m` is where the drone is at that time, east, north and up of the sensor,
    `position_enu_m` from where it is sensed, along the sensor's own axes: the same array, unless it
    is sound that comes from where the drone was at `emitted_utc_ns`, or the sensor stands askew.
    Velocities are east, north and up, for sensors that measure them; `readings` for those that err
    in them, `strengths` for those to which targets stay as strong for a while. `sensor`,
    an index, is given where several sensors share a pass: each row is seen from its own.
    """

    drone: Ints
    t_utc_ns: Ints
    position_enu_m: Floats
    true_position_enu_m: Floats
    signatures: Signatures
    velocity_enu_m_s: Floats | None = None
    readings: Readings | None = None
    strengths: TargetStrengths | None = None
    emitted_utc_ns: Ints | None = None
    sensor: Ints | None = None
    field_deg: Floats | None = None
    """Fields of view of steered cameras, each then."""
    pair_draws: Floats | None = None
    claims: HeldClaims | None = None
    """Of classifiers whose claims stay for a while."""

    @classmethod
    def of_one(
        cls, signature: Signature, position_enu_m: Floats, velocity_enu_m_s: Floats | None = None
    ) -> Self:
        """One drone at several places, (n, 3), for predictions."""
        n = len(position_enu_m)
        return cls(
            drone=np.zeros(n, np.int64),
            t_utc_ns=np.zeros(n, np.int64),
            position_enu_m=position_enu_m,
            true_position_enu_m=position_enu_m,
            velocity_enu_m_s=velocity_enu_m_s,
            signatures=Signatures.of_one(signature),
        )

    def __len__(self) -> int:
        return len(self.drone)

    def rcs_m2(self, rows: Ints | slice = slice(None)) -> Floats:
        """Radar cross-sections of those rows; (m,)."""
        return self.signatures.rcs_m2[self.drone[rows]]

    def sound_power_db(self) -> Floats:
        """Sound power levels, dB re 1 pW; (n,)."""
        return self.signatures.sound_power_db[self.drone]

    def size_m(self) -> Floats:
        """Sizes across; (n,)."""
        return self.signatures.size_m_of(self.drone)

    def looks(
        self,
        rows: Ints | slice,
        geometry: tuple[Floats, Floats, Floats],
        *,
        snr: Floats,
        pd: Floats,
        detected: Bools,
        channel: Ints | None = None,
    ) -> Looks:
        """Looks at those rows, whose geometry, azimuth, elevation and range, is that of all."""
        azimuth_deg, elevation_deg, range_m = geometry
        columns: dict[str, NDArray[Any]] = {
            "drone": self.drone[rows],
            "channel": np.zeros(len(pd), np.int64) if channel is None else channel,
            "t_utc_ns": self.t_utc_ns[rows],
            "range_m": range_m[rows],
            "azimuth_deg": azimuth_deg[rows],
            "elevation_deg": elevation_deg[rows],
            "snr": snr,
            "pd": pd,
            "detected": detected,
        }
        if self.emitted_utc_ns is not None:
            columns["emitted_utc_ns"] = self.emitted_utc_ns[rows]
        if self.sensor is not None:
            columns["sensor"] = self.sensor[rows]
        return Looks.holding(columns)

    def claims_of(self, looks: Looks, classifier: Confusion, rng: np.random.Generator) -> Claims:
        """What a classifier makes of those looks, columns of plots: drawn anew, or held."""
        drawn = None if self.claims is None else self.claims.of(looks)
        return classifier.columns(self.signatures.target_class_of(looks.drone), rng, drawn)

    def true_places_enu_m(self, *rows: NDArray[Any] | slice) -> Floats:
        """Where drones truly are: these rows, of them these; (m, 3)."""
        place_enu_m = self.true_position_enu_m
        for which in rows:
            place_enu_m = place_enu_m[which]
        return place_enu_m

    def true_geometry(self, looks: Looks, *rows: NDArray[Any] | slice) -> dict[str, NDArray[Any]]:
        """The true columns of plots of those looks, which are at these rows, of them these."""
        azimuth_deg, elevation_deg, range_m = looks.azimuth_deg, looks.elevation_deg, looks.range_m
        if self.true_position_enu_m is not self.position_enu_m:
            azimuth_deg, elevation_deg, range_m = enu_to_aer(self.true_places_enu_m(*rows))
        return {
            "true_azimuth_deg": azimuth_deg,
            "true_elevation_deg": elevation_deg,
            "true_range_m": range_m,
        }

    def read_range_m(self, range_m: Floats, t_utc_ns: Ints) -> Floats:
        """What the sensor reads in place of ranges at those times; (m,)."""
        return range_m if self.readings is None else self.readings.range_m(range_m, t_utc_ns)

    def read_azimuth_deg(self, azimuth_deg: Floats, t_utc_ns: Ints) -> Floats:
        """What the sensor reads in place of azimuths at those times, not folded; (m,)."""
        if self.readings is None:
            return azimuth_deg
        return self.readings.azimuth_deg(azimuth_deg, t_utc_ns)


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


def mean_prediction(found: Sequence[Prediction]) -> Prediction:
    """What to expect of looks that are of each kind alike often."""
    pd = np.stack([each.pd for each in found])

    def rms(name: str) -> Floats:
        sigmas = np.stack([getattr(each, name) for each in found])
        return np.asarray(np.sqrt((pd * sigmas**2).sum(axis=0) / pd.sum(axis=0)))

    tells_rates = found[0].sigma_range_rate_m_s is not None
    return Prediction(
        snr=np.mean([each.snr for each in found], axis=0),
        pd=pd.mean(axis=0),
        sigma_range_m=rms("sigma_range_m"),
        sigma_azimuth_deg=rms("sigma_azimuth_deg"),
        sigma_elevation_deg=rms("sigma_elevation_deg"),
        sigma_range_rate_m_s=rms("sigma_range_rate_m_s") if tells_rates else None,
    )


@dataclass(frozen=True, kw_only=True)
class SensorModel(Stackable, ABC):
    """A sensor, frozen: randomness is an argument. Nothing beyond `range_max_m` is looked at.

    Of many sensors (`stacking`), `observe` takes targets of which each row belongs to the model's
    row: whoever lets sensors differ in a field, by `alike`, follows each selection of rows by
    `rows`, and `chance.of_rows`. All else is asked of the model of a single sensor.
    `surroundings` are what its signals meet on their way, None for free space.
    """

    range_max_m: float
    degradation: Degradation | None = None
    surroundings: Surroundings | None = None

    is_radio: ClassVar[bool] = False
    """Whether it senses by radio waves, in whose way towers stand."""

    @property
    def error_factor(self) -> float | Floats:
        """True errors by noise over those that plots state; of several sensors (n,)."""
        return 1.0 if self.degradation is None else self.degradation.error_factor

    @property
    def pd_factor(self) -> float | Floats:
        """What of the Pd of each look is left; of several sensors (n,)."""
        return 1.0 if self.degradation is None else self.degradation.pd_factor

    @property
    def false_alarm_factor(self) -> float:
        """False alarms over those that its cells and threshold give."""
        return 1.0 if self.degradation is None else self.degradation.false_alarm_factor

    @property
    def signal_speed_m_s(self) -> float | None:
        """How fast what it senses travels; None where that takes no time worth modelling."""
        return None

    @property
    def errs_as_stated(self) -> bool:
        """Whether plots err normally about what they measure, by the sigmas that they state."""
        return True

    @property
    def measures_range_rate(self) -> bool:
        """Whether it needs to know how fast targets are."""
        return False

    @property
    def draws_by_pair(self) -> bool:
        """Whether something of each drone is drawn once for all."""
        return False

    @property
    def claims_held_ns(self) -> int:
        """How long what it calls a drone stays; 0 if each plot is called something by itself."""
        classifier: Confusion | None = getattr(self, "classifier", None)
        return 0 if classifier is None else classifier.held_ns

    @property
    def other_ends_enu_m(self) -> Floats:
        """Where its signals begin or end, beside at the sensor and at targets; (m, 3)."""
        return NOWHERE

    @property
    @abstractmethod
    def false_alarms_per_scan(self) -> float:
        """Mean number of false alarms in a scan."""

    @abstractmethod
    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """Look once at each target within cover, and plot those detected.

        Heights are left out: they take the sensor's place on Earth.
        """

    def has_sight_of(self, place_enu_m: Floats) -> Bools:
        """Whether nothing stands in the straight way to places, (n, 3); (n,)."""
        if self.surroundings is None:
            return ANYWHERE[: len(place_enu_m)]
        return self.surroundings.let_see(place_enu_m)

    @property
    def shows_sidelobes(self) -> bool:
        """Whether it reports what comes by its side lobes."""
        return False

    def with_jammers_behind(self, _way: OnTheWay) -> Self:
        """The sensor with what an obstruction leaves of its jammers; itself without any."""
        return self

    def mean_place(
        self, azimuth_deg: Floats, elevation_deg: Floats, range_m: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Means of what is measured of places by its own axes, before readings; (n,) each."""
        return azimuth_deg, elevation_deg, range_m

    def sigmas_at(self, snr: Floats, channel: Ints) -> Mapping[str, Floats]:  # noqa: ARG002
        """Standard deviations that follow from detections' own ratios, linear, by the columns.

        (n,) each; without those that depend on more.
        """
        return {}

    @abstractmethod
    def draw_false_alarms(self, sector: Sector, rng: np.random.Generator) -> Plots:
        """The false alarms of one sector of a scan, with the times at which they came."""

    def draw_false_snr(self, n: int, _rng: np.random.Generator) -> Floats:
        """The ratios that n false alarms show; (n,). NaN, unless a kind of sensor knows better."""
        return np.full(n, np.nan)

    @abstractmethod
    def predict(self, targets: Targets) -> Prediction:
        """What `observe` comes to over many scans, had the targets stayed there; all in cover.

        Rates of range count where velocities are given.
        """

    def stated_sigmas(self, snr: float) -> dict[str, float]:  # noqa: ARG002
        """What plots state of their errors at a detection's own SNR, by the names of `Plots`.

        Amidst the cover, where errors change with the place; nothing of a sensor that states none.
        """
        return {}


@dataclass(frozen=True, kw_only=True)
class CellSensor(SensorModel, ABC):
    """A sensor with resolution cells, each of which alarms by itself with probability `pfa`."""

    pfa: float
    azimuth_cover: AzimuthCover

    @property
    @abstractmethod
    def resolution_cells(self) -> float:
        """How many there are in a scan; not whole where cover is no multiple of beams."""

    @property
    def alarm_pfa(self) -> float:
        """Probability of a false alarm of a cell in a scan."""
        return self.pfa

    @property
    def alarm_cells(self) -> float:
        """Cells that give its false alarms: those of more, if it is degraded so."""
        return self.resolution_cells * self.false_alarm_factor

    @property
    def false_alarms_per_scan(self) -> float:
        """Mean number of false alarms in a scan (eq 9)."""
        return self.alarm_cells * self.alarm_pfa

    def draw_false_alarms(self, sector: Sector, rng: np.random.Generator) -> Plots:
        """The false alarms of one sector: binomial over its cells, uniform in azimuth (eq 9)."""
        azimuth_deg = false_alarms.draw_azimuths(
            self.alarm_cells, self.alarm_pfa, self.azimuth_cover, sector, rng
        )
        if not len(azimuth_deg):
            return NO_PLOTS
        return self.false_plots(beam_times_ns(sector, azimuth_deg), azimuth_deg, rng)

    def draw_false_snr(self, n: int, rng: np.random.Generator) -> Floats:
        """Ratios of false plots; (n,)."""
        return self.false_plots(np.zeros(n, np.int64), np.zeros(n), rng).snr

    @abstractmethod
    def false_plots(self, t_utc_ns: Ints, azimuth_deg: Floats, rng: np.random.Generator) -> Plots:
        """The plots of false alarms at those times and azimuths, (n,), n above 0."""


@dataclass(frozen=True, kw_only=True)
class JointSensor(SensorModel, ABC):
    """A sensor that has a pass of its own, in which false alarms meet detections of targets.

    A plot that is made of detections of several targets, or of none, is a false alarm: a ghost.
    """

    @abstractmethod
    def observe_scan(
        self, targets: Targets, sector: Sector, rng: np.random.Generator
    ) -> tuple[Looks, Plots]:
        """Looks at the targets of a scan and all of its plots, ghosts among them."""

    @property
    def errs_as_stated(self) -> bool:
        """Not to more than first order, and not of what was joined wrongly."""
        return False

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """Looks and plots of a scan that ends when the targets are looked at."""
        if not len(targets):
            return NO_LOOKS, NO_PLOTS
        end_ns = int(targets.t_utc_ns[0])
        sector = Sector(0, 0, end_ns, end_ns, 0.0, 360.0, stares=True)
        return self.observe_scan(targets, sector, rng)

    def draw_false_alarms(self, sector: Sector, rng: np.random.Generator) -> Plots:  # noqa: ARG002
        """None by themselves: they are among the plots of a scan."""
        return NO_PLOTS


@dataclass(frozen=True, kw_only=True)
class DwellingSensor(JointSensor, ABC):
    """A sensor that chooses where it looks next, by an agenda that goes from scan to scan."""

    @property
    @abstractmethod
    def among_all(self) -> SensorModel:
        """The sensor of one dwell, among what surrounds it."""

    @abstractmethod
    def observe_period(
        self, agenda: Agenda, targets: Targets, sector: Sector, rng: np.random.Generator
    ) -> tuple[Looks, Plots, Agenda]:
        """Looks and plots of a period, and what there is to do after it."""

    @abstractmethod
    def pointed(self, agenda: Agenda) -> PointedBeams:
        """Where the beams of the last period pointed, by the agenda after it."""


@dataclass(frozen=True, kw_only=True)
class RadioSensor(SensorModel, ABC):
    """A sensor of radio waves, over ground that may reflect them."""

    multipath: Multipath | None = None

    is_radio: ClassVar[bool] = True

    @property
    @abstractmethod
    def receiver_noise_w_hz(self) -> Floats:
        """Density of what disturbs its receiver, by signal, watts in a hertz; (K,)."""

    @property
    def is_in_free_space(self) -> bool:
        """Whether nothing changes the powers of its signals on their way."""
        return self.multipath is None and self.surroundings is None

    def way_factor(
        self, place_enu_m: Floats, wavelength_m: ArrayLike, from_enu_m: ArrayLike = (0.0, 0.0, 0.0)
    ) -> Floats:
        """Factor of power one way between places, (..., 3), by all that changes it; (...) out."""
        factor = np.ones(place_enu_m.shape[:-1])
        for each in (self.multipath, self.surroundings):
            if each is not None:
                factor = factor * each.power_factor(place_enu_m, wavelength_m, from_enu_m)
        return factor
