"""Charts for people, by matplotlib: plotfeed[charts]."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.proto.errors import PlotfeedError


def draw_predictions(curves: dict[str, Any], path: Path) -> None:
    """Pd, and rms errors of range and azimuth, against range; PNG, SVG or PDF by the name."""
    figure, axes = _subplots(3)
    for name, (ranges_m, predicted) in curves.items():
        ranges_km = ranges_m / 1000
        axes[0].plot(ranges_km, predicted.pd, label=name)
        for axis, sigma in zip(
            axes[1:], (predicted.sigma_range_m, predicted.sigma_azimuth_deg), strict=True
        ):
            if np.isfinite(sigma).any():
                axis.semilogy(ranges_km, sigma, label=name)
    for axis, title in zip(
        axes,
        ("probability of detection", "rms range error, m", "rms azimuth error, degrees"),
        strict=True,
    ):
        axis.set_title(title)
        axis.set_xlabel("range, km")
        axis.grid(visible=True, alpha=0.3)
        axis.legend()
    try:
        figure.savefig(path, dpi=120)
    except ValueError as error:
        raise PlotfeedError(f"{path}: {error}") from None


def _subplots(count: int) -> tuple[Any, Any]:
    try:
        from matplotlib.figure import Figure  # noqa: PLC0415 - an extra
    except ImportError:
        raise PlotfeedError("charts need matplotlib: pip install 'plotfeed[charts]'") from None
    figure = Figure(figsize=(5 * count, 4.2), layout="constrained")
    return figure, figure.subplots(1, count)
