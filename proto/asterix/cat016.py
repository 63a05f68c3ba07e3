"""Category 016, configuration of non-cooperative surveillance systems: layout and encoder.

A multistatic system says of what pairs, transmitters and receivers it is made.

EUROCONTROL-SPEC-0149, category 016, edition 1.0; `codec.layout` explains the table. I016/405 is
above mean sea level, ALT above the WGS-84 ellipsoid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from plotfeed.proto.asterix.codec.encode import UDP_OCTETS, Reports, checked_position
from plotfeed.proto.asterix.codec.layout import category
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.lazy_numpy import np
from plotfeed.proto.units import TIME_LSB_NS

if TYPE_CHECKING:
    from plotfeed.models.state import Ints

CAT016 = category(
    16,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I016/010  2       SAC 8, SIC 8
2    I016/015  1       SID 8
3    I016/000  1       TYPE 8
4    I016/140  3       TOD 24: 1/128 s modulo 86400
5    I016/200  1       PERIOD 8: 1 s
6    I016/300  1+6n    repeated: PID 16, TID 16, RID 16
7    I016/400  8       LAT ±32: 180/2^31 deg refused, LON ±32: 360/2^32 deg wraps
8    I016/405  2       HEIGHT ±16: 1/4 m
9    I016/410  1+21n   repeated: TID 16, LAT ±32: 180/2^31 deg refused, LON ±32: 360/2^32 deg
                       wraps, ALT ±16: 1/4 m, TTO ±32: 2 ns, _4, ATO 20: 1 ns, PCI 16
10   I016/420  1+12n   repeated: RID 16, LAT ±32: 180/2^31 deg refused, LON ±32: 360/2^32 deg
                       wraps, ALT ±16: 1/4 m
11   I016/SP   1+n     octets behind their count
""",
)

SYSTEM, COMPONENTS = 1, 2  # I016/000


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """A transmitter or a receiver; its height is above the WGS-84 ellipsoid."""

    identity: int
    latitude_deg: float
    longitude_deg: float
    height_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """A transmitter and a receiver by their identities; `identity` is what I015/400 refers to."""

    identity: int
    transmitter: int
    receiver: int


@dataclass(frozen=True, slots=True, kw_only=True)
class System:
    """A multistatic system by its source, and of what it is made.

    `reference` is its reference point, whose height the standard takes from mean sea level.
    """

    sac: int
    sic: int
    pairs: Sequence[Pair]
    transmitters: Sequence[Component]
    receivers: Sequence[Component]
    reference: Component

    @property
    def numbers(self) -> tuple[int, int, int]:
        """How many pairs, transmitters and receivers it has."""
        return len(self.pairs), len(self.transmitters), len(self.receivers)


class SystemEncoder016:
    """Two data blocks of one record each a system, the same but for their time of day.

    The first says how the system is composed (I016/010, 000, 140, 200, 300, 400, 405), the second
    where its components are (I016/010, 000, 140, 410, 420). All systems have as many pairs,
    transmitters and receivers. Mean sea level is `geoid_undulation_m` above the ellipsoid.
    """

    def __init__(
        self,
        systems: Sequence[System],
        *,
        period_s: int,
        geoid_undulation_m: float = 0.0,
        max_octets: int | Sequence[int] = UDP_OCTETS,
    ) -> None:
        if len({system.numbers for system in systems}) > 1:
            raise EncodeError("systems of different numbers of components", field="I016")
        pairs, transmitters, receivers = systems[0].numbers
        composed = [_composed(system, period_s, geoid_undulation_m) for system in systems]
        components = [_components(system) for system in systems]
        self._messages = [
            Reports(
                CAT016,
                ("I016/010", "I016/000", "I016/140", *items),
                constants={path: [of[path] for of in constants] for path in constants[0]},
                lsb={"I016/140": TIME_LSB_NS},
                max_octets=max_octets,
            )
            for constants, items in (
                (composed, ("I016/200", f"I016/300*{pairs}", "I016/400", "I016/405")),
                (components, (f"I016/410*{transmitters}", f"I016/420*{receivers}")),
            )
        ]

    def blocks(self, t_utc_ns: int) -> list[bytes]:
        """The composition of the one system, then its components."""
        return self.blocks_by(np.array([t_utc_ns]), np.zeros(1, np.int64))[0]

    def blocks_by(self, t_utc_ns: Ints, sources: Ints) -> list[list[bytes]]:
        """The composition of systems, by their numbers, then their components, at times (m,)."""
        of_both = [of.one_each({"I016/140": t_utc_ns}, sources) for of in self._messages]
        return [[first, second] for first, second in zip(*of_both, strict=True)]


def _composed(system: System, period_s: int, geoid_undulation_m: float) -> dict[str, float]:
    constants = _of(system, SYSTEM) | {"I016/200": period_s}
    for index, pair in enumerate(system.pairs):
        path = f"I016/300/{index}"
        constants[f"{path}/PID"] = pair.identity
        constants[f"{path}/TID"] = pair.transmitter
        constants[f"{path}/RID"] = pair.receiver
    constants |= _position("I016/400", system.reference)
    constants["I016/405"] = system.reference.height_m - geoid_undulation_m
    return constants


def _components(system: System) -> dict[str, float]:
    constants = _of(system, COMPONENTS)
    for item, identity, components in (
        ("I016/410", "TID", system.transmitters),
        ("I016/420", "RID", system.receivers),
    ):
        for index, component in enumerate(components):
            path = f"{item}/{index}"
            constants[f"{path}/{identity}"] = component.identity
            constants[f"{path}/ALT"] = component.height_m
            constants |= _position(path, component)
    for index in range(len(system.transmitters)):
        constants |= {f"I016/410/{index}/{name}": 0 for name in ("TTO", "ATO", "PCI")}
    return constants


def _of(system: System, kind: int) -> dict[str, float]:
    return {"I016/010/SAC": system.sac, "I016/010/SIC": system.sic, "I016/000": kind}


def _position(path: str, component: Component) -> dict[str, float]:
    checked_position(component.latitude_deg, component.longitude_deg, field=path)
    return {f"{path}/LAT": component.latitude_deg, f"{path}/LON": component.longitude_deg}
