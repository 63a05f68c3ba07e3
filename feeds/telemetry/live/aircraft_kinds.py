"""What aircraft are to sensors, by the categories that they transmit of themselves.

The sets A and B are those of DO-260B, 2.2.3.2.5.2; MAVLink counts through both.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

AIRCRAFT = "aircraft"  # The class of what is no drone


class AircraftKind(NamedTuple):
    """Radar cross-section and size across of a kind of aircraft."""

    rcs_m2: float
    size_m: float


LIGHT = AircraftKind(1.0, 11.0)
SMALL = AircraftKind(2.0, 14.6)
LARGE = AircraftKind(20.0, 35.8)
HEAVY = AircraftKind(100.0, 60.9)
FAST = AircraftKind(6.0, 13.1)
ROTORCRAFT = AircraftKind(3.0, 13.6)
GLIDER = AircraftKind(0.5, 15.0)
# Cross-sections: Skolnik, Introduction to Radar Systems, 3rd edition, table 2.2; that of a glider
# is assumed. Sizes: spans of a Cessna 172, Learjet 45, Boeing 737-800, 777-200ER and F-15, the
# length of an H145 with its rotor, and the span of the standard class.
UNMANNED = None

OF_CATEGORY: Mapping[str, AircraftKind | None] = {
    "A1": LIGHT,
    "A2": SMALL,
    "A3": LARGE,
    "A4": LARGE,
    "A5": HEAVY,
    "A6": FAST,
    "A7": ROTORCRAFT,
    "B1": GLIDER,
    "B4": GLIDER,
    "B6": UNMANNED,
}
OF_EMITTER_021: Mapping[int, AircraftKind | None] = {
    1: LIGHT,
    2: SMALL,
    3: LARGE,
    4: LARGE,
    5: HEAVY,
    6: FAST,
    10: ROTORCRAFT,
    11: GLIDER,
    13: UNMANNED,
    16: GLIDER,
}
OF_EMITTER_MAVLINK: Mapping[int, AircraftKind | None] = {
    int(name[1]) + (8 if name[0] == "B" else 0): kind for name, kind in OF_CATEGORY.items()
}


def as_reported(kind: AircraftKind | None) -> dict[str, Any]:
    """The fields of a report of one; what is unmanned is a drone as the scene has it."""
    if kind is None:
        return {}
    return {"rcs_m2": kind.rcs_m2, "size_m": kind.size_m, "target_class": AIRCRAFT}
