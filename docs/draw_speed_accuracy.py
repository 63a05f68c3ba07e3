"""Charts scene section-4: the pictures of docs/speed-accuracy.md, and its table between two marks.

python docs/draw_speed_accuracy.py
"""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from marks import between

from plotfeed.feeds.accuracy_chart.chart import charted
from plotfeed.feeds.accuracy_chart.chart_command import as_values, verdict
from plotfeed.feeds.accuracy_chart.chart_pictures import draw
from plotfeed.feeds.accuracy_chart.stage import Effort, errors_text, ns_text, share_text
from plotfeed.feeds.console.signals import keep_freed
from plotfeed.feeds.scene.scene import example

HERE = Path(__file__).parent
PAGE = HERE / "speed-accuracy.md"
PICTURES = HERE / "speed-accuracy"
TARGETS = 1000
Values = dict[str, Any]


def tables(chart: Values) -> str:
    """Of every sensor, and the sentence about each."""
    machine = chart["machine"]
    parts = [
        f"{machine['processor']}, {machine['cores']} cores, {machine['system']}, Python "
        f"{machine['python']}, numpy {machine['numpy']}, scipy {machine['scipy']}; "
        f"{datetime.now(UTC):%Y-%m-%d}, load average {os.getloadavg()[0]:.1f}. "
        f"{chart['targets']:,} targets at once; ns a target-scan, median (middle half) of "
        f"{chart['rounds']} turns."
    ]
    for sensor in chart["sensors"]:
        parts.append(f"**{sensor['id']}**, whose own error is {errors_text(sensor['own'])}:")
        parts.append("\n".join(_rows(sensor)))
    parts.extend(verdict(sensor) for sensor in chart["sensors"])
    return "\n\n".join(parts)


def _rows(sensor: Values) -> list[str]:
    rows = ["| stage | method | ns | | error added | of its own |", "|---|---|--:|---|---|--:|"]
    for stage in sensor["stages"]:
        for i, way in enumerate(stage["methods"]):
            name = f"**{way['method']}**" if way["ours"] else way["method"]
            ns = way["ns"]
            rows.append(
                f"| {'' if i else stage['stage']} | {name}{' *' if way['on_front'] else ''} "
                f"| {ns_text(ns['median'])} | ({ns_text(ns['low'])} to {ns_text(ns['high'])}) "
                f"| {errors_text(way['errors'])} | {share_text(way['share'])} |"
            )
    return rows


def main() -> None:
    """Measure once, draw, and write."""
    keep_freed()
    chart = charted(example("section-4"), Effort.usual(TARGETS))
    draw(chart, PICTURES, "png")
    between(PAGE, "charted", tables(as_values(chart)))


if __name__ == "__main__":
    main()
