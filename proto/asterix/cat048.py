"""Category 048, monoradar target reports; standard UAP, editions 1.21 to 1.32.

EUROCONTROL SUR.ET1.ST05.2000-STD-04-01 (ASTERIX part 4), the clause of an item is 5.2.<item>;
`codec.layout` explains the table. Codes of modes 2, 3/A and C are octal and Gray. I048/110 is above
mean sea level. Of what ends in EP, a bit says whether the value after it is populated.
"""

from plotfeed.proto.asterix.codec.layout import category

CAT048 = category(
    48,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I048/010  2       SAC 8, SIC 8
2    I048/140  3       TOD 24: 1/128 s modulo 86400
3    I048/020  1+FX    TYP 3, SIM, RDP, SPI, RAB | TST, ERR, XPP, ME, MI, FOEFRI 2 | ADSBEP,
                       ADSBVAL, SCNEP, SCNVAL, PAIEP, PAIVAL, _1 | ACASXVEP, ACASXVVAL 4, POXPREP,
                       POXPRVAL | POACTEP, POACTVAL, DTFXPREP, DTFXPRVAL, DTFACTEP, DTFACTVAL, _1 |
                       IRMXPREP, IRMXPRVAL, IRMACTEP, IRMACTVAL, _3
4    I048/040  4       RHO 16: 1/256 NM, THETA 16: 360/2^16 deg wraps
5    I048/070  2       V, G, L, _1, MODE3A 4x3
6    I048/090  2       V, G, FL ±14: 1/4 FL refused
7    I048/130  1+n     SRL 8: 180/2^12 deg; SRR 8; SAM ±8: 1 dBm; PRL 8: 180/2^12 deg; PAM ±8: 1
                       dBm; RPD ±8: 1/256 NM; APD ±8: 180/2^13 deg
8    I048/220  3       ADDRESS 24
9    I048/240  6       IDENTIFICATION 8x6
10   I048/250  1+8n    repeated: MBDATA 56, BDS1 4, BDS2 4
11   I048/161  2       _4, TRN 12
12   I048/042  4       X ±16: 1/128 NM, Y ±16: 1/128 NM
13   I048/200  4       GSP 16: 2^-14 NM/s, HDG 16: 360/2^16 deg wraps
14   I048/170  1+FX    CNF, RAD 2, DOU, MAH, CDM 2 | TRE, GHO, SUP, TCC, _3
15   I048/210  4       SIGX 8: 1/128 NM, SIGY 8: 1/128 NM, SIGV 8: 2^-14 NM/s, SIGH 8: 180/2^11 deg
16   I048/030  1+FX    repeated: WE 7
17   I048/080  2       _4, QA4, QA2, QA1, QB4, QB2, QB1, QC4, QC2, QC1, QD4, QD2, QD1
18   I048/100  4       V, G, _2, MODEC 12, _4, QC1, QA1, QC2, QA2, QC4, QA4, QB1, QD1, QB2, QD2,
                       QB4, QD4
19   I048/110  2       _2, HEIGHT ±14: 25 ft
20   I048/120  1+n     CAL (D, _5, CAL ±10: 1 m/s); RDS (repeated: DOP 16: 1 m/s refused, AMB 16: 1
                       m/s refused, FRQ 16: 1 MHz refused)
21   I048/230  2       COM 3, STAT 3, SI, _1, MSSC, ARC, AIC, B1A, B1B 4
22   I048/260  7       ADVISORY 56
23   I048/055  1       V, G, L, MODE1 5
24   I048/050  2       V, G, L, _1, MODE2 4x3
25   I048/065  1       _3, QA4, QA2, QA1, QB2, QB1
26   I048/060  2       _4, QA4, QA2, QA1, QB4, QB2, QB1, QC4, QC2, QC1, QD4, QD2, QD1
27   I048/SP   1+n     octets behind their count
28   I048/RE   1+n     octets behind their count
""",
)
