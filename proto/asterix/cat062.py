"""Category 062, system tracks; editions 1.19 to 1.21, and CAT062_1_18.

A quantity saturates where its row says nothing else; ± marks signed parts, _n spare bits, nxm n
characters of m bits, | an extension bit; a part without an LSB is an integer.
EUROCONTROL-SPEC-0149-9.

===  ========  ======  ============================================================================
FRN  item      octets  parts: bits, LSB and unit
===  ========  ======  ============================================================================
1    I062/010  2       SAC 8, SIC 8
3    I062/015  1       SID 8
4    I062/070  3       TOD 24: 1/128 s wraps
5    I062/105  8       LAT ±32: 180/2^25 deg refused, LON ±32: 180/2^25 deg refused
6    I062/100  6       X ±24: 1/2 m, Y ±24: 1/2 m
7    I062/185  4       VX ±16: 1/4 m/s, VY ±16: 1/4 m/s
8    I062/210  2       AX ±8: 1/4 m/s2, AY ±8: 1/4 m/s2
9    I062/060  2       V, G, CH, _1, MODE3A 4x3
10   I062/245  7       STI 2, _6, CHR 8x6
11   I062/380  1+n     ADR 24; ID 8x6; MHG 16: 360/2^16 deg wraps; IAS (IM, IAS 15); TAS 16: 1 kt;
                       SAL (SAS, SRC 2, ALT ±13: 25 ft); FSS (MV, AH, AM, ALT ±13: 25 ft); TIS
                       (NAV, NVB, _5); TID (repeated: TCA, NC, TCPN 6, ALT ±16: 10 ft, LAT ±24:
                       180/2^23 deg refused, LON ±24: 360/2^24 deg wraps, PT 4, TD 2, TRA, TOA, TOV
                       24: 1 s, TTR 16: 0.01 NM); COM (COM 3, STAT 3, _2, SSC, ARC, AIC, B1A, B1B
                       4); SAB (AC 2, MN 2, DC 2, GBS, _6, STAT 3); ACS 56; BVR ±16: 6.25 ft/min;
                       GVR ±16: 6.25 ft/min; RAN ±16: 0.01 deg; TAR (TI 2, _6, ROT ±7: 1/4 deg/s,
                       _1); TAN 16: 360/2^16 deg wraps; GS ±16: 2^-14 NM/s; VUN 8; MET (WS, WD,
                       TMP, TRB, _4, WSD 16: 1 kt, WDD 16: 1 deg, TMPD ±16: 1/4 °C, TRBD 8); EMC 8;
                       POS (LAT ±24: 180/2^23 deg refused, LON ±24: 360/2^24 deg wraps); GAL ±16:
                       6.25 ft; _4, PUN 4; BDSDATA (repeated: MBDATA 56, BDS1 4, BDS2 4); IAR 16: 1
                       kt; MAC 16: 0.008 Mach; _4, BPS 12: 0.1 mb
12   I062/040  2       TRN 16
13   I062/080  1+FX    MON, SPI, MRH, SRC 3, CNF | SIM, TSE, TSB, FPC, AFF, STP, KOS | AMA, MD4 2,
                       ME, MI, MD5 2 | CST, PSR, SSR, MDS, ADS, SUC, AAC | SDS 2, EMS 3, PFT, FPLT
                       | DUPT, DUPF, DUPM, SFC, IDD, IEC, MLAT | M5I, _6
14   I062/290  1+n     TRK 8: 1/4 s; PSR 8: 1/4 s; SSR 8: 1/4 s; MDS 8: 1/4 s; ADS 16: 1/4 s; ES 8:
                       1/4 s; VDL 8: 1/4 s; UAT 8: 1/4 s; LOP 8: 1/4 s; MLT 8: 1/4 s
15   I062/200  1       TRANS 2, LONG 2, VERT 2, ADF, _1
16   I062/295  1+n     MFL 8: 1/4 s; MD1 8: 1/4 s; MD2 8: 1/4 s; MDA 8: 1/4 s; MD4 8: 1/4 s; MD5 8:
                       1/4 s; MHG 8: 1/4 s; IAS 8: 1/4 s; TAS 8: 1/4 s; SAL 8: 1/4 s; FSS 8: 1/4 s;
                       TID 8: 1/4 s; COM 8: 1/4 s; SAB 8: 1/4 s; ACS 8: 1/4 s; BVR 8: 1/4 s; GVR 8:
                       1/4 s; RAN 8: 1/4 s; TAR 8: 1/4 s; TAN 8: 1/4 s; GSP 8: 1/4 s; VUN 8: 1/4 s;
                       MET 8: 1/4 s; EMC 8: 1/4 s; POS 8: 1/4 s; GAL 8: 1/4 s; PUN 8: 1/4 s; MB 8:
                       1/4 s; IAR 8: 1/4 s; MAC 8: 1/4 s; BPS 8: 1/4 s
17   I062/136  2       FL ±16: 1/4 FL
18   I062/130  2       ALTITUDE ±16: 6.25 ft
19   I062/135  2       QNH, CTB ±15: 1/4 FL
20   I062/220  2       RATE ±16: 6.25 ft/min
21   I062/390  1+n     TAG (SAC 8, SIC 8); CS 7x8; IFI (TYP 2, _3, NBR 27); FCT (GATOAT 2, FR1FR2
                       2, RVSM 2, HPR, _1); TAC 4x8; WTC 1x8; DEP 4x8; DST 4x8; RDS (NU1 1x8, NU2
                       1x8, LTR 1x8); CFL 16: 1/4 FL; CTL (CENTRE 8, POSITION 8); TOD (repeated:
                       TYP 5, DAY 2, _4, HOR 5, _2, MIN 6, AVS, _1, SEC 6); AST 6x8; STS (EMP 2,
                       AVL 2, _4); STD 7x8; STA 7x8; PEM (_3, VA, MODE3A 4x3); PEC 7x8
22   I062/270  1+FX    LENGTH 7: 1 m | ORIENTATION 7: 360/2^7 deg wraps | WIDTH 7: 1 m
23   I062/300  1       FLEET 8
24   I062/110  1+n     SUM (M5, ID, DA, M1, M2, M3, MC, X); PMN (_2, PIN 14, _3, NAT 5, _2, MIS 6);
                       POS (LAT ±24: 180/2^23 deg refused, LON ±24: 360/2^24 deg wraps); GA (_1,
                       RES, GA ±14: 25 ft); _4, EM1 4x3; TOS ±8: 1/128 s; XP (_3, X5, XC, X3, X2,
                       X1)
25   I062/120  2       _4, MODE2 4x3
26   I062/510  3+FX    repeated: IDENT 8, TRACK 15
27   I062/500  1+n     APC (X 16: 1/2 m, Y 16: 1/2 m); COV ±16: 1/2 m; APW (LAT 16: 180/2^25 deg,
                       LON 16: 180/2^25 deg); AGA 8: 6.25 ft; ABA 8: 1/4 FL; ATV (X 8: 1/4 m/s, Y
                       8: 1/4 m/s); AA (X 8: 1/4 m/s2, Y 8: 1/4 m/s2); ARC 8: 6.25 ft/min
28   I062/340  1+n     SID (SAC 8, SIC 8); POS (RHO 16: 1/256 NM, THETA 16: 360/2^16 deg wraps);
                       HEIGHT ±16: 25 ft; MDC (V, G, LMC ±14: 1/4 FL); MDA (V, G, L, _1, MODE3A
                       4x3); TYP (TYP 3, SIM, RAB, TST, _2)
34   I062/RE   1+n     octets behind their count
35   I062/SP   1+n     octets behind their count
===  ========  ======  ============================================================================

IAS in I062/380 counts 2^-14 NM/s, or 0.001 Mach where IM is set. LMC is a flight level. Editions up
to 1.18 have no height below 0 in I062/340; earlier ones have fewer groups of I062/080.
"""

from __future__ import annotations

from plotfeed.proto.asterix.cat062_parts import AIRCRAFT, FLIGHT_PLAN
from plotfeed.proto.asterix.codec.layout import (
    CALLSIGN,
    OCTAL,
    Category,
    Characters,
    Compound,
    Explicit,
    Fixed,
    Quantity,
    Raw,
    Spare,
    extended,
    fixed,
    flags,
    full_circle,
    position_180,
    repeated_fx,
    signed,
    single,
    source,
    time_of_day,
    unsigned,
)


def _ages(names: str) -> tuple[Fixed, ...]:
    """Subfields of one age each; their names stand between spaces."""
    return tuple(single(unsigned(name, 8, 1 / 4, "s")) for name in names.split())


def _category(height: Quantity) -> Category:
    return Category(
        62,
        (
            source("I062/010"),
            None,
            fixed("I062/015", Raw("SID", 8)),
            time_of_day("I062/070"),
            fixed("I062/105", *position_180(32, 25)),
            fixed("I062/100", signed("X", 24, 1 / 2, "m"), signed("Y", 24, 1 / 2, "m")),
            fixed("I062/185", signed("VX", 16, 1 / 4, "m/s"), signed("VY", 16, 1 / 4, "m/s")),
            fixed("I062/210", signed("AX", 8, 1 / 4, "m/s2"), signed("AY", 8, 1 / 4, "m/s2")),
            fixed("I062/060", *flags("V G CH"), Spare(1), Characters("MODE3A", 4, OCTAL)),
            fixed("I062/245", Raw("STI", 2), Spare(6), Characters("CHR", 8, CALLSIGN)),
            AIRCRAFT,
            fixed("I062/040", Raw("TRN", 16)),
            extended(
                "I062/080",
                (
                    *flags("MON SPI MRH"),
                    Raw("SRC", 3),
                    Raw("CNF", 1),
                ),
                (*flags("SIM TSE TSB FPC AFF STP KOS"),),
                (
                    Raw("AMA", 1),
                    Raw("MD4", 2),
                    Raw("ME", 1),
                    Raw("MI", 1),
                    Raw("MD5", 2),
                ),
                (*flags("CST PSR SSR MDS ADS SUC AAC"),),
                (
                    Raw("SDS", 2),
                    Raw("EMS", 3),
                    Raw("PFT", 1),
                    Raw("FPLT", 1),
                ),
                (*flags("DUPT DUPF DUPM SFC IDD IEC MLAT"),),
                (
                    Raw("M5I", 1),
                    Spare(6),
                ),
            ),
            Compound(
                "I062/290",
                (
                    *_ages("TRK PSR SSR MDS"),
                    single(unsigned("ADS", 16, 1 / 4, "s")),
                    *_ages("ES VDL UAT LOP MLT"),
                ),
            ),
            fixed(
                "I062/200", Raw("TRANS", 2), Raw("LONG", 2), Raw("VERT", 2), Raw("ADF", 1), Spare(1)
            ),
            Compound(
                "I062/295",
                _ages(
                    "MFL MD1 MD2 MDA MD4 MD5 MHG IAS TAS SAL FSS TID COM SAB ACS"
                    " BVR GVR RAN TAR TAN GSP VUN MET EMC POS GAL PUN MB IAR MAC BPS"
                ),
            ),
            fixed("I062/136", signed("FL", 16, 1 / 4, "FL")),
            fixed("I062/130", signed("ALTITUDE", 16, 6.25, "ft")),
            fixed("I062/135", Raw("QNH", 1), signed("CTB", 15, 1 / 4, "FL")),
            fixed("I062/220", signed("RATE", 16, 6.25, "ft/min")),
            FLIGHT_PLAN,
            extended(
                "I062/270",
                (unsigned("LENGTH", 7, 1, "m"),),
                (full_circle("ORIENTATION", 7),),
                (unsigned("WIDTH", 7, 1, "m"),),
            ),
            fixed("I062/300", Raw("FLEET", 8)),
            Compound(
                "I062/110",
                (
                    fixed("SUM", *flags("M5 ID DA M1 M2 M3 MC X")),
                    fixed(
                        "PMN",
                        Spare(2),
                        Raw("PIN", 14),
                        Spare(3),
                        Raw("NAT", 5),
                        Spare(2),
                        Raw("MIS", 6),
                    ),
                    fixed("POS", *position_180(24, 23)),
                    fixed("GA", Spare(1), Raw("RES", 1), signed("GA", 14, 25, "ft")),
                    fixed("EM1", Spare(4), Characters("EM1", 4, OCTAL)),
                    single(signed("TOS", 8, 1 / 128, "s")),
                    fixed("XP", Spare(3), *flags("X5 XC X3 X2 X1")),
                ),
            ),
            fixed("I062/120", Spare(4), Characters("MODE2", 4, OCTAL)),
            repeated_fx("I062/510", Raw("IDENT", 8), Raw("TRACK", 15)),
            Compound(
                "I062/500",
                (
                    fixed("APC", unsigned("X", 16, 1 / 2, "m"), unsigned("Y", 16, 1 / 2, "m")),
                    single(signed("COV", 16, 1 / 2, "m")),
                    fixed(
                        "APW",
                        unsigned("LAT", 16, 180 / (1 << 25), "deg"),
                        unsigned("LON", 16, 180 / (1 << 25), "deg"),
                    ),
                    single(unsigned("AGA", 8, 6.25, "ft")),
                    single(unsigned("ABA", 8, 1 / 4, "FL")),
                    fixed("ATV", unsigned("X", 8, 1 / 4, "m/s"), unsigned("Y", 8, 1 / 4, "m/s")),
                    fixed("AA", unsigned("X", 8, 1 / 4, "m/s2"), unsigned("Y", 8, 1 / 4, "m/s2")),
                    single(unsigned("ARC", 8, 6.25, "ft/min")),
                ),
            ),
            Compound(
                "I062/340",
                (
                    source("SID"),
                    fixed("POS", unsigned("RHO", 16, 1 / 256, "NM"), full_circle("THETA")),
                    single(height),
                    fixed("MDC", Raw("V", 1), Raw("G", 1), signed("LMC", 14, 1 / 4, "FL")),
                    fixed("MDA", *flags("V G L"), Spare(1), Characters("MODE3A", 4, OCTAL)),
                    fixed("TYP", Raw("TYP", 3), *flags("SIM RAB TST"), Spare(2)),
                ),
            ),
            None,
            None,
            None,
            None,
            None,
            Explicit("I062/RE"),
            Explicit("I062/SP"),
        ),
    )


CAT062 = _category(signed("HEIGHT", 16, 25, "ft"))
CAT062_1_18 = _category(unsigned("HEIGHT", 16, 25, "ft"))
"""Editions up to 1.18, which have no height below 0 in I062/340."""
