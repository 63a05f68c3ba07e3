"""Category 015, target reports of non-cooperative surveillance; editions 1.0 to 1.2.

A quantity saturates where its row says nothing else; ± marks signed parts, _n spare bits, nxm n
characters of m bits, | an extension bit; a part without an LSB is an integer.
EUROCONTROL-SPEC-0149, category 015.

===  ========  ======  ============================================================================
FRN  item      octets  parts: bits, LSB and unit
===  ========  ======  ============================================================================
1    I015/010  2       SAC 8, SIC 8
2    I015/000  1       MT 7, RG
3    I015/015  1       SID 8
4    I015/020  1+FX    MOMU 2, TTAX 2, SCD 2, _1
5    I015/030  1+FX    repeated: WE 7
6    I015/145  3       TOA 24: 1/128 s wraps
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
                       16: 0.152588 m, RGCONSTART 16: 0.152588 m
26   I015/SP   1+n     octets behind their count
===  ========  ======  ============================================================================

I015/480 holds measurement identifiers, as I015/400 does. Range is that of a monostatic sensor, or
with MOMU = 1 the path transmitter-target-receiver less the baseline. The powers of I015/630 have no
reference in the standard.
"""

from __future__ import annotations

from plotfeed.proto.asterix.codec.layout import (
    Category,
    Compound,
    Explicit,
    Raw,
    Spare,
    correlation,
    extended,
    fixed,
    flags,
    full_circle,
    position_180,
    repeated,
    repeated_fx,
    signed,
    single,
    source,
    time_of_day,
    unsigned,
)

CAT015 = Category(
    15,
    (
        source("I015/010"),
        fixed("I015/000", Raw("MT", 7), Raw("RG", 1)),
        fixed("I015/015", Raw("SID", 8)),
        extended(
            "I015/020",
            (
                Raw("MOMU", 2),
                Raw("TTAX", 2),
                Raw("SCD", 2),
                Spare(1),
            ),
        ),
        repeated_fx("I015/030", Raw("WE", 7)),
        time_of_day("I015/145", "TOA"),
        fixed("I015/161", Raw("TPN", 16)),
        extended(
            "I015/170",
            (
                *flags("BIZ BAZ TUR"),
                Spare(1),
                *flags("CSTP CSTH CNF"),
            ),
        ),
        fixed("I015/050", Spare(2), unsigned("UPD", 14, 1 / 128, "s")),
        Compound(
            "I015/270",
            (
                single(unsigned("LEN", 16, 0.01, "m")),
                single(unsigned("WDT", 16, 0.01, "m")),
                single(unsigned("HGT", 16, 0.01, "m")),
                single(full_circle("ORT")),
            ),
        ),
        repeated("I015/300", Raw("CLS", 9), Raw("PRB", 7)),
        fixed("I015/400", Raw("PID", 16), Raw("ON", 24)),
        Compound(
            "I015/600",
            (
                fixed("P84", *position_180(32, 31)),
                fixed(
                    "HPR",
                    unsigned("RSHPX", 16, 1 / 2, "m"),
                    unsigned("RSHPY", 16, 1 / 2, "m"),
                    correlation("CORSHPXY"),
                ),
                fixed(
                    "HPP",
                    unsigned("SDHPX", 16, 1 / 4, "m"),
                    unsigned("SDHPY", 16, 1 / 4, "m"),
                    correlation("COSDHPXY"),
                ),
            ),
        ),
        Compound(
            "I015/601",
            (
                single(signed("GH", 24, 0.01, "m")),
                single(unsigned("RSGH", 24, 0.01, "m")),
                single(unsigned("SDGH", 24, 0.01, "m")),
                fixed("CI6", unsigned("UCI6", 12, 16, "m"), unsigned("LCI6", 12, 16, "m")),
                fixed("CI9", unsigned("UCI9", 12, 16, "m"), unsigned("LCI9", 12, 16, "m")),
                fixed("COGHHP", correlation("X"), correlation("Y")),
                fixed("COGHHV", correlation("X"), correlation("Y")),
                fixed("COGHHA", correlation("X"), correlation("Y")),
            ),
        ),
        Compound(
            "I015/602",
            (
                fixed("HV", signed("X", 20, 0.01, "m/s"), signed("Y", 20, 0.01, "m/s")),
                fixed(
                    "RSHV",
                    unsigned("X", 16, 0.01, "m/s"),
                    unsigned("Y", 16, 0.01, "m/s"),
                    correlation("CORSHVXY"),
                ),
                fixed(
                    "SDHV",
                    unsigned("X", 16, 0.01, "m/s"),
                    unsigned("Y", 16, 0.01, "m/s"),
                    correlation("COHVXY"),
                ),
                fixed(
                    "COHVHP",
                    correlation("COHVXHPX"),
                    correlation("COHVXHPY"),
                    correlation("COHVYHPX"),
                    correlation("COHVYHPY"),
                ),
            ),
        ),
        Compound(
            "I015/603",
            (
                fixed("HA", signed("X", 12, 1 / 16, "m/s2"), signed("Y", 12, 1 / 16, "m/s2")),
                fixed(
                    "SDHA",
                    unsigned("X", 12, 1 / 16, "m/s2"),
                    unsigned("Y", 12, 1 / 16, "m/s2"),
                    correlation("COHAXY"),
                ),
                fixed(
                    "COHAHP",
                    correlation("COHAXHPX"),
                    correlation("COHAXHPY"),
                    correlation("COHAYHPX"),
                    correlation("COAYHPY"),
                ),
                fixed(
                    "COHAHV",
                    correlation("COHAXHVX"),
                    correlation("COHAXHVY"),
                    correlation("COHAYHVX"),
                    correlation("COHAYHVY"),
                ),
            ),
        ),
        Compound(
            "I015/604",
            (
                single(signed("VV", 24, 0.01, "m/s")),
                single(unsigned("RSVV", 16, 0.01, "m/s")),
                fixed("SDVV", unsigned("SDVV", 16, 0.01, "m/s"), correlation("COVVGH")),
                fixed("COVVHP", correlation("X"), correlation("Y")),
                fixed("COVVHV", correlation("X"), correlation("Y")),
                fixed("COVVHA", correlation("X"), correlation("Y")),
            ),
        ),
        Compound(
            "I015/605",
            (
                single(signed("VA", 16, 0.01, "m/s2")),
                fixed(
                    "RSVA",
                    unsigned("SDVA", 16, 0.01, "m/s2"),
                    correlation("COVAGH"),
                    correlation("COVAVV"),
                ),
                fixed("COVAHP", correlation("X"), correlation("Y")),
                fixed("COVAHV", correlation("X"), correlation("Y")),
                fixed("COVAHA", correlation("X"), correlation("Y")),
            ),
        ),
        repeated("I015/480", Raw("PID", 16), Raw("ON", 24)),
        Compound(
            "I015/625",
            (
                single(signed("R", 24, 0.1, "m")),
                single(unsigned("RSR", 24, 0.1, "m")),
                single(unsigned("SDR", 24, 0.1, "m")),
                single(signed("RR", 24, 0.1, "m/s")),
                single(unsigned("RSRR", 24, 0.1, "m/s")),
                fixed("SDRR", unsigned("SDRR", 24, 0.1, "m/s"), correlation("CORRR")),
                single(signed("RA", 16, 1 / 64, "m/s2")),
                fixed(
                    "SDRA",
                    unsigned("SDRA", 16, 1 / 128, "m/s2"),
                    correlation("CORAR"),
                    correlation("CORARR"),
                ),
            ),
        ),
        Compound(
            "I015/626",
            (
                single(signed("DV", 24, 0.01, "m/s")),
                single(unsigned("SDDV", 16, 1 / 64, "m/s")),
                single(signed("DA", 16, 1 / 64, "m/s2")),
                fixed("SDDA", unsigned("SDDA", 16, 1 / 64, "m/s2"), correlation("CODADV")),
                single(correlation("CODVR")),
                single(correlation("CODVRR")),
                single(correlation("CODVRA")),
                single(correlation("CODAR")),
                single(correlation("CODARR")),
                single(correlation("CODARA")),
            ),
        ),
        Compound(
            "I015/627",
            (
                single(full_circle("AZ")),
                single(unsigned("RSAZ", 16, 360 / (1 << 19), "deg")),
                single(unsigned("SDASZ", 16, 360 / (1 << 19), "deg")),
                single(signed("AZR", 16, 360 / (1 << 17), "deg/s")),
                fixed(
                    "SDAZR", unsigned("SDAZR", 16, 360 / (1 << 19), "deg/s"), correlation("COAZRAZ")
                ),
                fixed("AZEX", full_circle("S"), full_circle("E")),
            ),
        ),
        Compound(
            "I015/628",
            (
                single(signed("EL", 16, 360 / (1 << 17), "deg")),
                single(unsigned("RSEL", 16, 360 / (1 << 19), "deg")),
                single(unsigned("SDEL", 16, 360 / (1 << 19), "deg")),
                single(signed("ER", 16, 360 / (1 << 17), "deg/s")),
                fixed(
                    "SDER", unsigned("SDELR", 16, 360 / (1 << 19), "deg/s"), correlation("COELREL")
                ),
                fixed(
                    "ELEX",
                    signed("S", 16, 360 / (1 << 17), "deg"),
                    signed("E", 16, 360 / (1 << 17), "deg"),
                ),
            ),
        ),
        Compound(
            "I015/630",
            (
                single(signed("DPP", 8, 1, "dB")),
                single(signed("DPS", 8, 1, "dB")),
                fixed("RPP", Spare(7), signed("RPP", 9, 1, "dB")),
                single(signed("RPS", 8, 1, "dB")),
            ),
        ),
        repeated(
            "I015/631",
            full_circle("AZCON"),
            signed("ELCON", 16, 360 / (1 << 17), "deg"),
            unsigned("RGCONSTOP", 16, 10_000 / (1 << 16), "m"),
            unsigned("RGCONSTART", 16, 10_000 / (1 << 16), "m"),
        ),
        Explicit("I015/SP"),
    ),
)
