"""Category 025, status of ground systems; editions 1.5 and 1.6.

A quantity saturates where its row says nothing else; ± marks signed parts, _n spare bits, nxm n
characters of m bits, | an extension bit; a part without an LSB is an integer.
EUROCONTROL-SPEC-0149-26.

===  ========  ======  ============================================================================
FRN  item      octets  parts: bits, LSB and unit
===  ========  ======  ============================================================================
1    I025/010  2       SAC 8, SIC 8
2    I025/000  1       RTYP 7, RG
3    I025/200  3       ID 24
4    I025/015  1       SID 8
5    I025/020  6       DESIGNATOR 8x6
6    I025/070  3       TOD 24: 1/128 s wraps
7    I025/100  1+FX    NOGO, OPS 2, SSTAT 4 | _1, SYSTAT 3, SESTAT 3
8    I025/105  1+1n    repeated: ERROR 8
9    I025/120  1+3n    repeated: CID 16, ERRC 6, CS 2
10   I025/140  1+6n    repeated: TYPE 8, REF, _7, COUNT 32
11   I025/SP   1+n     octets behind their count
12   I025/600  8       LAT ±32: 180/2^32 deg refused, LON ±32: 360/2^32 deg wraps
13   I025/610  2       HEIGHT ±16: 1/4 m
===  ========  ======  ============================================================================

Decoders differ in the LSB of the longitude in I025/600; see CAT025_HALF_TURN.

"""

from __future__ import annotations

from plotfeed.proto.asterix.codec.layout import (
    CALLSIGN,
    Category,
    Characters,
    Explicit,
    Quantity,
    Raw,
    Spare,
    extended,
    fixed,
    position,
    repeated,
    signed,
    source,
    time_of_day,
)


def _category(reference: tuple[Quantity, Quantity]) -> Category:
    return Category(
        25,
        (
            source("I025/010"),
            fixed("I025/000", Raw("RTYP", 7), Raw("RG", 1)),
            fixed("I025/200", Raw("ID", 24)),
            fixed("I025/015", Raw("SID", 8)),
            fixed("I025/020", Characters("DESIGNATOR", 8, CALLSIGN)),
            time_of_day("I025/070"),
            extended(
                "I025/100",
                (
                    Raw("NOGO", 1),
                    Raw("OPS", 2),
                    Raw("SSTAT", 4),
                ),
                (
                    Spare(1),
                    Raw("SYSTAT", 3),
                    Raw("SESTAT", 3),
                ),
            ),
            repeated("I025/105", Raw("ERROR", 8)),
            repeated("I025/120", Raw("CID", 16), Raw("ERRC", 6), Raw("CS", 2)),
            repeated("I025/140", Raw("TYPE", 8), Raw("REF", 1), Spare(7), Raw("COUNT", 32)),
            Explicit("I025/SP"),
            fixed("I025/600", *reference),
            fixed("I025/610", signed("HEIGHT", 16, 1 / 4, "m")),
        ),
    )


CAT025 = _category(position(32, 180 / (1 << 32), 360 / (1 << 32)))
CAT025_HALF_TURN = _category(position(32, 180 / (1 << 32), 180 / (1 << 32)))
"""As libasterix has it: longitudes in the LSB of latitudes, which reach from -90 to 90 deg."""
