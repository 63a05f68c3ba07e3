"""What every sensor model takes, gives and can do, whatever the physics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property, partial
from operator import eq
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plotfeed.models.beam import AzimuthCover, Sector, beam_times_ns, draw_azimuths
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.state import Bools, Floats, Ints, Looks, Plots, Signature, Signatures, endless

if TYPE_CHECKING:
    from plotfeed.models.dwell_agenda import Agenda, PointedBeams
    from plotfeed.models.effects.classification import Confusion, HeldClaims
    from plotfeed.models.effects.readings import Readings
    from plotfeed.models.effects.surroundings import Multipath, OnTheWay, Surroundings
    from plotfeed.models.effects.target_echoes import TargetStrengths


# Sensors of a kind in one model: what differs between them is a column, the rest a number.
#
# A model of one sensor has numbers. One of many, made by `stacked`, is of the same class and has
# columns, a value a sensor, and `rows` makes of it the model of as many looks, a value a look.
# Such columns are gathered when an equation asks for them. All that follows from a sensor alone,
# a `sensor_property`, is worked out sensor by sensor, once: no bit of it depends on the company.
M = TypeVar("M", bound="Stackable")
EVERY_ROW = slice(None)


if TYPE_CHECKING:
    sensor_property = cached_property
else:

    class sensor_property(cached_property):  # noqa: N801 - a decorator, as its base is
        """What follows from the fields of a sensor alone; of many, gathered as the fields are.

        An array of a sensor, (...) or (..., 1), is (..., n) of n rows that differ in it.
        """

        def __get__(self, model: Any, owner: type[Any] | None = None) -> Any:
            """The value; of a model of rows, that of each."""
            stack = None if model is None else vars(model).get("_stack")
            if stack is None:
                return super().__get__(model, owner)
            name = self.attrname
            return vars(model).setdefault(name, stack.gathered(name, vars(model)["_at"]))


class Stackable:
    """A dataclass of what the equations of a sensor need, which `stacked` can make of many.

    Fields of its dataclasses and tuples count as its own.
    """

    alike: ClassVar[frozenset[str] | None] = None
    """Fields in which sensors that share a pass must be equal, though they are numbers or effects.
    None, of a kind that knows nothing of columns: all of them."""

    def rows(self, which: NDArray[Any] | slice) -> Self:
        """The model of those rows, by a mask, indices or a slice; itself if it is of one sensor."""
        held = vars(self)
        stack: _Stack | None = held.get("_stack")
        if stack is None or (isinstance(which, slice) and which == EVERY_ROW):
            return self
        made: Self = stack.of(held["_at"][which])
        return made

    def of_channel(self, name: str, channel: Ints) -> Floats:
        """A column (channels, ...) by the channel of each row; (n, ...)."""
        stack: _Stack | None = vars(self).get("_stack")
        value = getattr(self, name)
        if stack is None or name not in stack.columns:
            return np.asarray(value[channel])
        rows = np.arange(value.shape[-1])
        return np.asarray(value[channel, rows] if value.ndim == 2 else value[channel, :, rows])

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """A field that is a column: it is gathered when it is asked for."""
            stack = vars(self).get("_stack")
            if stack is None or name not in stack.columns:
                raise AttributeError(f"{type(self).__name__} has no {name!r}")
            return vars(self).setdefault(name, stack.gathered(name, vars(self)["_at"]))


class _Stack:
    """Several sensors: what they have alike, and what gives the rest by their indices."""

    def __init__(self, models: Sequence[Stackable]) -> None:
        self._models = models
        self.plain: dict[str, Any] = {}
        self.columns: dict[str, Callable[[Ints], Any]] = {}
        # Fields that are columns and would be found on the class, by their defaults, unasked.
        self.defaulted: list[str] = []

    def of(self, at: Ints) -> Any:
        """The model of the sensors at those indices."""
        kind: Any = type(self._models[0])
        made = object.__new__(kind)
        vars(made).update(self.plain, _stack=self, _at=at)
        for name in self.defaulted:
            vars(made)[name] = self.columns[name](at)
        return made

    def gathered(self, name: str, at: Ints) -> Any:
        """The values of the sensors at those indices."""
        if name not in self.columns and name not in self.plain:
            self.compare(name)
        return self.plain[name] if name in self.plain else self.columns[name](at)

    def compare(self, name: str) -> None:
        """Find out whether the sensors have that alike."""
        values = [getattr(model, name) for model in self._models]
        if _are_alike(values):
            self.plain[name] = values[0]
        else:
            self.columns[name] = _column(values)


def grouping_key(model: Stackable) -> Hashable:
    """What is the same of all sensors that can share a pass: their class, and what is no number."""
    alike = type(model).alike
    if not is_dataclass(model):
        return type(model), id(model)
    held = {f.name: getattr(model, f.name) for f in fields(model)}
    key = (
        type(model),
        *(
            (name, value if alike is None or name in alike else _form(value))
            for name, value in held.items()
        ),
    )
    try:
        hash(key)
    except TypeError:  # of a kind from outside that holds lists or arrays
        return type(model), id(model)
    return key


def stacked(models: Sequence[M]) -> M:
    """One model of sensors of one `grouping_key`, in their order; at least one.

    Its `rows(sensor_of_row)` observes targets of all of them. Where all are equal it is the first.
    """
    first = models[0]
    if not is_dataclass(first) or all(model is first or model == first for model in models):
        return first
    stack = _Stack(models)
    for field in fields(first):
        stack.compare(field.name)
        if field.name in stack.columns and hasattr(type(first), field.name):
            stack.defaulted.append(field.name)
    made: M = stack.of(np.arange(len(models)))
    return made


def _form(value: object) -> Hashable:
    """What of a value must be equal: nothing of a number."""
    if isinstance(value, float):
        return float
    if isinstance(value, tuple):
        return tuple(_form(part) for part in value)
    if is_dataclass(value):
        return type(value), *(_form(getattr(value, f.name)) for f in fields(value))
    return value


def _are_alike(values: Sequence[Any]) -> bool:
    """Whether values of one form are all the same."""
    first = values[0]
    if isinstance(first, tuple):
        return all(_are_alike(parts) for parts in zip(*values, strict=True))
    equal = np.array_equal if isinstance(first, np.ndarray) else eq
    return all(value is first or equal(value, first) for value in values)


def _column(values: Sequence[Any]) -> Callable[[Ints], Any]:
    """What gives values of one form by the indices of their sensors, these on the last axis."""
    first: Any = values[0]
    if _are_alike(values):
        return lambda _at: first
    if isinstance(first, np.ndarray):
        together = np.concatenate if first.ndim > 1 and first.shape[-1] == 1 else np.stack
        return partial(together(values, axis=-1).take, axis=-1)
    if isinstance(first, tuple):
        columns = [_column(parts) for parts in zip(*values, strict=True)]
        return lambda at: tuple(column(at) for column in columns)
    if is_dataclass(first):
        names = [f.name for f in fields(first)]
        parts = _column([tuple(getattr(value, name) for name in names) for value in values])
        kind: Any = type(first)
        return lambda at: kind(**dict(zip(names, parts(at), strict=True)))
    return np.array(values, np.float64).take


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
    is sound that comes from where the drone was at `emitted_utc_ns`, or the sensor stands askew:
    `own_axes` then turns true east, north and up to its own, (3, 3).
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
    own_axes: Floats | None = None

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

    def along_own_axes(self, vector_enu: Floats) -> Floats:
        """True vectors as the sensor takes them, (n, 3)."""
        return vector_enu if self.own_axes is None else vector_enu @ self.own_axes.T

    @property
    def sensed_enu_m(self) -> Floats:
        """Places from which drones are sensed, by true east, north and up; (n, 3)."""
        return self.position_enu_m if self.own_axes is None else self.position_enu_m @ self.own_axes

    def sound_power_db(self) -> Floats:
        """Sound power levels, dB re 1 pW; (n,)."""
        return self.signatures.sound_power_db[self.drone]

    def size_m(self) -> Floats:
        """Sizes across; (n,)."""
        return self.signatures.size_m[self.drone]

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

    def claims_of(
        self, looks: Looks, classifier: Confusion | None, rng: np.random.Generator
    ) -> Claims:
        """What a classifier, if any, makes of looks, columns of plots: drawn anew, or held."""
        if classifier is None:
            return {}
        drawn = None if self.claims is None else self.claims.of(looks)
        return classifier.columns(self.signatures.target_class[looks.drone], rng, drawn)

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Degradation:
    """What a sensor does worse than it takes itself to do: in one respect, and in no other.

    Factors on the Pd of every look, on the number of false alarms, and on errors by noise.

    What plots state of their errors stays, and so do the ratios of detections. Of many sensors,
    columns (n,).
    """

    pd_factor: float | Floats = 1.0
    false_alarm_factor: float = 1.0
    error_factor: float | Floats = 1.0


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

    def zoomed_alarms(self, alarms: Plots, _field_deg: float) -> Plots:
        """False alarms by its own axes at that field of view (deg); as they are without a zoom."""
        return alarms

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

    @property
    def n_channels(self) -> int:
        """Signals by which a target is looked at, detected and plotted by itself."""
        return 1

    def stated_sigmas(self, snr: float) -> dict[str, float]:
        """What plots state of their errors at a detection's own SNR, by the names of `Plots`.

        By the worst channel, and amidst the cover, where errors change with the place; nothing of a
        sensor that states none.
        """
        channels = np.arange(self.n_channels)
        stated = self.sigmas_at(np.full(len(channels), snr), channels)
        return {name: float(sigma.max()) for name, sigma in stated.items()}


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
        azimuth_deg = draw_azimuths(
            self.alarm_cells, self.alarm_pfa, self.azimuth_cover, sector, rng
        )
        if not len(azimuth_deg):
            return NO_PLOTS
        return self.false_plots(beam_times_ns(sector, azimuth_deg), azimuth_deg, rng)

    def draw_false_snr(self, n: int, rng: np.random.Generator) -> Floats:
        """Ratios of false plots; (n,)."""
        return self.false_plots(np.zeros(n, np.int64), np.zeros(n), rng).snr

    def false_claims(self, n: int, rng: np.random.Generator) -> Claims:
        """What its classifier, if any, makes of n false alarms, columns of plots."""
        classifier: Confusion | None = getattr(self, "classifier", None)
        return {} if classifier is None else classifier.columns_of_nothing(n, rng)

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
