"""Category 025, status of ground systems: its layout, and that which some decoders have.

EUROCONTROL-SPEC-0149-26, editions 1.5 and 1.6; `codec.layout` explains the table. Decoders differ
in the LSB of the longitude in I025/600.
"""

from __future__ import annotations

from plotfeed.proto.asterix.codec.layout import category

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

CAT025_HALF_TURN = category(
    25,
    """
12   I025/600  8       LAT ±32: 180/2^32 deg, LON ±32: 180/2^32 deg refused
""",
    base=CAT025,
)
"""What libasterix reads: longitudes in the LSB of latitudes, which reach from -90 to 90 deg."""
