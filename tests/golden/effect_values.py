"""Values of what effects are made of, each from its definition; `args` are name=value."""

from __future__ import annotations

import itertools
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


def _by_numbers(order: Any, total: Any, first: Any, more: Iterator[Any]) -> Any:
    """A sum over numbers of a Poisson law whose mean is a gamma variable.

    `first` is the chance of a hit at none, and `more` by how much it grows from each to the next.
    """
    steady = order == "inf"
    odds = F(0) if steady else (total / order) / (1 + total / order)
    weight = mp.exp(-total) if steady else (1 - odds) ** order
    hit, pd, k = F(0), first, 0
    while weight > F("1e-40") or k < total:
        hit += weight * pd
        weight *= total / (k + 1) if steady else odds * (order + k) / (k + 1)
        pd, k = pd + next(more), k + 1
    return hit


def _cfar(n: int, m: int, p: Any) -> tuple[Any, Iterator[Any]]:
    """I_p(m, n), and what each order more adds."""
    step = p**m * (1 - p) ** n / (n * mp.beta(m, n))

    def more() -> Iterator[Any]:
        at = step
        for j in itertools.count(n):
            yield at
            at *= (1 - p) * (m + j) / (j + 1)

    return mp.betainc(m, n, 0, p, regularized=True), more()


def targets() -> Iterator[Row]:
    """Swerling's cases against sums of reference samples."""
    for case, n, m, snr_db in (
        *((0, 1, 16, 11), (3, 1, 16, 10), (4, 8, 24, 10), (3, 3, 48, 15)),
        *((1, 3, 48, 6), (2, 8, 24, -3), (0, 10, 160, 6)),
    ):
        p = mp.findroot(
            lambda p: mp.log(mp.betainc(m, n, 0, p, regularized=True)) - mp.log(F("1e-6")),  # noqa: B023
            (F("0.2"), F("0.95")),
        )
        order = ("inf", F(1), F(n), F(2), F(2 * n))[case]
        pd = _by_numbers(order, n * F(10) ** (F(snr_db) / 10), *_cfar(n, m, p))
        args = {"case": case, "n_looks": n, "n_reference": m, "snr_db": snr_db, "pfa": "1e-6"}
        yield _row("pd_swerling_cfar", pd, **args)


def pulses() -> Iterator[Row]:
    """Gains of cancellers, close to a speed at which they are blind, at 3 cm."""
    for kind, (gain, exponent) in {"single": (2, 2), "double": (F(8) / 3, 4)}.items():
        for prf, off in (("1000", "1e-6"), ("1200", "0.3"), ("5000", "7")):
            turns = 2 * F(off) / (F("0.03") * F(prf))
            value = gain * mp.sinpi(turns) ** exponent
            yield _row("canceller_gain", value, kind=kind, prf_hz=prf, off_m_s=off)


def together() -> Iterator[Row]:
    """Two looks at one amplitude: what of the second is left given the first, integrated."""
    s, pfa = F(10) ** F("1.3"), F("1e-6")
    y, mean = -mp.log(pfa), 1 + s
    for rho in ("0", "0.5", "0.9", "0.99"):
        r2 = (F(rho) * s / mean) ** 2  # of the two powers, which are exponential
        wide = mean * (1 - r2)

        def second(x: Any, r2: Any = r2, wide: Any = wide) -> Any:
            at, hit = r2 * x / wide, F(0)  # Poisson numbers of a gamma law
            weight, k = mp.exp(-at), 0
            term = tail = mp.exp(-y / wide)
            while k < at or weight > F("1e-20"):
                hit += weight * tail
                k += 1
                weight *= at / k
                term *= y / wide / k
                tail += term
            return hit

        with mp.workdps(20):
            joint = mp.quad(
                lambda x: mp.exp(-x / mean) / mean * second(x), [y, 3 * mean, 40 * mean]
            )
        yield _row("joint_hit_gauss_markov", mp.nstr(joint, 12), snr_db=13, pfa="1e-6", rho=rho)


def effects() -> Iterator[Row]:
    """All of them."""
    yield from together()
    yield from pulses()
    yield from antennas()
    yield from targets()
