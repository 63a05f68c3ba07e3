"""What the rows of docs/stability.md are made of, and how their figures are written."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mpmath as mp

mp.mp.dps = 60
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
PLAIN_DIGITS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
# Errors below these, by unit, are those of the last digits: another machine's may differ.
ROUNDING = {"": 1e-14, "m": 1e-8, "m/s": 1e-8, "°": 1e-12}


@dataclass(frozen=True, kw_only=True)
class Case:
    """One place where a plain form fails; errors are relative where they have no unit."""

    where: str
    plain_form: str
    plain: float | str  # Its error, or what comes in place of a number
    cure: str
    ours: float | str
    unit: str = ""
    test: str  # The test that holds ours: file::name, below tests/


def relative(found: object, exact: object) -> float:
    """Relative error of a float beside a number of sixty digits; NaN where there is no number."""
    value = float(found)  # type: ignore[arg-type]
    if not math.isfinite(value):
        return math.nan
    return float(abs(mp.mpf(value) / exact - 1))


def in_words(error: float | str, unit: str = "") -> str:
    """An error to one digit; what is rounding alone, as that."""
    if isinstance(error, str):
        return error
    if math.isnan(error):
        return "no number"
    after = unit if unit == "°" else f" {unit}".rstrip()
    if 0 < error < ROUNDING.get(unit, 0.0) or (error == 0 and not unit):
        return f"under {in_words(ROUNDING[unit])}{after}"
    if error == 0 or 0.01 <= error < 1000:
        return f"{float(f'{error:.1g}'):g}{after}"
    digit, exponent = f"{error:.0e}".split("e")
    return f"{'' if digit == '1' else f'{digit}·'}{power(int(exponent))}{after}"


def power(exponent: int) -> str:
    """A power of ten."""
    return f"10{str(exponent).translate(SUPERSCRIPT)}"


def figure_of(words: str) -> float | None:
    """The number that `in_words` wrote, without its unit; None where it wrote none."""
    first = words.removeprefix("under ").partition(" ")[0].removesuffix("°")
    digit, _, ten = first.rpartition("·")
    if ten.startswith("10") and len(ten) > 2 and ten[2] in "⁻⁰¹²³⁴⁵⁶⁷⁸⁹":
        return float(digit or 1) * 10.0 ** int(ten[2:].translate(PLAIN_DIGITS))
    try:
        return float(first)
    except ValueError:
        return None
