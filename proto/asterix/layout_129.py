"""Category 129, unmanned aircraft that say where they are: its layout.

EUROCONTROL-SPEC-0149-29, edition 1.2; `codec.layout` explains the table. No decoder that the tests
can run reads the category: the layout is as published descriptions of edition 1.2 have it.

I129/090 is above mean sea level, I129/100 above ground; I129/185 is east and north. No encoding is
stated for a serial number; it is read as ASCII. The standard gives I129/120 one octet in a table
but three in its description, which is followed here; it describes the first of them.
"""

from __future__ import annotations

from plotfeed.proto.asterix.codec.layout import category

CAT129 = category(
    129,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I129/010  2       SAC 8, SIC 8
2    I129/015  2       DAC 8, DIC 8
3    I129/020  3       MANUFACTURER 3x8
4    I129/030  3       MODEL 3x8
5    I129/040  12      SERIAL 12x8
6    I129/050  2       COUNTRY 2x8
7    I129/070  3       TOD 24: 1/128 s modulo 86400
8    I129/080  8       LAT ±32: 180/2^30 deg refused, LON ±32: 180/2^30 deg refused
9    I129/090  3       ALTITUDE ±24: 0.1 m
10   I129/100  3       HEIGHT ±24: 0.1 m
11   I129/110  2       ACCURACY 16: 1 m
12   I129/120  3       UCC 2, ARC 2, AEC 4, _16
13   I129/SP   1+n     octets behind their count
14   I129/185  5       VX ±20: 0.01 m/s, VY ±20: 0.01 m/s
15   I129/220  3       _4, VZ ±20: 0.01 m/s
""",
)
