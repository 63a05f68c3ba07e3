"""Category 025, status of ground systems, one record a data block: layouts and encoder.

The latitude in I025/600 ends one LSB, 5 mm, before the North Pole, which becomes that.

EUROCONTROL-SPEC-0149-26, editions 1.5 and 1.6; `codec.layout` explains the table. Decoders differ
in the LSB of the longitude in I025/600.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from plotfeed.proto.asterix.codec.encode import Reports, checked_places
from plotfeed.proto.asterix.codec.layout import Category, category
from plotfeed.proto.report_format import SentCategory

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from plotfeed.models.state import Floats

CAT025 = category(
    25,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I025/010  2       SAC 8, SIC 8
2    I025/000  1       RTYP 7, RG
3    I025/200  3       ID 24
4    I025/015  1       SID 8
5    I025/020  6       DESIGNATOR 8x6
6    I025/070  3       TOD 24: 1/128 s modulo 86400
7    I025/100  1+FX    NOGO, OPS 2, SSTAT 4 | _1, SYSTAT 3, SESTAT 3
8    I025/105  1+1n    repeated: ERROR 8
9    I025/120  1+3n    repeated: CID 16, ERRC 6, CS 2
10   I025/140  1+6n    repeated: TYPE 8, REF, _7, COUNT 32
11   I025/SP   1+n     octets behind their count
12   I025/600  8       LAT ±32: 180/2^32 deg, LON ±32: 360/2^32 deg wraps
13   I025/610  2       HEIGHT ±16: 1/4 m
""",
)

# What libasterix reads: longitudes in the LSB of latitudes, which reach from -90 to 90 deg.
CAT025_HALF_TURN = category(
    25,
    """
12   I025/600  8       LAT ±32: 180/2^32 deg, LON ±32: 180/2^32 deg refused
""",
    base=CAT025,
)

STATUS = SentCategory("that the sensor works, and where it stands")
SERVICE_AND_SYSTEM_STATUS = 1  # I025/000/RTYP


def status_025(
    sac: int | Sequence[int],
    sic: int | Sequence[int],
    place: ArrayLike,
    *,
    geoid_undulation_m: float | Floats = 0.0,
    category: Category = CAT025,
) -> Reports:
    """Encodes that systems run, each time as I025/010, 000, 070, 100, 600 and 610.

    `place` is the latitude and longitude of the system's reference point, degrees, and its height
    above the WGS-84 ellipsoid, metres, (3,); mean sea level lies `geoid_undulation_m` above that
    there. `category` is CAT025 or CAT025_HALF_TURN. Several systems have a SAC, SIC, place, (n, 3),
    and undulation each.
    """
    latitude_deg, longitude_deg, height_m = checked_places(place, field="I025/600")
    operational_and_running = ("NOGO", "OPS", "SSTAT", "SYSTAT", "SESTAT")
    return Reports(
        category,
        (
            *("I025/010", "I025/000", "I025/070", "I025/100", "I025/100/SYSTAT"),
            *("I025/600", "I025/610"),
        ),
        constants={
            "I025/010/SAC": sac,
            "I025/010/SIC": sic,
            "I025/000/RTYP": SERVICE_AND_SYSTEM_STATUS,
            "I025/000/RG": 0,
            **{f"I025/100/{name}": 0 for name in operational_and_running},
            "I025/600/LAT": latitude_deg,
            "I025/600/LON": longitude_deg,
            "I025/610": height_m - geoid_undulation_m,
        },
    )
