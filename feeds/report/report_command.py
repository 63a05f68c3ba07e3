"""`plotfeed report`: a recorded ledger as a table, as JSON and as a chart."""

from __future__ import annotations

import json
from pathlib import Path

import click

from plotfeed.feeds.report.figures import as_values, report
from plotfeed.feeds.report.ledger_reading import read
from plotfeed.feeds.report.report_pictures import check_picture, draw
from plotfeed.feeds.report.report_text import lines

DAMAGED = 2


def print_report(path: Path, *, as_json: bool, chart: Path | None) -> int:
    """Print what the ledger in a file says, and draw it if there is a place to; the exit code.

    That is 2 if the file is damaged: what is whole of it counts. Raises `PlotfeedError` and
    `OSError`.
    """
    if chart is not None:
        check_picture(chart)  # before anything is read in vain
    told = report(path, read(path))
    if chart is not None:
        draw(told, chart)
    if as_json:
        click.echo(json.dumps(as_values(told)))
    else:
        for line in lines(told):
            click.echo(line)
    for each in told.damage:
        click.echo(f"plotfeed: {path}: {each}", err=True)
    return DAMAGED if told.damage else 0
