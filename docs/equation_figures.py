"""Prints the figures of docs/equations.md.

python docs/equation_figures.py
"""

from __future__ import annotations

import numpy as np
from collect import scene_with
from scipy.special import exp1, gammaincinv

PFA, N = 1e-6, 16
LEVELS_DB = (10, 20, 30, 40)


def multiplier(pfa: float, n: float) -> float:
    """Eq 6."""
    return float(np.expm1(-np.log(pfa) / n))


def snr_for(pd: float, pfa: float, n: int) -> float:
    """The ratio at which eq 7 gives that Pd."""
    root = pd ** (1 / n)
    return multiplier(pfa, n) * root / (1 - root) - 1


def rms_over_printed(snr: float) -> float:
    """Rms error over detections, beside the printed form with the mean ratio in it."""
    alpha = multiplier(PFA, N)
    shares = (np.arange(20_000) + 0.5) / 20_000
    y = alpha * gammaincinv(N, shares) / (1 + snr + alpha)
    return float(np.sqrt(snr * np.mean(np.exp(y) * exp1(y)) / (1 + snr)))


def main() -> None:
    """One figure a line."""
    (radar,) = scene_with("active")["sensor"]
    known_noise = np.log(PFA) / np.log(0.5) - 1  # Pd = Pfa^(1/(1+S)), noise known
    loss_db = 10 * np.log10(snr_for(0.5, PFA, N) / known_noise)
    print(f"eqs 6, 7: CFAR loss at Pd 0.5, Pfa {PFA:g}, N {N}: {loss_db:.2f} dB")
    rounded = abs((1e-6 ** (-1 / 1e12) - 1) / multiplier(1e-6, 1e12) - 1)
    print(f"eq 6 as printed in float64, Pfa 1e-6, N 1e12: relative error {rounded:.0e}")
    beams = round(360 / radar["azimuth_beamwidth_deg"])
    print(f"eqs 4, 9: {beams} azimuth cells, not {radar['receive_beams']}: "
          f"{beams / radar['receive_beams']:.3g} times the false alarms")  # fmt: skip
    rng = np.random.default_rng(1)
    for range_max_m in (1000, 10_000):
        range_m, height_m = rng.uniform(0, range_max_m, 10**6), rng.uniform(20, 120, 10**6)
        print(f"eqs 10, 12: height above range for {np.mean(height_m > range_m):.2%} of the alarms "
              f"within {range_max_m / 1000:g} km")  # fmt: skip
    print(f"eqs 14, 15: printed over ours: {1.6 * 2**0.5 / 2:.3f}")
    ratios = ", ".join(f"{rms_over_printed(10 ** (x / 10)):.2f}" for x in LEVELS_DB)
    print(f"eqs 13 to 15: rms of all detections over the printed form, at a mean of {LEVELS_DB} "
          f"dB: {ratios}")  # fmt: skip


if __name__ == "__main__":
    main()
