"""A score as one HTML file, with its charts in it and nothing that is loaded from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

from plotfeed.feeds.console.printed import printable
from plotfeed.feeds.score.score_figures import Score
from plotfeed.feeds.score.score_pictures import charts
from plotfeed.feeds.score.score_profiles import LimitVerdict
from plotfeed.feeds.score.score_text import (
    Shown,
    closing,
    notes_of,
    set_table,
    tables_of,
    verdict_table,
)
from plotfeed.proto.utc import NS, iso_utc

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 72em; padding: 0 1em;
  color: #1e293b; background: #fff; }
h1 { font-size: 1.5em; } h2 { font-size: 1.1em; margin: 2em 0 .4em; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .15em .8em .15em 0; text-align: right; border-bottom: 1px solid #e2e8f0; }
.l { text-align: left; white-space: pre-wrap; }
.verdict { font-size: 1.15em; font-weight: 600; padding: .5em .8em; background: #f1f5f9;
  border-left: 6px solid #64748b; }
.verdict.kept { border-color: #15803d; } .verdict.broken { border-color: #be123c; }
svg { max-width: 100%; height: auto; } .wide { overflow-x: auto; }
"""


def html_of(score: Score, profile: str, note: str, verdicts: Sequence[LimitVerdict]) -> str:
    """The page; needs matplotlib."""
    return "".join(_pieces(score, profile, note, verdicts))


def _pieces(
    score: Score, profile: str, note: str, verdicts: Sequence[LimitVerdict]
) -> Iterator[str]:
    title = escape(printable(f"Score: {score.scene or score.source}"))
    yield '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<title>{title}</title><style>{STYLE}</style></head><body>\n<h1>{title}</h1>\n"
    lasted_s = (score.end_utc_ns - score.start_utc_ns) / NS
    yield f"<p>{escape(printable(score.source))}: {len(score.drones)} drones, "
    yield f"{score.tracks} tracks, {lasted_s:.1f} s from {iso_utc(score.start_utc_ns)}. "
    yield f"Distances {score.distances}; beyond {score.settings.cutoff_m:g} m a track is of no "
    yield f"drone, older than {score.settings.stale_s:g} s it is not there.</p>\n"
    yield f'<p class="verdict{_mark(score, verdicts)}">{escape(closing(score, verdicts))}</p>\n'
    notes = [escape(printable(each)) for each in notes_of(score)]
    if notes:
        yield "<ul>" + "".join(f"<li>{each}</li>" for each in notes) + "</ul>\n"
    if verdicts:
        yield _table(verdict_table(profile, verdicts))
        yield f"<p>{escape(printable(note))}</p>\n" if note else ""
    yield _table(set_table(score))
    for name, svg in charts(score).items():
        yield f"<h2>{escape(name)}</h2>\n{svg}\n"
    for shown in tables_of(score):
        yield _table(shown)
    yield "</body></html>\n"


def _mark(score: Score, verdicts: Sequence[LimitVerdict]) -> str:
    if score.failure or any(each.status == "failed" for each in verdicts):
        return " broken"
    return " kept" if verdicts else ""


def _table(shown: Shown) -> str:
    title, header, rows, sides = shown
    marks = ["" if side == ">" else ' class="l"' for side in sides]

    def line(cells: Sequence[str], tag: str) -> str:
        each = (f"<{tag}{m}>{escape(c)}</{tag}>" for c, m in zip(cells, marks, strict=False))
        return "<tr>" + "".join(each) + "</tr>\n"

    head = line(header, "th") if any(header) else ""
    body = "".join(line(row, "td") for row in rows)
    return f'<h2>{escape(title)}</h2>\n<div class="wide"><table>\n{head}{body}</table></div>\n'
