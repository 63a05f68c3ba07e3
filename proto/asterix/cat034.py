"""Category 034, monoradar service messages; editions 1.27 to 1.29.

EUROCONTROL SUR.ET1.ST05.2000-STD-02b-01 (ASTERIX part 2b), the clause of an item is 5.2.<item>;
`codec.layout` explains the table. I034/000 is 1 for a north marker, 2 for a sector crossing. The
height of I034/120 is above WGS-84.
"""

from plotfeed.proto.asterix.codec.layout import category

CAT034 = category(
    34,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I034/010  2       SAC 8, SIC 8
2    I034/000  1       TYPE 8
3    I034/030  3       TOD 24: 1/128 s modulo 86400
4    I034/020  1       SECTOR 8: 360/2^8 deg wraps
5    I034/041  2       PERIOD 16: 1/128 s refused
6    I034/050  1+n     COM (NOGO, RDPC, RDPR, OVLRDP, OVLXMT, MSC, TSV, _1); -; -; PSR (ANT, CHAB
                       2, OVL, MSC, _3); SSR (ANT, CHAB 2, OVL, MSC, _3); MDS (ANT, CHAB 2, OVLSUR,
                       MSC, SCF, DLF, OVLSCF, OVLDLF, _7)
7    I034/060  1+n     COM (_1, REDRDP 3, REDXMT 3, _1); -; -; PSR (POL, REDRAD 3, STC 2, _2); SSR
                       (REDRAD 3, _5); MDS (REDRAD 3, CLU, _4)
8    I034/070  1+2n    repeated: TYP 5, COUNT 11
9    I034/100  8       RHOST 16: 1/256 NM, RHOEND 16: 1/256 NM, THETAST 16: 360/2^16 deg wraps,
                       THETAEND 16: 360/2^16 deg wraps
10   I034/110  1       TYP 8
11   I034/120  8       HGT ±16: 1 m refused, LAT ±24: 180/2^23 deg refused, LON ±24: 360/2^24 deg
                       wraps
12   I034/090  2       RNG ±8: 1/128 NM refused, AZM ±8: 180/2^13 deg refused
13   I034/RE   1+n     octets behind their count
14   I034/SP   1+n     octets behind their count
""",
)
