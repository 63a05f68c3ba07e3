"""Category 016, configuration of non-cooperative surveillance systems: layout and encoder.

A multistatic system says of what pairs, transmitters and receivers it is made.

EUROCONTROL-SPEC-0149, category 016, edition 1.0; `codec.layout` explains the table. I016/405 is
above mean sea level, ALT above the WGS-84 ellipsoid.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from plotfeed.proto.asterix.codec.encode import UDP_OCTETS, Constant, Reports, checked_places
from plotfeed.proto.asterix.codec.layout import category
from plotfeed.proto.lazy_numpy import np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

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


class SystemEncoder016:
    """Two data blocks of one record each a system, the same but for their time of day.

    The first says how the system is composed (I016/010, 000, 140, 200, 300, 400, 405), the second
    where its components are (I016/010, 000, 140, 410, 420). A system has a receiver, number 0, and
    transmitters that count from 0, each of which makes a pair of its own number with it, to which
    I015/400 refers.

    Places are latitude and longitude, degrees, and height above the WGS-84 ellipsoid, metres: of
    the transmitters, (n, k, 3), of the receivers, (n, 3), and of the reference point of all, (3,).
    Mean sea level is `geoid_undulation_m` above the ellipsoid there. The n systems have a SAC, SIC
    and limit of octets each, in sequences.
    """

    def __init__(
        self,
        sac: Sequence[int],
        sic: Sequence[int],
        *,
        transmitters: ArrayLike,
        receivers: ArrayLike,
        reference: ArrayLike,
        period_s: float,
        geoid_undulation_m: float = 0.0,
        max_octets: int | Sequence[int] = UDP_OCTETS,
    ) -> None:
        of_pairs = np.asarray(transmitters, np.float64).swapaxes(0, 1)
        each = np.tile(reference, (len(sac), 1))
        latitude_deg, longitude_deg, height_m = checked_places(each, field="I016/400")
        composed: dict[str, Constant] = {
            "I016/000": SYSTEM,
            "I016/200": period_s,
            "I016/400/LAT": latitude_deg,
            "I016/400/LON": longitude_deg,
            "I016/405": height_m - geoid_undulation_m,
        }
        components: dict[str, Constant] = {
            "I016/000": COMPONENTS,
            "I016/420/0/RID": 0,
            **_place("I016/420/0", receivers),
        }
        for number, places in enumerate(of_pairs):
            pair, path = f"I016/300/{number}", f"I016/410/{number}"
            composed |= {f"{pair}/PID": number, f"{pair}/TID": number, f"{pair}/RID": 0}
            components |= {f"{path}/TID": number, **_place(path, places)}
            components |= dict.fromkeys((f"{path}/TTO", f"{path}/ATO", f"{path}/PCI"), 0)
        pairs = len(of_pairs)
        self._messages = [
            Reports(
                CAT016,
                ("I016/010", "I016/000", "I016/140", *items),
                constants={"I016/010/SAC": sac, "I016/010/SIC": sic, **constants},
                max_octets=max_octets,
            )
            for constants, items in (
                (composed, ("I016/200", f"I016/300*{pairs}", "I016/400", "I016/405")),
                (components, (f"I016/410*{pairs}", "I016/420*1")),
            )
        ]

    def blocks(self, t_utc_ns: ArrayLike, sources: Ints) -> list[list[bytes]]:
        """The composition of systems, by their numbers, then their components, at times (m,)."""
        of_both = [of.one_each(t_utc_ns, sources) for of in self._messages]
        return [[first, second] for first, second in zip(*of_both, strict=True)]


def _place(path: str, places: ArrayLike) -> dict[str, Constant]:
    """Where components are."""
    latitude_deg, longitude_deg, height_m = checked_places(places, field=path)
    return {f"{path}/LAT": latitude_deg, f"{path}/LON": longitude_deg, f"{path}/ALT": height_m}
