"""I062/380, what an aircraft says of itself; the docstring of cat062 has its table."""

from __future__ import annotations

from plotfeed.proto.asterix.layout import (
    CALLSIGN,
    Characters,
    Compound,
    Raw,
    Spare,
    extended,
    fixed,
    flags,
    repeated,
)
from plotfeed.proto.asterix.parts import (
    full_circle,
    position_180,
    signed,
    single,
    unsigned,
)

AIRCRAFT = Compound(
    "I062/380",
    (
        single(Raw("ADR", 24)),
        single(Characters("ID", 8, CALLSIGN)),
        single(full_circle("MHG")),
        fixed("IAS", Raw("IM", 1), Raw("IAS", 15)),
        single(unsigned("TAS", 16, 1, "kt")),
        fixed("SAL", Raw("SAS", 1), Raw("SRC", 2), signed("ALT", 13, 25, "ft")),
        fixed("FSS", *flags("MV AH AM"), signed("ALT", 13, 25, "ft")),
        extended(
            "TIS",
            (
                Raw("NAV", 1),
                Raw("NVB", 1),
                Spare(5),
            ),
        ),
        repeated(
            "TID",
            Raw("TCA", 1),
            Raw("NC", 1),
            Raw("TCPN", 6),
            signed("ALT", 16, 10, "ft"),
            *position_180(24, 23),
            Raw("PT", 4),
            Raw("TD", 2),
            Raw("TRA", 1),
            Raw("TOA", 1),
            unsigned("TOV", 24, 1, "s"),
            unsigned("TTR", 16, 0.01, "NM"),
        ),
        fixed(
            "COM", Raw("COM", 3), Raw("STAT", 3), Spare(2), *flags("SSC ARC AIC B1A"), Raw("B1B", 4)
        ),
        fixed(
            "SAB", Raw("AC", 2), Raw("MN", 2), Raw("DC", 2), Raw("GBS", 1), Spare(6), Raw("STAT", 3)
        ),
        single(Raw("ACS", 56)),
        single(signed("BVR", 16, 6.25, "ft/min")),
        single(signed("GVR", 16, 6.25, "ft/min")),
        single(signed("RAN", 16, 0.01, "deg")),
        fixed("TAR", Raw("TI", 2), Spare(6), signed("ROT", 7, 1 / 4, "deg/s"), Spare(1)),
        single(full_circle("TAN")),
        single(signed("GS", 16, 1 / (1 << 14), "NM/s")),
        single(Raw("VUN", 8)),
        fixed(
            "MET",
            *flags("WS WD TMP TRB"),
            Spare(4),
            unsigned("WSD", 16, 1, "kt"),
            unsigned("WDD", 16, 1, "deg"),
            signed("TMPD", 16, 1 / 4, "°C"),
            Raw("TRBD", 8),
        ),
        single(Raw("EMC", 8)),
        fixed("POS", *position_180(24, 23)),
        single(signed("GAL", 16, 6.25, "ft")),
        fixed("PUN", Spare(4), Raw("PUN", 4)),
        repeated("BDSDATA", Raw("MBDATA", 56), Raw("BDS1", 4), Raw("BDS2", 4)),
        single(unsigned("IAR", 16, 1, "kt")),
        single(unsigned("MAC", 16, 0.008, "Mach")),
        fixed("BPS", Spare(4), unsigned("BPS", 12, 0.1, "mb")),
    ),
)
