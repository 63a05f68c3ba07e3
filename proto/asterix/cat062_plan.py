"""I062/390, what the flight plan says; the docstring of cat062 has its table."""

from __future__ import annotations

from plotfeed.proto.asterix.layout import (
    ASCII,
    OCTAL,
    Characters,
    Compound,
    Raw,
    Spare,
    fixed,
    repeated,
)
from plotfeed.proto.asterix.parts import (
    single,
    source,
    unsigned,
)

FLIGHT_PLAN = Compound(
    "I062/390",
    (
        source("TAG"),
        single(Characters("CS", 7, ASCII)),
        fixed("IFI", Raw("TYP", 2), Spare(3), Raw("NBR", 27)),
        fixed("FCT", Raw("GATOAT", 2), Raw("FR1FR2", 2), Raw("RVSM", 2), Raw("HPR", 1), Spare(1)),
        single(Characters("TAC", 4, ASCII)),
        single(Characters("WTC", 1, ASCII)),
        single(Characters("DEP", 4, ASCII)),
        single(Characters("DST", 4, ASCII)),
        fixed(
            "RDS",
            Characters("NU1", 1, ASCII),
            Characters("NU2", 1, ASCII),
            Characters("LTR", 1, ASCII),
        ),
        single(unsigned("CFL", 16, 1 / 4, "FL")),
        fixed("CTL", Raw("CENTRE", 8), Raw("POSITION", 8)),
        repeated(
            "TOD",
            Raw("TYP", 5),
            Raw("DAY", 2),
            Spare(4),
            Raw("HOR", 5),
            Spare(2),
            Raw("MIN", 6),
            Raw("AVS", 1),
            Spare(1),
            Raw("SEC", 6),
        ),
        single(Characters("AST", 6, ASCII)),
        fixed("STS", Raw("EMP", 2), Raw("AVL", 2), Spare(4)),
        single(Characters("STD", 7, ASCII)),
        single(Characters("STA", 7, ASCII)),
        fixed("PEM", Spare(3), Raw("VA", 1), Characters("MODE3A", 4, OCTAL)),
        single(Characters("PEC", 7, ASCII)),
    ),
)
