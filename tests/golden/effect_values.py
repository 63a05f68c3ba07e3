"""Values of what effects are made of, each from its definition; `args` are name=value."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from mpmath import mp

Row = dict[str, Any]
F = mp.mpf


def _row(name: str, value: Any, **args: Any) -> Row:
    told = ";".join(f"{key}={each}" for key, each in args.items())
    return {"name": name, "args": told, "value": value}


def _gaussian(offset: Any) -> Any:
    """Power one way of a beam that has a half of it a half width off."""
    return mp.mpf(2) ** (-4 * F(offset) ** 2)


def antennas() -> Iterator[Row]:
    """Beams off their middle, their shapes, and cells."""
    for offset in ("0.1", "0.5", "1", "1.7"):
        value = 10 * mp.log10(_gaussian(offset))
        yield _row("beam_gain_gaussian_oneway_db", value, offset_beamwidths=offset)
    for low, high in (("6", "40"), ("2", "30"), ("10", "60")):
        e1, e2 = (F(e) * mp.pi / 180 for e in (low, high))
        # What a fan has over its lower part, and what all of the shaped beam has beside it.
        whole = (e1 + mp.quad(lambda e: (mp.sin(e1) / mp.sin(e)) ** 2, [e1, e2])) / e1  # noqa: B023
        shaped = 2 - e1 / mp.tan(e2)
        near = abs(whole / shaped - 1)
        assert near < F("0.02"), near
        yield _row("cosecant_peak_loss_db", 10 * mp.log10(shaped), from_deg=low, to_deg=high)
    for shape, amplitude in {
        "sinc": mp.sincpi,
        "triangle": lambda x: 1 - x,
        "hann": lambda x: mp.sincpi(x) / (1 - x**2),
    }.items():
        mean = 2 * mp.quad(lambda x: amplitude(x) ** 2, [0, F("0.5")])  # noqa: B023
        yield _row(f"straddle_{shape}_mean_power_db", -10 * mp.log10(mean))
        yield _row(f"straddle_{shape}_worst_db", -20 * mp.log10(amplitude(F("0.5"))))
    for spacing in ("0.5", "0.71", "1"):
        half = F(spacing) / 2
        mean = mp.quad(lambda x: _gaussian(x) ** 2, [-half, half]) / (2 * half)
        yield _row("beams_mean_loss_twoway_db", -10 * mp.log10(mean), spacing_beamwidths=spacing)


def effects() -> Iterator[Row]:
    """All of them."""
    yield from antennas()
