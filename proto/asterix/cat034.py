"""Category 034, monoradar service messages; editions 1.27 to 1.29.

Signed parts are marked ±, spare bits _n; a part without a unit is a raw integer. EUROCONTROL
SUR.ET1.ST05.2000-STD-02b-01 (ASTERIX part 2b), the clause of an item is 5.2.<item>.

===  ========  =======  ==============================================================
FRN  item      octets   parts: bits, LSB and unit
===  ========  =======  ==============================================================
1    I034/010  2        SAC 8, SIC 8
2    I034/000  1        message type 8: 1 north marker, 2 sector crossing
3    I034/030  3        time of day 24: 1/128 s, modulo 86400 s
4    I034/020  1        sector azimuth 8: 360/2^8 deg, wraps
5    I034/041  2        antenna rotation period 16: 1/128 s
6    I034/050  1+n      COM: NOGO, RDPC, RDPR, OVLRDP, OVLXMT, MSC, TSV, _1
                        PSR and SSR (flags 4 and 5): ANT, CHAB 2, OVL, MSC, _3
                        MDS (flag 6): ANT, CHAB 2, OVLSUR, MSC, SCF, DLF, OVLSCF, OVLDLF, _7
7    I034/060  1+n      COM: _1, REDRDP 3, REDXMT 3, _1
                        PSR (flag 4): POL, REDRAD 3, STC 2, _2
                        SSR (flag 5): REDRAD 3, _5
                        MDS (flag 6): REDRAD 3, CLU, _4
8    I034/070  1+2n     TYP 5, COUNT 11
9    I034/100  8        RHOST, RHOEND 16: 1/256 NM; THETAST, THETAEND 16: 360/2^16 deg, wrap
10   I034/110  1        data filter 8
11   I034/120  8        HGT ±16: 1 m above WGS-84; LAT, LON ±24: 180/2^23 deg
12   I034/090  2        RNG ±8: 1/128 NM; AZM ±8: 360/2^14 deg
13   I034/RE   1+n      reserved expansion
14   I034/SP   1+n      special purpose
===  ========  =======  ==============================================================
"""

from __future__ import annotations

from plotfeed.proto.asterix.codec.layout import (
    DAY_LSB,
    Category,
    Compound,
    Explicit,
    Fixed,
    Overflow,
    Quantity,
    Raw,
    Spare,
    fixed,
    flags,
    repeated,
)

CIRCLE_16 = 360 / (1 << 16)
CIRCLE_24 = 360 / (1 << 24)


def _head_status(name: str) -> Fixed:
    """The status of a primary or a secondary sensor, I034/050."""
    return fixed(name, Raw("ANT", 1), Raw("CHAB", 2), *flags("OVL MSC"), Spare(3))


CAT034 = Category(
    34,
    (
        fixed("I034/010", Raw("SAC", 8), Raw("SIC", 8)),
        fixed("I034/000", Raw("TYPE", 8)),
        fixed(
            "I034/030",
            Quantity("TOD", 24, 1 / 128, "s", overflow=Overflow.WRAP, modulus=DAY_LSB),
        ),
        fixed("I034/020", Quantity("SECTOR", 8, 360 / (1 << 8), "deg", overflow=Overflow.WRAP)),
        fixed("I034/041", Quantity("PERIOD", 16, 1 / 128, "s")),
        Compound(
            "I034/050",
            (
                fixed(
                    "COM",
                    *flags("NOGO RDPC RDPR OVLRDP OVLXMT MSC TSV"),
                    Spare(1),
                ),
                None,
                None,
                _head_status("PSR"),
                _head_status("SSR"),
                fixed(
                    "MDS",
                    Raw("ANT", 1),
                    Raw("CHAB", 2),
                    *flags("OVLSUR MSC SCF DLF OVLSCF OVLDLF"),
                    Spare(7),
                ),
            ),
        ),
        Compound(
            "I034/060",
            (
                fixed("COM", Spare(1), Raw("REDRDP", 3), Raw("REDXMT", 3), Spare(1)),
                None,
                None,
                fixed("PSR", Raw("POL", 1), Raw("REDRAD", 3), Raw("STC", 2), Spare(2)),
                fixed("SSR", Raw("REDRAD", 3), Spare(5)),
                fixed("MDS", Raw("REDRAD", 3), Raw("CLU", 1), Spare(4)),
            ),
        ),
        repeated("I034/070", Raw("TYP", 5), Raw("COUNT", 11)),
        fixed(
            "I034/100",
            Quantity("RHOST", 16, 1 / 256, "NM", overflow=Overflow.SATURATE),
            Quantity("RHOEND", 16, 1 / 256, "NM", overflow=Overflow.SATURATE),
            Quantity("THETAST", 16, CIRCLE_16, "deg", overflow=Overflow.WRAP),
            Quantity("THETAEND", 16, CIRCLE_16, "deg", overflow=Overflow.WRAP),
        ),
        fixed("I034/110", Raw("TYP", 8)),
        fixed(
            "I034/120",
            Quantity("HGT", 16, 1, "m", signed=True),
            Quantity("LAT", 24, CIRCLE_24, "deg", signed=True),
            Quantity("LON", 24, CIRCLE_24, "deg", signed=True, overflow=Overflow.WRAP),
        ),
        fixed(
            "I034/090",
            Quantity("RNG", 8, 1 / 128, "NM", signed=True),
            Quantity("AZM", 8, 360 / (1 << 14), "deg", signed=True),
        ),
        Explicit("I034/RE"),
        Explicit("I034/SP"),
    ),
)
