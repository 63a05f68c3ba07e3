"""Kalman's filter of targets that fly straight on, of many at once, in three dimensions.

A state is position and velocity, (n, 6), metres and m/s along three fixed axes, with its covariance
(n, 6, 6). Acceleration is white noise of a density q, m2/s3: Bar-Shalom, Li and Kirubarajan,
Estimation with Applications to Tracking and Navigation, section 6.2.2.
"""

from __future__ import annotations

import numpy as np

from plotfeed.models.state import Floats

AXES = 3


def predicted(
    states: Floats, covariances: Floats, after_s: Floats, density_m2_s3: float | Floats
) -> tuple[Floats, Floats]:
    """States and covariances after times (n,), which may be negative; of one density, or (n, 1)."""
    n = len(states)
    moved = states.copy()
    moved[:, :AXES] += after_s[:, None] * states[:, AXES:]
    transition = np.zeros((n, 6, 6))
    transition[:] = np.eye(6)
    noise = np.zeros((n, 6, 6))
    axes = np.arange(AXES)
    transition[:, axes, axes + AXES] = after_s[:, None]
    lasting_s = np.abs(after_s)
    noise[:, axes, axes] = density_m2_s3 * lasting_s[:, None] ** 3 / 3
    across = density_m2_s3 * (after_s * lasting_s)[:, None] / 2
    noise[:, axes, axes + AXES] = noise[:, axes + AXES, axes] = across
    noise[:, axes + AXES, axes + AXES] = density_m2_s3 * lasting_s[:, None]
    spread = transition @ covariances @ transition.transpose(0, 2, 1) + noise
    return moved, spread


def distances2(
    states: Floats, covariances: Floats, measured_m: Floats, errors_m2: Floats
) -> Floats:
    """Squared statistical distances of measured positions (n, 3), of errors (n, 3, 3); (n,)."""
    residuals = measured_m - states[:, :AXES]
    spread = covariances[:, :AXES, :AXES] + errors_m2
    solved = np.linalg.solve(spread, residuals[:, :, None])[:, :, 0]
    found: Floats = (residuals * solved).sum(axis=1)
    return found


def updated(
    states: Floats, covariances: Floats, measured_m: Floats, errors_m2: Floats
) -> tuple[Floats, Floats]:
    """States and covariances with a measured position each, (n, 3), of errors (n, 3, 3).

    By Joseph's form, which keeps covariances symmetric and positive.
    """
    residuals = measured_m - states[:, :AXES]
    spread = covariances[:, :AXES, :AXES] + errors_m2
    gain = np.linalg.solve(spread, covariances[:, :AXES, :]).transpose(0, 2, 1)
    better = states + (gain @ residuals[:, :, None])[:, :, 0]
    kept = np.broadcast_to(np.eye(6), covariances.shape).copy()
    kept[:, :, :AXES] -= gain
    narrowed = kept @ covariances @ kept.transpose(0, 2, 1)
    narrowed += gain @ errors_m2 @ gain.transpose(0, 2, 1)
    return better, narrowed
