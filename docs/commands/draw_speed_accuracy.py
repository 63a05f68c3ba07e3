"""Charts scene section-4: the pictures of docs/speed-accuracy.md, and its table between two marks.

python docs/commands/draw_speed_accuracy.py
"""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pages import between, table

from plotfeed.feeds.console.process import keep_freed
from plotfeed.feeds.lab.chart import charted
from plotfeed.feeds.lab.chart_command import as_values, draw_chart, verdict
from plotfeed.feeds.lab.charted import Effort, errors_text, ns_text, share_text
from plotfeed.feeds.scene.scene import example

DOCS = Path(__file__).parents[1]
PAGE, PICTURES = DOCS / "speed-accuracy.md", DOCS / "speed-accuracy"
TARGETS = 1000
Values = dict[str, Any]


def tables(chart: Values) -> str:
    """Tables of every sensor, and the sentence about each."""
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
    rows = []
    for stage in sensor["stages"]:
        for i, method in enumerate(stage["methods"]):
            name = f"**{method['method']}**" if method["ours"] else method["method"]
            ns = method["ns"]
            rows.append(
                (
                    "" if i else stage["stage"],
                    f"{name}{' *' if method['on_front'] else ''}",
                    ns_text(ns["median"]),
                    f"({ns_text(ns['low'])} to {ns_text(ns['high'])})",
                    errors_text(method["errors"]),
                    share_text(method["share"]),
                )
            )
    return table(("stage", "method", ">ns", "", "error added", ">of its own"), rows)


def main() -> None:
    """Measure once, draw, and write."""
    keep_freed()
    chart = charted(example("section-4"), Effort.usual(TARGETS))
    draw_chart(chart, PICTURES, "png")
    between(PAGE, "charted", tables(as_values(chart)))


if __name__ == "__main__":
    main()
