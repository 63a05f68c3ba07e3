"""Category 048, monoradar target reports; standard UAP, editions 1.21 to 1.32.

Signed parts are marked ±, spare bits _n; a part without a unit is a raw integer. EUROCONTROL
SUR.ET1.ST05.2000-STD-04-01 (ASTERIX part 4), the clause of an item is 5.2.<item>.

===  ========  =======  ==============================================================
FRN  item      octets   parts: bits, LSB and unit
===  ========  =======  ==============================================================
1    I048/010  2        SAC 8, SIC 8
2    I048/140  3        time of day 24: 1/128 s, modulo 86400 s
3    I048/020  1+FX     TYP 3, SIM, RDP, SPI, RAB
                        TST, ERR, XPP, ME, MI, FOEFRI 2
                        ADSB 2, SCN 2, PAI 2, _1
                        ACASXV 5, POXPR 2
                        POACT 2, DTFXPR 2, DTFACT 2, _1
                        IRMXPR 2, IRMACT 2, _3
4    I048/040  4        RHO 16: 1/256 NM, saturates; THETA 16: 360/2^16 deg, wraps
5    I048/070  2        V, G, L, _1, Mode 3/A 12: four octal digits
6    I048/090  2        V, G, FL ±14: 1/4 FL
7    I048/130  1+n      SRL 8: 360/2^13 deg; SRR 8; SAM ±8: 1 dBm; PRL 8: 360/2^13 deg;
                        PAM ±8: 1 dBm; RPD ±8: 1/256 NM; APD ±8: 360/2^14 deg
8    I048/220  3        aircraft address 24
9    I048/240  6        eight characters of 6
10   I048/250  1+8n     MBDATA 56, BDS1 4, BDS2 4
11   I048/161  2        _4, track number 12
12   I048/042  4        X ±16, Y ±16: 1/128 NM
13   I048/200  4        GSP 16: 2^-14 NM/s; HDG 16: 360/2^16 deg, wraps
14   I048/170  1+FX     CNF, RAD 2, DOU, MAH, CDM 2
                        TRE, GHO, SUP, TCC, _3
15   I048/210  4        SIGX, SIGY 8: 1/128 NM; SIGV 8: 2^-14 NM/s; SIGH 8: 360/2^12 deg
16   I048/030  1+FX     warning or error condition 7, repeated
17   I048/080  2        _4, QA4 QA2 QA1 QB4 QB2 QB1 QC4 QC2 QC1 QD4 QD2 QD1
18   I048/100  4        V, G, _2, Mode C 12 (Gray), _4, QC1 QA1 QC2 QA2 QC4 QA4 QB1 QD1
                        QB2 QD2 QB4 QD4
19   I048/110  2        _2, height ±14: 25 ft above mean sea level, saturates
20   I048/120  1+n      CAL: D, _5, CAL ±10: 1 m/s, saturates;
                        RDS: 1+6n, DOP 16: 1 m/s; AMB 16: 1 m/s; FRQ 16: 1 MHz
21   I048/230  2        COM 3, STAT 3, SI, _1, MSSC, ARC, AIC, B1A, B1B 4
22   I048/260  7        resolution advisory 56
23   I048/055  1        V, G, L, Mode 1 5
24   I048/050  2        V, G, L, _1, Mode 2 12: four octal digits
25   I048/065  1        _3, QA4 QA2 QA1 QB2 QB1
26   I048/060  2        as I048/080
27   I048/SP   1+n      special purpose
28   I048/RE   1+n      reserved expansion
===  ========  =======  ==============================================================
"""

from __future__ import annotations

from plotfeed.proto.asterix.codec.layout import (
    CALLSIGN,
    DAY_LSB,
    OCTAL,
    Category,
    Characters,
    Compound,
    Explicit,
    Overflow,
    Quantity,
    Raw,
    Spare,
    extended,
    fixed,
    flags,
    repeated,
    repeated_fx,
)

CIRCLE_16 = 360 / (1 << 16)
NM_S = 1 / (1 << 14)

V_G_L = flags("V G L")
PULSES_ABCD = flags("QA4 QA2 QA1 QB4 QB2 QB1 QC4 QC2 QC1 QD4 QD2 QD1")
PULSES_C = flags("QC1 QA1 QC2 QA2 QC4 QA4 QB1 QD1 QB2 QD2 QB4 QD4")


def _run_length(name: str) -> Quantity:
    return Quantity(name, 8, 360 / (1 << 13), "deg", overflow=Overflow.SATURATE)


def _signed_octet(name: str, lsb: float, unit: str) -> Quantity:
    return Quantity(name, 8, lsb, unit, signed=True, overflow=Overflow.SATURATE)


def _signed_16(name: str, lsb: float, unit: str) -> Quantity:
    return Quantity(name, 16, lsb, unit, signed=True, overflow=Overflow.SATURATE)


def _full_circle(name: str) -> Quantity:
    return Quantity(name, 16, CIRCLE_16, "deg", overflow=Overflow.WRAP)


def _element(name: str, bits: int = 1) -> tuple[Raw, Raw]:
    """Whether an element is populated, and its value."""
    return Raw(f"{name}EP", 1), Raw(f"{name}VAL", bits)


CAT048 = Category(
    48,
    (
        fixed("I048/010", Raw("SAC", 8), Raw("SIC", 8)),
        fixed(
            "I048/140",
            Quantity("TOD", 24, 1 / 128, "s", overflow=Overflow.WRAP, modulus=DAY_LSB),
        ),
        extended(
            "I048/020",
            (Raw("TYP", 3), *flags("SIM RDP SPI RAB")),
            (*flags("TST ERR XPP ME MI"), Raw("FOEFRI", 2)),
            (*_element("ADSB"), *_element("SCN"), *_element("PAI"), Spare(1)),
            (*_element("ACASXV", 4), *_element("POXPR")),
            (*_element("POACT"), *_element("DTFXPR"), *_element("DTFACT"), Spare(1)),
            (*_element("IRMXPR"), *_element("IRMACT"), Spare(3)),
        ),
        fixed(
            "I048/040",
            Quantity("RHO", 16, 1 / 256, "NM", overflow=Overflow.SATURATE),
            _full_circle("THETA"),
        ),
        fixed("I048/070", *V_G_L, Spare(1), Characters("MODE3A", 4, OCTAL)),
        fixed("I048/090", *flags("V G"), Quantity("FL", 14, 1 / 4, "FL", signed=True)),
        Compound(
            "I048/130",
            (
                fixed("SRL", _run_length("SRL")),
                fixed("SRR", Raw("SRR", 8)),
                fixed("SAM", _signed_octet("SAM", 1, "dBm")),
                fixed("PRL", _run_length("PRL")),
                fixed("PAM", _signed_octet("PAM", 1, "dBm")),
                fixed("RPD", _signed_octet("RPD", 1 / 256, "NM")),
                fixed("APD", _signed_octet("APD", 360 / (1 << 14), "deg")),
            ),
        ),
        fixed("I048/220", Raw("ADDRESS", 24)),
        fixed("I048/240", Characters("IDENTIFICATION", 8, CALLSIGN)),
        repeated("I048/250", Raw("MBDATA", 56), Raw("BDS1", 4), Raw("BDS2", 4)),
        fixed("I048/161", Spare(4), Raw("TRN", 12)),
        fixed("I048/042", _signed_16("X", 1 / 128, "NM"), _signed_16("Y", 1 / 128, "NM")),
        fixed(
            "I048/200",
            Quantity("GSP", 16, NM_S, "NM/s", overflow=Overflow.SATURATE),
            _full_circle("HDG"),
        ),
        extended(
            "I048/170",
            (Raw("CNF", 1), Raw("RAD", 2), *flags("DOU MAH"), Raw("CDM", 2)),
            (*flags("TRE GHO SUP TCC"), Spare(3)),
        ),
        fixed(
            "I048/210",
            Quantity("SIGX", 8, 1 / 128, "NM", overflow=Overflow.SATURATE),
            Quantity("SIGY", 8, 1 / 128, "NM", overflow=Overflow.SATURATE),
            Quantity("SIGV", 8, NM_S, "NM/s", overflow=Overflow.SATURATE),
            Quantity("SIGH", 8, 360 / (1 << 12), "deg", overflow=Overflow.SATURATE),
        ),
        repeated_fx("I048/030", Raw("WE", 7)),
        fixed("I048/080", Spare(4), *PULSES_ABCD),
        fixed("I048/100", *flags("V G"), Spare(2), Raw("MODEC", 12), Spare(4), *PULSES_C),
        fixed(
            "I048/110",
            Spare(2),
            Quantity("HEIGHT", 14, 25, "ft", signed=True, overflow=Overflow.SATURATE),
        ),
        Compound(
            "I048/120",
            (
                fixed(
                    "CAL",
                    Raw("D", 1),
                    Spare(5),
                    Quantity("CAL", 10, 1, "m/s", signed=True, overflow=Overflow.SATURATE),
                ),
                repeated(
                    "RDS",
                    Quantity("DOP", 16, 1, "m/s"),
                    Quantity("AMB", 16, 1, "m/s"),
                    Quantity("FRQ", 16, 1, "MHz"),
                ),
            ),
        ),
        fixed(
            "I048/230",
            Raw("COM", 3),
            Raw("STAT", 3),
            Raw("SI", 1),
            Spare(1),
            *flags("MSSC ARC AIC B1A"),
            Raw("B1B", 4),
        ),
        fixed("I048/260", Raw("ADVISORY", 56)),
        fixed("I048/055", *V_G_L, Raw("MODE1", 5)),
        fixed("I048/050", *V_G_L, Spare(1), Characters("MODE2", 4, OCTAL)),
        fixed("I048/065", Spare(3), *flags("QA4 QA2 QA1 QB2 QB1")),
        fixed("I048/060", Spare(4), *PULSES_ABCD),
        Explicit("I048/SP"),
        Explicit("I048/RE"),
    ),
)
