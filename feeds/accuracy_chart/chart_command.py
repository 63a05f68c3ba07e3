"""`plotfeed chart`: measures a scene, prints what came of it, and draws it."""

from __future__ import annotations

import json
from pathlib import Path

import click

from plotfeed.feeds.accuracy_chart.chart_pictures import draw, need_matplotlib
from plotfeed.feeds.accuracy_chart.chart_text import lines
from plotfeed.feeds.accuracy_chart.charted import as_values, charted
from plotfeed.feeds.accuracy_chart.stage import Effort
from plotfeed.feeds.console.signals import keep_freed
from plotfeed.feeds.scene.scene import Scene


def print_chart(
    scene: Scene,
    *,
    out: Path | None,
    picture: str,
    targets: int,
    quick: bool,
    as_json: bool,
) -> None:
    """Measure and print, as a table or as JSON; with `out`, a folder, draw too."""
    if out is not None:
        need_matplotlib()  # before anything is measured in vain
    keep_freed()  # as a session does
    chart = charted(scene, Effort.quick(targets) if quick else Effort.usual(targets))
    values = as_values(chart)
    drawn = draw(chart, out, picture) if out is not None else []
    if as_json:
        click.echo(json.dumps(values))
        return
    for line in lines(values):
        click.echo(line)
    for path in drawn:
        click.echo(f"drawn: {path}", err=True)
