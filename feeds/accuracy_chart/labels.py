"""Labels beside points of a figure, where they cover neither each other nor any point."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

STYLE = {"fontsize": 7.5, "linespacing": 1.2, "va": "bottom", "ha": "left"}
MARKER_PIXELS = 8.0
GAP_PIXELS = 10.0
REACHES = (1.0, 2.0, 3.5, 5.5, 8.0, 11.0, 15.0)
"""How far labels may move away, in gaps."""
Box = tuple[float, float, float, float]
"""Left, bottom, right, top; pixels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """What is written beside a point; data coordinates."""

    x: float
    y: float
    text: str
    color: str


def place_labels(axes: Any, labels: Sequence[Label], renderer: Any) -> None:
    """Write them, each where it first finds room, with a line to its point if that is not near."""
    points = [tuple(axes.transData.transform((label.x, label.y))) for label in labels]
    taken: list[Box] = [_around(x, y, MARKER_PIXELS, MARKER_PIXELS) for x, y in points]
    within = axes.get_window_extent(renderer)
    frame = (within.x0, within.y0, within.x1, within.y1)
    for label, (x, y) in zip(labels, points, strict=True):
        text = axes.annotate(label.text, (label.x, label.y), **STYLE)
        extent = text.get_window_extent(renderer)
        text.remove()
        best = min(
            _boxes(x, y, extent.width, extent.height),
            key=lambda found: _cost(found, frame, taken),
        )
        taken.append(best)
        _write(axes, label, (x, y), best)


def _write(axes: Any, label: Label, point: tuple[float, float], box: Box) -> None:
    """At the place found, in pixels from the point."""
    pixels_a_point = axes.figure.dpi / 72
    offset = ((box[0] - point[0]) / pixels_a_point, (box[1] - point[1]) / pixels_a_point)
    near_x = min(max(point[0], box[0]), box[2])
    near_y = min(max(point[1], box[1]), box[3])
    far = max(abs(near_x - point[0]), abs(near_y - point[1])) > 2.5 * GAP_PIXELS
    axes.annotate(
        label.text,
        (label.x, label.y),
        xytext=offset,
        textcoords="offset points",
        **STYLE,
        color=label.color,
        zorder=6,
        annotation_clip=False,
        arrowprops={"arrowstyle": "-", "lw": 0.5, "color": label.color, "alpha": 0.6, "shrinkA": 0}
        if far
        else None,
        bbox={"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 0.6},
    )


def _boxes(x: float, y: float, width: float, height: float) -> Iterator[Box]:
    """Places for a label, the better ones first: to the right, to the left, above, below."""
    for reach in REACHES:
        away = reach * GAP_PIXELS
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            middle_x = x + dx * (away + width / 2)
            middle_y = y + dy * (away + height / 2)
            yield _around(middle_x, middle_y, width / 2, height / 2)


def _cost(box: Box, frame: Box, taken: Sequence[Box]) -> float:
    """Area that is covered twice or lies outside."""
    inside = _overlap(box, frame)
    area = (box[2] - box[0]) * (box[3] - box[1])
    return (area - inside) + sum(_overlap(box, other) for other in taken)


def _overlap(a: Box, b: Box) -> float:
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    return max(width, 0.0) * max(height, 0.0)


def _around(x: float, y: float, half_width: float, half_height: float) -> Box:
    return x - half_width, y - half_height, x + half_width, y + half_height
