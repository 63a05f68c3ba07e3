"""Parts and items that many categories share."""

from __future__ import annotations

from plotfeed.proto.asterix.layout import (
    DAY_LSB,
    Fixed,
    Named,
    Overflow,
    Quantity,
    Raw,
    fixed,
)


def source(item: str) -> Fixed:
    """Who sends: system area code and system identification code."""
    return fixed(item, Raw("SAC", 8), Raw("SIC", 8))


def time_of_day(item: str, name: str = "TOD") -> Fixed:
    """Seconds since midnight UTC."""
    time = Quantity(name, 24, 1 / 128, "s", overflow=Overflow.WRAP, modulus=DAY_LSB)
    return fixed(item, time)


def unsigned(name: str, bits: int, lsb: float, unit: str = "") -> Quantity:
    """A quantity from 0 on, which saturates."""
    return Quantity(name, bits, lsb, unit, overflow=Overflow.SATURATE)


def signed(name: str, bits: int, lsb: float, unit: str = "") -> Quantity:
    """A quantity of either sign, which saturates."""
    return Quantity(name, bits, lsb, unit, signed=True, overflow=Overflow.SATURATE)


def correlation(name: str) -> Quantity:
    """A coefficient of correlation: -1 to 127/128."""
    return signed(name, 8, 1 / 128)


def full_circle(name: str, bits: int = 16) -> Quantity:
    """An angle in as many steps as there are integers."""
    return Quantity(name, bits, 360 / (1 << bits), "deg", overflow=Overflow.WRAP)


def position(bits: int, latitude_lsb: float, longitude_lsb: float) -> tuple[Quantity, Quantity]:
    """Latitude and longitude, degrees. A longitude as wide as the circle wraps."""
    wraps = longitude_lsb * (1 << bits) == 360
    overflow = Overflow.WRAP if wraps else Overflow.REFUSE
    return (
        Quantity("LAT", bits, latitude_lsb, "deg", signed=True),
        Quantity("LON", bits, longitude_lsb, "deg", signed=True, overflow=overflow),
    )


def position_180(bits: int, exponent: int) -> tuple[Quantity, Quantity]:
    """Latitude and longitude, both in 180/2**exponent degrees."""
    return position(bits, 180 / (1 << exponent), 180 / (1 << exponent))


def single(part: Named) -> Fixed:
    """A subfield of one part, whose name it has."""
    return fixed(part.name, part)
