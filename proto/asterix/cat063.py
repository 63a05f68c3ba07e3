"""Category 063, status of the sensors of a tracker: layout and encoder.

EUROCONTROL-SPEC-0149-10, edition 1.7; `codec.layout` explains the table. Earlier editions have
fewer groups of I063/060.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

from plotfeed.proto.asterix.codec.encode import UDP_OCTETS, Constant
from plotfeed.proto.asterix.codec.layout import category
from plotfeed.proto.asterix.codec.reports import Parts, Reports
from plotfeed.proto.lazy_numpy import np
from plotfeed.proto.units import TIME_LSB_NS

if TYPE_CHECKING:
    from plotfeed.models.state import Ints

CAT063 = category(
    63,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I063/010  2       SAC 8, SIC 8
2    I063/015  1       SID 8
3    I063/030  3       TOD 24: 1/128 s modulo 86400
4    I063/050  2       SAC 8, SIC 8
5    I063/060  1+FX    CON 2, PSR, SSR, MDS, ADS, MLT | OPS, ODP, OXT, MSC, TSV, NPW, _1 | TTFEP,
                       TTFVAL, SPOEP, SPOVAL, _3
6    I063/070  2       BIAS ±16: 1 ms
7    I063/080  4       SRG ±16: 1e-05, SRB ±16: 1/128 NM
8    I063/081  2       BIAS ±16: 180/2^15 deg
9    I063/090  4       PRG ±16: 1e-05, PRB ±16: 1/128 NM
10   I063/091  2       BIAS ±16: 180/2^15 deg
11   I063/092  2       BIAS ±16: 180/2^15 deg
13   I063/RE   1+n     octets behind their count
14   I063/SP   1+n     octets behind their count
""",
)


class Condition(IntEnum):
    """How a sensor is connected, I063/060/CON."""

    OPERATIONAL = 0
    DEGRADED = 1
    INITIALISING = 2
    NOT_CONNECTED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorStatus:
    """A sensor by its source, and how it does; `radar_fails` is of its primary radar."""

    sac: int
    sic: int
    condition: Condition = Condition.OPERATIONAL
    radar_fails: bool = False


class SensorStatusEncoder063:
    """Sensors' status, a record a sensor, as I063/010, 030, 050 and the first octet of 060.

    The source is that of the system which says so. Several systems have a SAC, SIC and limit of
    octets each, in sequences.
    """

    def __init__(
        self,
        sac: int | Sequence[int],
        sic: int | Sequence[int],
        *,
        max_octets: int | Sequence[int] = UDP_OCTETS,
    ) -> None:
        flags: dict[str, Constant] = {
            f"I063/060/{name}": 0 for name in ("SSR", "MDS", "ADS", "MLT")
        }
        self._reports = Reports(
            CAT063,
            ("I063/010", "I063/030", "I063/050", "I063/060"),
            constants=flags | {"I063/010/SAC": sac, "I063/010/SIC": sic},
            lsb={"I063/030": TIME_LSB_NS},
            max_octets=max_octets,
        )

    def blocks(self, t_utc_ns: int, sensors: Sequence[SensorStatus]) -> list[bytes]:
        """Data blocks of all sensors of one system, in their order, within `max_octets`."""
        times = np.full(len(sensors), t_utc_ns, np.int64)
        return self.blocks_by(times, sensors, Parts.whole(len(sensors)))[0]

    def blocks_by(
        self, t_utc_ns: Ints, sensors: Sequence[SensorStatus], parts: Parts
    ) -> list[list[bytes]]:
        """Data blocks of each part of the sensors, whose status is of times, (n,)."""
        return self._reports.blocks_by(
            {
                "I063/030": t_utc_ns,
                "I063/050/SAC": [sensor.sac for sensor in sensors],
                "I063/050/SIC": [sensor.sic for sensor in sensors],
                "I063/060/CON": [sensor.condition for sensor in sensors],
                "I063/060/PSR": [int(sensor.radar_fails) for sensor in sensors],
            },
            parts,
        )
