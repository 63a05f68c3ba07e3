"""Category 016, configuration of non-cooperative surveillance systems: its layout.

EUROCONTROL-SPEC-0149, category 016, edition 1.0; `codec.layout` explains the table. I016/405 is
above mean sea level, ALT above the WGS-84 ellipsoid.
"""

from __future__ import annotations

from plotfeed.proto.asterix.codec.layout import category

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
