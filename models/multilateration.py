"""Places by least squares from sums of ranges, directions and what is known of heights.

A pair of transmitter and receiver measures |x - tx| + |x - rx|, whose gradient is the sum of the
unit vectors from both. Stations near the ground leave heights open, up to a kilometre: so heights
are expected to be normal about a mean, as one more measurement. Steps are those of Gauss and Newton
by QR, which keeps twice the digits that normal equations do; the covariance is (J'J)^-1 of rows
over their standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plotfeed.models.frames import wrap_180
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.state import Floats

STEPS = 8  # Of Gauss and Newton, from a start that is as near as a search finds
LONGEST_STEP_M = 3000.0
LOST = 1e12  # Standard deviation, in units of a row, of what was not measured


@dataclass(frozen=True, slots=True, kw_only=True)
class Sightings:
    """What pairs measured of places, (h, p), NaN for what they did not; stations are (p, 3).

    Directions are seen from the receivers, in degrees. Heights are expected above the origin.
    """

    transmitters_m: Floats
    receivers_m: Floats
    sum_m: Floats
    sigma_sum_m: Floats
    azimuth_deg: Floats
    sigma_azimuth_deg: Floats
    elevation_deg: Floats
    sigma_elevation_deg: Floats
    height_m: float
    sigma_height_m: float

    def rows(self) -> Floats:
        """How many rows each place has beyond the three that it takes; (h,)."""
        measured = [self.sum_m, self.azimuth_deg, self.elevation_deg]
        return np.asarray(sum((~np.isnan(m)).sum(axis=1) for m in measured) + 1 - 3)


@dataclass(frozen=True, slots=True)
class Solved:
    """Places (h, 3), their covariances (h, 3, 3) and sums of squares of residuals (h,)."""

    place_m: Floats
    covariance_m2: Floats
    square: Floats


def range_sums_m(place_m: Floats, transmitters_m: Floats, receivers_m: Floats) -> Floats:
    """Ways from transmitters by places to receivers; (..., 3), (p, 3), (p, 3) in, (..., p) out."""
    place_m = place_m[..., None, :]
    out = np.linalg.norm(place_m - transmitters_m, axis=-1)
    return np.asarray(out + np.linalg.norm(place_m - receivers_m, axis=-1))


@nan_without_warnings
def solved(start_m: Floats, seen: Sightings) -> Solved:
    """Places nearest to what was measured, from starts (h, 3)."""
    place_m = start_m.copy()
    for _ in range(STEPS):
        jacobian, residual = linearised(place_m, seen)
        q, r = _orthogonal(jacobian)
        step_m = _upper_solved(r, np.einsum("hri,hr->hi", q, residual))
        length_m = np.linalg.norm(step_m, axis=-1, keepdims=True)
        place_m += np.nan_to_num(step_m * np.minimum(1.0, LONGEST_STEP_M / (length_m + 1e-9)))
    jacobian, residual = linearised(place_m, seen)
    return Solved(place_m, covariance(jacobian), (residual**2).sum(axis=1))


@nan_without_warnings
def covariance(jacobian: Floats) -> Floats:
    """(J'J)^-1 of scaled rows, by QR; (h, rows, 3) in, (h, 3, 3) out."""
    _, r = _orthogonal(jacobian)
    inverse = np.stack([_upper_solved(r, np.broadcast_to(e, (len(r), 3))) for e in np.eye(3)], -1)
    return np.asarray(inverse @ np.swapaxes(inverse, -1, -2))


@nan_without_warnings
def linearised(place_m: Floats, seen: Sightings) -> tuple[Floats, Floats]:
    """Jacobians and residuals over their standard deviations; (h, rows, 3) and (h, rows)."""
    from_rx = place_m[:, None] - seen.receivers_m
    from_tx = place_m[:, None] - seen.transmitters_m
    range_m = np.linalg.norm(from_rx, axis=-1)
    other_m = np.linalg.norm(from_tx, axis=-1)
    toward = from_rx / range_m[..., None]
    ground_m = np.hypot(from_rx[..., 0], from_rx[..., 1])
    azimuth = np.arctan2(from_rx[..., 0], from_rx[..., 1])
    elevation = np.arctan2(from_rx[..., 2], ground_m)
    right = np.stack([np.cos(azimuth), -np.sin(azimuth), np.zeros_like(azimuth)], axis=-1)
    above = np.stack(
        [
            -np.sin(azimuth) * np.sin(elevation),
            -np.cos(azimuth) * np.sin(elevation),
            np.cos(elevation),
        ],
        axis=-1,
    )
    h = len(place_m)
    up = np.broadcast_to([0.0, 0.0, 1.0], (h, 1, 3))
    parts = [
        (toward + from_tx / other_m[..., None], seen.sum_m - range_m - other_m, seen.sigma_sum_m),
        (
            right / ground_m[..., None],
            np.radians(wrap_180(seen.azimuth_deg - np.degrees(azimuth))),
            np.radians(seen.sigma_azimuth_deg),
        ),
        (
            above / range_m[..., None],
            np.radians(seen.elevation_deg - np.degrees(elevation)),
            np.radians(seen.sigma_elevation_deg),
        ),
        (up, seen.height_m - place_m[:, 2:], np.full((h, 1), seen.sigma_height_m)),
    ]
    known = [np.where(np.isnan(part[1]), LOST, part[2]) for part in parts]
    jacobian = np.concatenate(
        [part[0] / sigma[..., None] for part, sigma in zip(parts, known, strict=True)], axis=1
    )
    residual = np.concatenate(
        [np.nan_to_num(part[1]) / sigma for part, sigma in zip(parts, known, strict=True)], axis=1
    )
    return jacobian, residual


def _orthogonal(jacobian: Floats) -> tuple[Floats, Floats]:
    """Q and R of (h, rows, 3), by Gram and Schmidt in their modified form: many at once."""
    q, r = jacobian.copy(), np.zeros((len(jacobian), 3, 3))
    for i in range(3):
        r[:, i, i] = np.sqrt(np.einsum("hr,hr->h", q[:, :, i], q[:, :, i]))
        q[:, :, i] /= r[:, i, i, None]
        for j in range(i + 1, 3):
            r[:, i, j] = np.einsum("hr,hr->h", q[:, :, i], q[:, :, j])
            q[:, :, j] -= r[:, i, j, None] * q[:, :, i]
    return q, r


def _upper_solved(r: Floats, b: Floats) -> Floats:
    """Solutions of upper triangular equations; (h, 3, 3) and (h, 3) in, NaN where there is none."""
    x = np.empty(b.shape)
    x[:, 2] = b[:, 2] / r[:, 2, 2]
    x[:, 1] = (b[:, 1] - r[:, 1, 2] * x[:, 2]) / r[:, 1, 1]
    x[:, 0] = (b[:, 0] - r[:, 0, 1] * x[:, 1] - r[:, 0, 2] * x[:, 2]) / r[:, 0, 0]
    return x
