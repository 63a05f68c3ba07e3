"""Category 015, target reports of non-cooperative surveillance: its layout.

EUROCONTROL-SPEC-0149, category 015, editions 1.0 to 1.2; `codec.layout` explains the table.
I015/480 holds measurement identifiers, as I015/400 does. Range is that of a monostatic sensor, or
with MOMU = 1 the path transmitter-target-receiver less the baseline. The powers of I015/630 have no
reference in the standard.
"""

from __future__ import annotations

from plotfeed.proto.asterix.codec.layout import category

CAT015 = category(
    15,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I015/010  2       SAC 8, SIC 8
2    I015/000  1       MT 7, RG
3    I015/015  1       SID 8
4    I015/020  1+FX    MOMU 2, TTAX 2, SCD 2, _1
5    I015/030  1+FX    repeated: WE 7
6    I015/145  3       TOA 24: 1/128 s modulo 86400
7    I015/161  2       TPN 16
8    I015/170  1+FX    BIZ, BAZ, TUR, _1, CSTP, CSTH, CNF
9    I015/050  2       _2, UPD 14: 1/128 s
10   I015/270  1+n     LEN 16: 0.01 m; WDT 16: 0.01 m; HGT 16: 0.01 m; ORT 16: 360/2^16 deg wraps
11   I015/300  1+2n    repeated: CLS 9, PRB 7
12   I015/400  5       PID 16, ON 24
13   I015/600  1+n     P84 (LAT ±32: 180/2^31 deg refused, LON ±32: 360/2^32 deg wraps); HPR (RSHPX
                       16: 1/2 m, RSHPY 16: 1/2 m, CORSHPXY ±8: 1/128); HPP (SDHPX 16: 1/4 m, SDHPY
                       16: 1/4 m, COSDHPXY ±8: 1/128)
14   I015/601  1+n     GH ±24: 0.01 m; RSGH 24: 0.01 m; SDGH 24: 0.01 m; CI6 (UCI6 12: 16 m, LCI6
                       12: 16 m); CI9 (UCI9 12: 16 m, LCI9 12: 16 m); COGHHP (X ±8: 1/128, Y ±8:
                       1/128); COGHHV (X ±8: 1/128, Y ±8: 1/128); COGHHA (X ±8: 1/128, Y ±8: 1/128)
15   I015/602  1+n     HV (X ±20: 0.01 m/s, Y ±20: 0.01 m/s); RSHV (X 16: 0.01 m/s, Y 16: 0.01 m/s,
                       CORSHVXY ±8: 1/128); SDHV (X 16: 0.01 m/s, Y 16: 0.01 m/s, COHVXY ±8:
                       1/128); COHVHP (COHVXHPX ±8: 1/128, COHVXHPY ±8: 1/128, COHVYHPX ±8: 1/128,
                       COHVYHPY ±8: 1/128)
16   I015/603  1+n     HA (X ±12: 1/16 m/s2, Y ±12: 1/16 m/s2); SDHA (X 12: 1/16 m/s2, Y 12: 1/16
                       m/s2, COHAXY ±8: 1/128); COHAHP (COHAXHPX ±8: 1/128, COHAXHPY ±8: 1/128,
                       COHAYHPX ±8: 1/128, COAYHPY ±8: 1/128); COHAHV (COHAXHVX ±8: 1/128, COHAXHVY
                       ±8: 1/128, COHAYHVX ±8: 1/128, COHAYHVY ±8: 1/128)
17   I015/604  1+n     VV ±24: 0.01 m/s; RSVV 16: 0.01 m/s; SDVV (SDVV 16: 0.01 m/s, COVVGH ±8:
                       1/128); COVVHP (X ±8: 1/128, Y ±8: 1/128); COVVHV (X ±8: 1/128, Y ±8:
                       1/128); COVVHA (X ±8: 1/128, Y ±8: 1/128)
18   I015/605  1+n     VA ±16: 0.01 m/s2; RSVA (SDVA 16: 0.01 m/s2, COVAGH ±8: 1/128, COVAVV ±8:
                       1/128); COVAHP (X ±8: 1/128, Y ±8: 1/128); COVAHV (X ±8: 1/128, Y ±8:
                       1/128); COVAHA (X ±8: 1/128, Y ±8: 1/128)
19   I015/480  1+5n    repeated: PID 16, ON 24
20   I015/625  1+n     R ±24: 0.1 m; RSR 24: 0.1 m; SDR 24: 0.1 m; RR ±24: 0.1 m/s; RSRR 24: 0.1
                       m/s; SDRR (SDRR 24: 0.1 m/s, CORRR ±8: 1/128); RA ±16: 1/64 m/s2; SDRA (SDRA
                       16: 1/128 m/s2, CORAR ±8: 1/128, CORARR ±8: 1/128)
21   I015/626  1+n     DV ±24: 0.01 m/s; SDDV 16: 1/64 m/s; DA ±16: 1/64 m/s2; SDDA (SDDA 16: 1/64
                       m/s2, CODADV ±8: 1/128); CODVR ±8: 1/128; CODVRR ±8: 1/128; CODVRA ±8:
                       1/128; CODAR ±8: 1/128; CODARR ±8: 1/128; CODARA ±8: 1/128
22   I015/627  1+n     AZ 16: 360/2^16 deg wraps; RSAZ 16: 180/2^18 deg; SDASZ 16: 180/2^18 deg;
                       AZR ±16: 180/2^16 deg/s; SDAZR (SDAZR 16: 180/2^18 deg/s, COAZRAZ ±8:
                       1/128); AZEX (S 16: 360/2^16 deg wraps, E 16: 360/2^16 deg wraps)
23   I015/628  1+n     EL ±16: 180/2^16 deg; RSEL 16: 180/2^18 deg; SDEL 16: 180/2^18 deg; ER ±16:
                       180/2^16 deg/s; SDER (SDELR 16: 180/2^18 deg/s, COELREL ±8: 1/128); ELEX (S
                       ±16: 180/2^16 deg, E ±16: 180/2^16 deg)
24   I015/630  1+n     DPP ±8: 1 dB; DPS ±8: 1 dB; _7, RPP ±9: 1 dB; RPS ±8: 1 dB
25   I015/631  1+8n    repeated: AZCON 16: 360/2^16 deg wraps, ELCON ±16: 180/2^16 deg, RGCONSTOP
                       16: 10000/2^16 m, RGCONSTART 16: 10000/2^16 m
26   I015/SP   1+n     octets behind their count
""",
)
