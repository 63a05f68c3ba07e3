"""Category 129, identification and position of unmanned aircraft; edition 1.2. One record a block.

A quantity saturates where its row says nothing else; ± marks signed parts, _n spare bits, nxm n
characters of m bits, | an extension bit; a part without an LSB is an integer.
EUROCONTROL-SPEC-0149-29. No decoder that the tests can run reads the category: the layout is as
published descriptions of edition 1.2 have it.

===  ========  ======  ============================================================================
FRN  item      octets  parts: bits, LSB and unit
===  ========  ======  ============================================================================
1    I129/010  2       SAC 8, SIC 8
2    I129/015  2       DAC 8, DIC 8
3    I129/020  3       MANUFACTURER 3x8
4    I129/030  3       MODEL 3x8
5    I129/040  12      SERIAL 12x8
6    I129/050  2       COUNTRY 2x8
7    I129/070  3       TOD 24: 1/128 s wraps
8    I129/080  8       LAT ±32: 180/2^30 deg refused, LON ±32: 180/2^30 deg refused
9    I129/090  3       ALTITUDE ±24: 0.1 m
10   I129/100  3       HEIGHT ±24: 0.1 m
11   I129/110  2       ACCURACY 16: 1 m
12   I129/120  3       UCC 2, ARC 2, AEC 4, _16
13   I129/SP   1+n     octets behind their count
14   I129/185  5       VX ±20: 0.01 m/s, VY ±20: 0.01 m/s
15   I129/220  3       _4, VZ ±20: 0.01 m/s
===  ========  ======  ============================================================================

I129/090 is above mean sea level, I129/100 above ground; I129/185 is east and north. An accuracy
(circular error, 50 %) of 0 says unknown or above 255 m. No encoding is stated for a serial number;
it is read as ASCII. The standard gives I129/120 one octet in a table but three in its description,
which is followed here; it describes the first of them. Sent from the air, the source is 0/0.
"""

from __future__ import annotations

from plotfeed.proto.asterix.codec.layout import (
    ASCII,
    Category,
    Characters,
    Explicit,
    Raw,
    Spare,
    fixed,
    position_180,
    signed,
    source,
    time_of_day,
    unsigned,
)

CAT129 = Category(
    129,
    (
        source("I129/010"),
        fixed("I129/015", Raw("DAC", 8), Raw("DIC", 8)),
        fixed("I129/020", Characters("MANUFACTURER", 3, ASCII)),
        fixed("I129/030", Characters("MODEL", 3, ASCII)),
        fixed("I129/040", Characters("SERIAL", 12, ASCII)),
        fixed("I129/050", Characters("COUNTRY", 2, ASCII)),
        time_of_day("I129/070"),
        fixed("I129/080", *position_180(32, 30)),
        fixed("I129/090", signed("ALTITUDE", 24, 0.1, "m")),
        fixed("I129/100", signed("HEIGHT", 24, 0.1, "m")),
        fixed("I129/110", unsigned("ACCURACY", 16, 1, "m")),
        fixed("I129/120", Raw("UCC", 2), Raw("ARC", 2), Raw("AEC", 4), Spare(16)),
        Explicit("I129/SP"),
        fixed("I129/185", signed("VX", 20, 0.01, "m/s"), signed("VY", 20, 0.01, "m/s")),
        fixed("I129/220", Spare(4), signed("VZ", 20, 0.01, "m/s")),
    ),
)
