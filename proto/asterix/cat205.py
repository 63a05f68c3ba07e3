"""Category 205, reports of radio direction finders; edition 1.0. One record a data block.

A quantity saturates where its row says nothing else; ± marks signed parts, _n spare bits, nxm n
characters of m bits, | an extension bit; a part without an LSB is an integer.
EUROCONTROL-SPEC-0149, category 205.

===  ========  ======  ============================================================================
FRN  item      octets  parts: bits, LSB and unit
===  ========  ======  ============================================================================
1    I205/010  2       SAC 8, SIC 8
2    I205/015  1       SID 8
3    I205/000  1       TYPE 8
4    I205/030  3       TOD 24: 1/128 s wraps
5    I205/040  1       NUMBER 8
6    I205/090  7       CHANNEL 7x8
7    I205/050  8       LAT ±32: 180/2^25 deg refused, LON ±32: 180/2^25 deg refused
8    I205/060  6       X ±24: 1/2 m, Y ±24: 1/2 m
9    I205/070  2       BEARING 16: 0.01 deg wraps
10   I205/080  2       BEARING 16: 0.01 deg wraps
11   I205/100  1       QUALITY 8
12   I205/110  1       RADIUS 8: 100 m
13   I205/120  1+1n    repeated: SENSOR 8
14   I205/130  8       LAT ±32: 180/2^25 deg refused, LON ±32: 180/2^25 deg refused
15   I205/140  6       X ±24: 1/2 m, Y ±24: 1/2 m
16   I205/150  1       RADIUS 8: 100 m
17   I205/160  2       TRN 16
18   I205/170  1       SENSOR 8
19   I205/180  2       LEVEL ±16: 0.01 dBµV
20   I205/190  1       QUALITY 8
21   I205/200  2       ELEVATION ±16: 0.01 deg
22   I205/SP   1+n     octets behind their count
===  ========  ======  ============================================================================

I205/030 is the time of transmission, not of measurement. A bearing starts at I205/050 (I205/070) or
at I205/060 (I205/080), which are positions of the sensor in messages of types 2 and 5.
"""

from __future__ import annotations

from plotfeed.proto.asterix.codec.layout import (
    ASCII,
    Category,
    Characters,
    Explicit,
    Fixed,
    Overflow,
    Quantity,
    Raw,
    fixed,
    position_180,
    repeated,
    signed,
    source,
    time_of_day,
    unsigned,
)


def _bearing(item: str) -> Fixed:
    """Degrees, of which a circle has 36000 hundredths: fewer than 16 bits hold."""
    bearing = Quantity("BEARING", 16, 0.01, "deg", overflow=Overflow.WRAP, modulus=36_000)
    return fixed(item, bearing)


CAT205 = Category(
    205,
    (
        source("I205/010"),
        fixed("I205/015", Raw("SID", 8)),
        fixed("I205/000", Raw("TYPE", 8)),
        time_of_day("I205/030"),
        fixed("I205/040", Raw("NUMBER", 8)),
        fixed("I205/090", Characters("CHANNEL", 7, ASCII)),
        fixed("I205/050", *position_180(32, 25)),
        fixed("I205/060", signed("X", 24, 1 / 2, "m"), signed("Y", 24, 1 / 2, "m")),
        _bearing("I205/070"),
        _bearing("I205/080"),
        fixed("I205/100", Raw("QUALITY", 8)),
        fixed("I205/110", unsigned("RADIUS", 8, 100, "m")),
        repeated("I205/120", Raw("SENSOR", 8)),
        fixed("I205/130", *position_180(32, 25)),
        fixed("I205/140", signed("X", 24, 1 / 2, "m"), signed("Y", 24, 1 / 2, "m")),
        fixed("I205/150", unsigned("RADIUS", 8, 100, "m")),
        fixed("I205/160", Raw("TRN", 16)),
        fixed("I205/170", Raw("SENSOR", 8)),
        fixed("I205/180", signed("LEVEL", 16, 0.01, "dBµV")),
        fixed("I205/190", Raw("QUALITY", 8)),
        fixed("I205/200", signed("ELEVATION", 16, 0.01, "deg")),
        Explicit("I205/SP"),
    ),
)
