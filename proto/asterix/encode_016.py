"""What a multistatic system is made of, in category 016: its pairs, transmitters and receivers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from plotfeed.proto.asterix.cat016 import CAT016
from plotfeed.proto.asterix.codec.encode import UDP_OCTETS, Reports, checked_position
from plotfeed.proto.units import TIME_LSB_NS

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
