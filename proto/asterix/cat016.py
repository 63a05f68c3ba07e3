"""Category 016, configuration of non-cooperative surveillance systems: layout and encoder.

EUROCONTROL-SPEC-0149, category 016, edition 1.0; `codec.layout` explains the table. A multistatic
system says of what pairs, transmitters and receivers it is made. I016/405 is above mean sea level,
ALT above the WGS-84 ellipsoid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from plotfeed.proto.asterix.codec.encode import UDP_OCTETS
from plotfeed.proto.asterix.codec.layout import category
from plotfeed.proto.asterix.codec.reports import Reports, checked_position
from plotfeed.proto.units import TIME_LSB_NS

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


class SystemEncoder016:
    """Two data blocks of one record each, the same but for their time of day.

    The first says how the system is composed (I016/010, 000, 140, 200, 300, 400, 405), the second
    where its components are (I016/010, 000, 140, 410, 420). `reference` is the system's reference
    point, whose height the standard takes from mean sea level: `geoid_undulation_m` above the
    ellipsoid.
    """

    def __init__(
        self,
        sac: int,
        sic: int,
        *,
        period_s: int,
        pairs: Sequence[Pair],
        transmitters: Sequence[Component],
        receivers: Sequence[Component],
        reference: Component,
        geoid_undulation_m: float = 0.0,
        max_octets: int = UDP_OCTETS,
    ) -> None:
        source: dict[str, float | str] = {"I016/010/SAC": sac, "I016/010/SIC": sic}
        system = source | {"I016/000": SYSTEM, "I016/200": period_s}
        for index, pair in enumerate(pairs):
            path = f"I016/300/{index}"
            system[f"{path}/PID"] = pair.identity
            system[f"{path}/TID"] = pair.transmitter
            system[f"{path}/RID"] = pair.receiver
        system |= _position("I016/400", reference)
        system["I016/405"] = reference.height_m - geoid_undulation_m
        components = source | {"I016/000": COMPONENTS}
        for index, component in enumerate(transmitters):
            path = f"I016/410/{index}"
            components |= {f"{path}/{name}": 0 for name in ("TTO", "ATO", "PCI")}
            components |= _component(path, "TID", component)
        for index, component in enumerate(receivers):
            components |= _component(f"I016/420/{index}", "RID", component)
        self._messages = [
            Reports(
                CAT016,
                ("I016/010", "I016/000", "I016/140", *items),
                constants=constants,
                lsb={"I016/140": TIME_LSB_NS},
                max_octets=max_octets,
            )
            for constants, items in (
                (system, ("I016/200", f"I016/300*{len(pairs)}", "I016/400", "I016/405")),
                (components, (f"I016/410*{len(transmitters)}", f"I016/420*{len(receivers)}")),
            )
        ]

    def blocks(self, t_utc_ns: int) -> list[bytes]:
        """The composition, then the components."""
        columns = {"I016/140": t_utc_ns}
        return [block for message in self._messages for block in message.blocks(columns)]


def _component(path: str, identity: str, component: Component) -> dict[str, float]:
    numbered = {f"{path}/{identity}": component.identity, f"{path}/ALT": component.height_m}
    return numbered | _position(path, component)


def _position(path: str, component: Component) -> dict[str, float]:
    checked_position(component.latitude_deg, component.longitude_deg, field=path)
    return {f"{path}/LAT": component.latitude_deg, f"{path}/LON": component.longitude_deg}
