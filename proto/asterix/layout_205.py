"""Category 205, bearings of radio direction finders: its layout.

EUROCONTROL-SPEC-0149, category 205, edition 1.0; `codec.layout` explains the table. I205/030 is the
time of transmission, not of measurement. A bearing starts at I205/050 (I205/070) or at I205/060
(I205/080), which are positions of the sensor in messages of types 2 and 5. The category has no item
for the error of a bearing, the time of its measurement or what the emission says.
"""

from __future__ import annotations

from plotfeed.proto.asterix.codec.layout import category

CAT205 = category(
    205,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I205/010  2       SAC 8, SIC 8
2    I205/015  1       SID 8
3    I205/000  1       TYPE 8
4    I205/030  3       TOD 24: 1/128 s modulo 86400
5    I205/040  1       NUMBER 8
6    I205/090  7       CHANNEL 7x8
7    I205/050  8       LAT ±32: 180/2^25 deg refused, LON ±32: 180/2^25 deg refused
8    I205/060  6       X ±24: 1/2 m, Y ±24: 1/2 m
9    I205/070  2       BEARING 16: 0.01 deg modulo 360
10   I205/080  2       BEARING 16: 0.01 deg modulo 360
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
""",
)
