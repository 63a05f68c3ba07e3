"""What a radar's pulses leave of echoes: folded ranges, eclipses, blind speeds, several intervals.

A look is one interval of coherent integration, or several in a row, of which each decides by itself
and so many have to. Each has its own pulse frequency, and its place as a beam passes the target.
Echoes of different intervals fluctuate by themselves, as from one carrier to another.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import bdtrc, erf

from plotfeed.models.effects.echo_effects import GAUSSIAN_DB
from plotfeed.models.numerics import as_floats, nan_without_warnings
from plotfeed.models.propagation import C_M_S
from plotfeed.models.state import Floats, Ints

NEPERS_A_DB = float(np.log(10) / 20)  # Of an amplitude
# Mean-preserving gain of power, and the exponent of the sine, of cancellers of two and three
# pulses: over all rates their gain is 1, as that of the noise that passes them is taken to be.
CANCELLERS = {"single": (2.0, 2), "double": (8 / 3, 4)}


@nan_without_warnings
def folded_range_m(range_m: ArrayLike, prf_hz: ArrayLike) -> Floats:
    """Ranges as they appear after the latest pulse: below c/2PRF."""
    return as_floats(np.mod(as_floats(range_m), C_M_S / (2 * as_floats(prf_hz))))


@nan_without_warnings
def eclipse_factor(range_m: ArrayLike, prf_hz: ArrayLike, pulse_s: float) -> Floats:
    """What is left of an echo's power while the radar transmits: the square of the share heard.

    With x the range over the unambiguous one, mod 1, and d the duty: clip(min(x, 1 - x)/d, 0, 1)^2,
    on average 1 - 4d/3.
    """
    x = np.mod(2 * as_floats(range_m) * as_floats(prf_hz) / C_M_S, 1.0)
    duty = pulse_s * as_floats(prf_hz)
    return as_floats(np.clip(np.minimum(x, 1 - x) / duty, 0.0, 1.0) ** 2)


@nan_without_warnings
def filter_factor(
    rate_m_s: ArrayLike, prf_hz: ArrayLike, wavelength_m: float, canceller: str
) -> Floats:
    """Gain of power of a canceller of pulses over that of noise: blind at multiples of PRF."""
    gain, exponent = CANCELLERS[canceller]
    turns = 2 * as_floats(rate_m_s) / (wavelength_m * as_floats(prf_hz))
    off = turns - np.rint(turns)  # near a blind speed no digit is lost in the sine
    return as_floats(gain * np.sin(np.pi * off) ** exponent)


@nan_without_warnings
def at_least(pd: Floats, needed: int) -> Floats:
    """Probabilities that so many of independent trials succeed; (n, N) in, (n,) out.

    By adding one trial after the other: all terms are positive.
    """
    return tails(pd, needed)[0][:, needed]


def tails(pd: Floats, needed: int) -> list[Floats]:
    """Chances of j successes from each trial on, and after the last; N + 1 of (n, M + 1)."""
    after = np.zeros((len(pd), needed + 1))
    after[:, 0] = 1.0
    found = [after]
    for k in range(pd.shape[1] - 1, -1, -1):
        p, later = pd[:, k, None], found[0]
        now = np.ones_like(later)
        now[:, 1:] = p * later[:, :-1] + (1 - p) * later[:, 1:]
        found.insert(0, now)
    return found


def first_successes(pd: Floats, needed: int) -> Floats:
    """Chances that a trial is the first to succeed, given that so many do; (n, N)."""
    of_rest = tails(pd, needed)
    missed, found = np.ones(len(pd)), np.empty_like(pd)
    for k in range(pd.shape[1]):
        found[:, k] = missed * pd[:, k] * of_rest[k + 1][:, max(needed - 1, 0)]
        missed = missed * (1 - pd[:, k])
    with np.errstate(invalid="ignore"):
        return np.asarray(found / of_rest[0][:, needed, None])


def chosen(chances: Floats, uniform: Floats) -> Ints:
    """One column of each row by its chances, (n, N), and a uniform number; (n,)."""
    cumulated = np.cumsum(chances, axis=1)
    wanted = uniform * cumulated[:, -1]
    column: Ints = np.minimum((cumulated <= wanted[:, None]).sum(axis=1), chances.shape[1] - 1)
    return column


@dataclass(frozen=True, slots=True, kw_only=True)
class PassingBeam:
    """A beam that turns by `step_deg` in one interval, of Gaussian shape, on receive alone."""

    beamwidth_deg: float
    step_deg: float

    def power_factor(self, offset_deg: Floats) -> Floats:
        """Coherent mean of the amplitude over an interval whose middle is so far off, squared."""
        rate = np.sqrt(GAUSSIAN_DB * NEPERS_A_DB) / self.beamwidth_deg
        ends = [rate * (offset_deg + side * self.step_deg / 2) for side in (-1, 1)]
        mean = np.sqrt(np.pi) / 2 * (erf(ends[1]) - erf(ends[0])) / (rate * self.step_deg)
        return np.asarray(mean**2)


PHASES = 8  # Times between two intervals that stand for all


@dataclass(frozen=True, kw_only=True)
class PulseIntervals:
    """The intervals of a look: their pulse frequencies, and how many of them have to decide.

    One frequency leaves ranges folded, several resolve them. `stc_range_m` is where the control of
    sensitivity by time ends, 0 for none: nearer, by the time since the latest pulse, power goes as
    range to `stc_exponent`. `canceller` is one of `CANCELLERS`, and `notch_m_s` the width of a
    Gaussian notch, which folds with the frequency; without them rates are not filtered.
    """

    prfs_hz: tuple[float, ...]
    needed: int
    interval_s: float
    pulse_s: float
    wavelength_m: float
    stc_range_m: float = 0.0
    stc_exponent: float = 4.0
    canceller: str | None = None
    notch_m_s: float = 0.0
    beam: PassingBeam | None = None

    @property
    def count(self) -> int:
        """Intervals of a look."""
        return len(self.prfs_hz)

    @cached_property
    def folds_at_m(self) -> float | None:
        """Range after which all is the same again; None where several frequencies resolve it."""
        if len(set(self.prfs_hz)) > 1:
            return None
        return C_M_S / (2 * self.prfs_hz[0])

    @property
    def filters_rates(self) -> bool:
        """Whether echoes depend on how fast targets are."""
        return self.canceller is not None or self.notch_m_s > 0

    def false_alarm_probability(self, pfa: float) -> float:
        """Chance that so many intervals alarm in one cell, each with that probability."""
        return float(bdtrc(self.needed - 1, self.count, pfa))

    def folded_m(self, range_m: Floats) -> Floats:
        """Ranges as they are told."""
        return range_m if self.folds_at_m is None else np.asarray(np.mod(range_m, self.folds_at_m))

    def nearest_m(self, difference_m: Floats) -> Floats:
        """Differences of ranges to the nearest that is told alike."""
        if self.folds_at_m is None:
            return difference_m
        return np.asarray(difference_m - self.folds_at_m * np.rint(difference_m / self.folds_at_m))

    def power_factor(
        self, range_m: Floats, rate_m_s: Floats | None, t_utc_ns: Ints | None
    ) -> Floats:
        """Factors of power of each interval; (n,) in, (n, N) out."""
        prf_hz, range_m = np.array(self.prfs_hz), range_m[:, None]
        factor = np.ones((len(range_m), self.count))
        if self.pulse_s:
            factor *= eclipse_factor(range_m, prf_hz, self.pulse_s)
        if self.stc_range_m:
            share = folded_range_m(range_m, prf_hz) / self.stc_range_m
            factor *= np.minimum(1.0, share) ** self.stc_exponent
        if rate_m_s is not None and self.canceller is not None:
            rate = rate_m_s[:, None]
            factor *= filter_factor(rate, prf_hz, self.wavelength_m, self.canceller)
        if rate_m_s is not None and self.notch_m_s:
            span_m_s = self.wavelength_m * prf_hz / 2
            apparent = rate_m_s[:, None] - span_m_s * np.rint(rate_m_s[:, None] / span_m_s)
            factor *= -np.expm1(-((apparent / self.notch_m_s) ** 2))
        if self.beam is not None and t_utc_ns is not None:
            factor *= self.beam.power_factor(self._offsets_deg(self.beam, t_utc_ns))
        return factor

    def _offsets_deg(self, beam: PassingBeam, t_utc_ns: Ints) -> Floats:
        """Where the beam is in the middle of each interval, off targets that it meets then; (n, N).

        Intervals follow each other whenever a target comes: one of them holds that time.
        """
        interval_ns = max(round(self.interval_s * 1e9), 1)
        into = (t_utc_ns % interval_ns) / interval_ns
        number = np.arange(self.count) - self.count // 2
        return np.asarray(beam.step_deg * (number + 0.5 - into[:, None]))

    @cached_property
    def phases_ns(self) -> list[Ints]:
        """Times that stand for all at which targets are met, each (1,), for predictions."""
        interval_ns = max(round(self.interval_s * 1e9), 1)
        n = 1 if self.beam is None else PHASES
        return [np.array([interval_ns * (2 * i + 1) // (2 * n)], np.int64) for i in range(n)]
