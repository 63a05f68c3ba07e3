"""Category 063, status of the sensors of a tracker: layout and encoder.

EUROCONTROL-SPEC-0149-10, edition 1.7; `codec.layout` explains the table. Earlier editions have
fewer groups of I063/060.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from plotfeed.proto.asterix.codec.encode import Constant, Parts, Reports
from plotfeed.proto.asterix.codec.layout import category
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


class StatusEncoder063:
    """Status of sensors that track, as I063/010, 030, 050 and the first octet of 060: operational.

    Who says so is the sensor itself. Several sensors have a SAC and SIC each, in sequences.
    """

    def __init__(self, sac: int | Sequence[int], sic: int | Sequence[int]) -> None:
        flags: dict[str, Constant] = {
            f"I063/060/{name}": 0 for name in ("CON", "PSR", "SSR", "MDS", "ADS", "MLT")
        }
        sources = {
            f"I063/{item}/{name}": code
            for item in ("010", "050")
            for name, code in (("SAC", sac), ("SIC", sic))
        }
        self._reports = Reports(
            CAT063,
            ("I063/010", "I063/030", "I063/050", "I063/060"),
            constants=flags | sources,
            lsb={"I063/030": TIME_LSB_NS},
        )

    def blocks(self, t_utc_ns: Ints, sources: Ints) -> list[bytes]:
        """A data block for each of these times, (m,), of sensors by their numbers, (m,)."""
        found = self._reports.blocks_by({"I063/030": t_utc_ns}, Parts.one_each(sources))
        return [block for (block,) in found]
