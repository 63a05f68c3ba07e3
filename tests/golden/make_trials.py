"""Writes reference/mc_cacfar.csv: detectors tried out cell by cell, by NumPy, in half a minute.

    .venv/bin/python tests/golden/make_trials.py

Profiles of complex Gaussian noise, with a Swerling 2 echo in the cell under test, are squared and
summed over looks; the threshold is a multiple of the cells around it without two guard cells a
side. Beside each count stands the chance in closed form, by detection_values.py.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from detection_values import linear, outlasting, ratio_of

TARGET = Path(__file__).parent / "reference" / "mc_cacfar.csv"
GUARD = 2
AT_A_TIME = 20_000
CASES = [
    (1, 16, "1e-2", "noise_only", 2_000_000),
    (1, 16, "1e-3", "0", 300_000),
    (1, 16, "1e-4", "10", 300_000),
    (1, 32, "1e-6", "20", 300_000),
    (2, 16, "1e-3", "5", 200_000),
    (3, 16, "1e-2", "noise_only", 1_000_000),
    (3, 16, "1e-4", "5", 200_000),
    (3, 32, "1e-6", "10", 200_000),
]


def hits(design: tuple[int, int, float], snr: float, n: int, seed: int) -> int:
    """How many of n trials cross, of looks, cells, and the multiple that is the threshold."""
    n_looks, n_cells, ratio = design
    rng = np.random.default_rng(seed)
    width, found = n_cells + 2 * GUARD + 1, 0
    middle = width // 2
    around = [i for i in range(width) if abs(i - middle) > GUARD]
    for start in range(0, n, AT_A_TIME):
        shape = (min(AT_A_TIME, n - start), n_looks, width)
        noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
        echo = rng.standard_normal(shape[:2]) + 1j * rng.standard_normal(shape[:2])
        noise[..., middle] += np.sqrt(snr) * echo
        power = (np.abs(noise) ** 2).sum(axis=1)
        found += int((power[:, middle] > ratio * power[:, around].sum(axis=1)).sum())
    return found


def main() -> None:
    """Writes the table."""
    with TARGET.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["n_integrated", "n_ref", "pfa", "snr_db", "trials", "hits", "closed_form"])
        for seed, (n_looks, n_cells, pfa, snr_db, n) in enumerate(CASES):
            snr = 0 if snr_db == "noise_only" else linear(snr_db)
            ratio = ratio_of(n_looks, n_cells * n_looks, pfa)
            closed = outlasting(n_looks, n_cells * n_looks, ratio / (1 + snr))
            crossed = hits((n_looks, n_cells, float(ratio)), float(snr), n, seed)
            table.writerow([n_looks, n_cells, pfa, snr_db, n, crossed, f"{float(closed):.15g}"])


if __name__ == "__main__":
    main()
