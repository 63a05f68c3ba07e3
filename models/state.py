"""The structures of arrays that cross rooms: what is true, what was looked at, what was measured.

Every column has one row a target, shape (n,) unless it says (n, 3). Floats are float64, times
int64 nanoseconds of UTC since 1970, drones an index into the session's list of drones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

NS = 1_000_000_000  # Nanoseconds in a second
FALSE_ALARM = -1  # The drone index of a plot that no drone caused
DRONE = "drone"  # The class of targets of which nothing else is said
# What names of drones never have: before it stands what something else is, such as a bird.
OTHER = "/"

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Texts = NDArray[np.object_]


def rows_where(mask: Bools) -> Ints | slice:
    """What selects the rows of a mask (n,): all of them without copying, where it holds all."""
    return slice(None) if mask.all() else np.flatnonzero(mask)


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Equally long columns, selected and joined by row; one that may be None is not there then."""

    def __len__(self) -> int:
        return len(next(iter(vars(self).values())))

    @classmethod
    def holding(cls, columns: Mapping[str, NDArray[Any] | None]) -> Self:
        """A structure of those columns, set at once, where a frozen class sets them one by one."""
        made = object.__new__(cls)
        vars(made).update(columns)
        return made

    def but(self, **columns: NDArray[Any] | None) -> Self:
        """A structure with other columns in the place of those that this one has by these names."""
        return self.holding({**vars(self), **columns})

    def rows(self, which: NDArray[Any]) -> Self:
        """Rows where a boolean mask (n,) holds, or at distinct indices (m,)."""
        if which.dtype == np.bool_:
            if which.all():
                return self
            which = np.flatnonzero(which)
        n = len(which)
        return self.holding(
            {
                # What is the same throughout is not copied, value by value, to be the same again.
                name: column[which] if column.strides[0] else column[:n]
                for name, column in vars(self).items()
                if column is not None
            }
        )

    def picked(self, which: Ints | slice, names: Sequence[str]) -> Self:
        """Rows of those columns, if they are there, alone: the others may not be asked for."""
        if isinstance(which, slice) and which == slice(None):
            return self
        held = vars(self)
        return self.holding({name: held[name][which] for name in names if name in held})

    def between(self, first: int, end: int) -> Self:
        """Rows from `first` up to `end`, not copied."""
        part = slice(first, end)
        return self.holding({n: v[part] for n, v in vars(self).items() if v is not None})

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """A structure of all rows of `parts`, in their order; at least one part."""
        parts = [p for p in parts if len(p)] or [parts[0]]
        if len(parts) == 1:
            return parts[0]
        held = [vars(part) for part in parts]
        lengths = [len(part) for part in parts]
        names = dict.fromkeys(name for columns in held for name in columns)
        return cls.holding(
            {name: _joined(name, [h.get(name) for h in held], lengths) for name in names}
        )


@dataclass(frozen=True, kw_only=True)
class PlaceState(Columns):
    """Where drones are: positions in ECEF, (n, 3), each at its own time."""

    drone: Ints
    t_utc_ns: Ints
    position_ecef_m: Floats


@dataclass(frozen=True, kw_only=True)
class TruthState(PlaceState):
    """How drones fly: velocities in ECEF, (n, 3), beside the positions."""

    velocity_ecef_m_s: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Emitter:
    """Something on a drone that radiates; `identity` is what its emission says when decoded."""

    frequency_hz: float
    bandwidth_hz: float = 0.0
    eirp_dbm: float = 0.0
    kind: str = ""
    identity: str = ""


def endless(value: object, dtype: type) -> NDArray[Any]:
    """A column of the same throughout, as long as anybody asks for: it takes no memory."""
    one: NDArray[Any] = np.empty((), dtype)
    one[()] = value
    return np.broadcast_to(one, 1 << 40)


@dataclass(frozen=True, slots=True, kw_only=True)
class Signature:
    """What there is of a drone to sense; NaN where it is not known."""

    rcs_m2: float = np.nan
    sound_power_db: float = np.nan
    """Re 1 pW."""
    emitters: tuple[Emitter, ...] = ()
    size_m: float = np.nan
    """Across, as a camera sees it."""
    target_class: str = DRONE
    """What it is, for sensors that recognise it."""
    model: str = ""
    """Of what make, for sensors that identify it."""
    echoes: Any = None
    """`TargetEchoes` of this one alone, which know this module, or None."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Signatures:
    """Signatures of all drones, by index: columns (n,), or longer; as `Signature` has it if not."""

    rcs_m2: Floats
    sound_power_db: Floats
    emitters: Sequence[tuple[Emitter, ...]]
    size_m: Floats = field(default_factory=partial(endless, np.nan, np.float64))
    target_class: Texts = field(default_factory=partial(endless, DRONE, np.object_))
    model: Texts = field(default_factory=partial(endless, "", np.object_))
    echoes: Any = None
    """`TargetEchoes`, or None where no drone states any."""

    @classmethod
    def of_one(cls, signature: Signature) -> Self:
        """One drone's."""
        return cls(
            rcs_m2=np.array([signature.rcs_m2]),
            sound_power_db=np.array([signature.sound_power_db]),
            emitters=[signature.emitters],
            size_m=np.array([signature.size_m]),
            target_class=np.array([signature.target_class], np.object_),
            model=np.array([signature.model], np.object_),
            echoes=signature.echoes,
        )


@dataclass(frozen=True, kw_only=True)
class Looks(Columns):
    """Each drone that a sensor looked at: where it was, and the odds it had.

    `t_utc_ns` is when the sensor looked. What it senses may have left the drone before, as sound
    does: then `emitted_utc_ns` is there, 0 for looks to which that does not apply, and the geometry
    is that of the drone then. It is along the axes that the sensor takes for east, north and up as
    a model gives it, and true as the ledger tells it: those differ if the sensor stands askew.

    `channel` is the transmitter or emitter by whose signal it was looked at, where a sensor looks
    by several, else 0. `sensor` is there only where several sensors share a pass: an index among
    them.
    """

    drone: Ints
    channel: Ints
    t_utc_ns: Ints
    range_m: Floats
    azimuth_deg: Floats
    elevation_deg: Floats
    snr: Floats
    pd: Floats
    detected: Bools
    emitted_utc_ns: Ints | None = None
    sensor: Ints | None = None

    def whose(self) -> dict[str, Ints]:
        """Columns that say of which drone each is and, where there are several, which sensor's."""
        if self.sensor is None:
            return {"drone": self.drone}
        return {"drone": self.drone, "sensor": self.sensor}

    @classmethod
    def none(cls) -> Self:
        """Looks at nothing."""
        ints = dict.fromkeys(("drone", "channel", "t_utc_ns"), np.zeros(0, np.int64))
        angles = ("range_m", "azimuth_deg", "elevation_deg", "snr", "pd")
        floats = dict.fromkeys(angles, np.zeros(0))
        return cls.holding({**ints, **floats, "detected": np.zeros(0, np.bool_)})


@dataclass(frozen=True, kw_only=True)
class Plots(Columns):
    """What was measured, and privately of whom: drones and true columns never go to a tracker.

    Azimuth is clockwise from true north in [0, 360), elevation above the sensor's horizontal,
    height above the WGS-84 ellipsoid, bistatic range the path transmitter-target-receiver less the
    baseline. `snr` is that of the very detection, linear; sigmas and covariances, of the position
    east and north, are what the sensor itself would state. NaN and "" stand for what the sensor
    does not measure, NaN also in the true columns for a false alarm. `channel` is as in `Looks`.

    The columns that may be None are of sensors that model what few do. The range rate is that of
    the range, of a passive radar that of the bistatic range, positive for a target that recedes.
    `kind_probability` is that with which `kind` is right, by the sensor itself.
    `merged_drones` are the drones beside `drone` whose echoes the plot does not tell apart.
    `sensor` is as in `Looks`.
    """

    t_utc_ns: Ints
    channel: Ints
    range_m: Floats
    azimuth_deg: Floats
    elevation_deg: Floats
    height_m: Floats
    bistatic_range_m: Floats
    snr: Floats
    amplitude_dbm: Floats
    run_length_deg: Floats
    sigma_range_m: Floats
    sigma_azimuth_deg: Floats
    sigma_elevation_deg: Floats
    sigma_bistatic_range_m: Floats
    covariance_east_m2: Floats
    covariance_north_m2: Floats
    covariance_east_north_m2: Floats
    kind: Texts
    identity: Texts
    drone: Ints
    true_range_m: Floats
    true_azimuth_deg: Floats
    true_elevation_deg: Floats
    kind_probability: Floats | None = None
    range_rate_m_s: Floats | None = None
    sigma_range_rate_m_s: Floats | None = None
    true_range_rate_m_s: Floats | None = None
    merged_drones: Texts | None = None
    sensor: Ints | None = None

    @classmethod
    def of(cls, **columns: NDArray[Any]) -> Self:
        """Plots with those columns, of which `t_utc_ns` is one; the others say 'not measured'.

        A plot of no stated drone is a false alarm. Raises `TypeError` for what is no column.
        """
        if not columns.keys() <= _PLOT_COLUMNS:
            raise TypeError(f"no columns of plots: {sorted(columns.keys() - _PLOT_COLUMNS)}")
        return cls.holding(columns)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> NDArray[Any]:
            """What stands in a column that was not given: it is made when somebody asks for it."""
            if name not in _PLOT_COLUMNS:
                raise AttributeError(f"plots have no column {name!r}")
            return _ABSENT.get(name, _UNMEASURED)[: len(self)]

    def measures(self, name: str) -> bool:
        """Whether a column holds anything but 'not measured' throughout."""
        return vars(self).get(name) is not None

    def in_order_of_time(self) -> Self:
        """Plots, earliest first; ties keep their order."""
        t_utc_ns = self.t_utc_ns
        if len(self) < 2 or (t_utc_ns[1:] >= t_utc_ns[:-1]).all():
            return self
        return self.rows(np.argsort(t_utc_ns, kind="stable"))


UNDECIDED = endless(False, np.bool_)  # Whether looks are detected, which is not known yet
_UNMEASURED = endless(np.nan, np.float64)
# What stands in columns that a sensor does not fill, where it is not NaN.
_ABSENT = {
    "drone": endless(FALSE_ALARM, np.int64),
    "channel": endless(0, np.int64),
    "kind": endless("", np.object_),
    "identity": endless("", np.object_),
    "merged_drones": endless((), np.object_),
    "sensor": endless(-1, np.int64),
    "emitted_utc_ns": endless(0, np.int64),
}
_PLOT_COLUMNS = frozenset(f.name for f in fields(Plots))


def _joined(
    name: str, columns: Sequence[NDArray[Any] | None], lengths: Sequence[int]
) -> NDArray[Any] | None:
    """A column of all parts; where only some have it, the others say 'not measured'."""
    there = [column for column in columns if column is not None]
    if not there:
        return None
    if len(there) < len(columns):
        absent = _ABSENT.get(name, _UNMEASURED)
        there = [absent[:n] if c is None else c for n, c in zip(lengths, columns, strict=True)]
    return np.concatenate(there)


class AltitudeReference(StrEnum):
    """What an altitude is measured from."""

    ELLIPSOID = "ellipsoid"
    MEAN_SEA_LEVEL = "mean_sea_level"
    ABOVE_TAKEOFF = "above_takeoff"


FEWEST_ROWS = 16


def with_room(column: NDArray[Any], rows: int) -> NDArray[Any]:
    """A column of `FEWEST_ROWS` and so many at least, new ones zero; it doubles if it grows."""
    more = max(rows, FEWEST_ROWS) - len(column)
    if more <= 0:
        return column
    room = np.zeros((max(more, len(column)), *column.shape[1:]), column.dtype)
    return np.concatenate([column, room])


def trimmed(column: NDArray[Any], rows: int) -> NDArray[Any]:
    """A column for so many rows, without most of the room that it has for more."""
    room = 2 * max(rows, FEWEST_ROWS)
    return column[:room].copy() if len(column) > 2 * room else column


def renamed(before: Sequence[str], names: Sequence[str]) -> Ints:
    """Rows of drones that had other names before, by their names before and now."""
    if before is names:
        return np.zeros(0, np.int64)
    changed = [row for row, (a, b) in enumerate(zip(before, names, strict=False)) if a != b]
    return np.array([*changed, *range(len(names), len(before))], np.int64)
