"""Numbers, links and tables as text."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

from plotfeed.replay.times import NS

MAX_DELAYS_SHOWN = 5
NOTHING = "-"
Row = Sequence[str]


def link_text(link: object) -> str:
    """A link's keys in a line, as the scene has them."""
    if not isinstance(link, Mapping):
        return str(link)[:200]
    return ", ".join(f"{key} = {_value(value)}" for key, value in link.items()) or "none"


def _value(value: object) -> str:
    if isinstance(value, list) and len(value) > MAX_DELAYS_SHOWN:
        return f"[{len(value)} of them]"
    if isinstance(value, Mapping):
        return f"{{ {link_text(value)} }}"
    return json.dumps(value)


def percent(share: float) -> str:
    """Of a share from 0 to 1, without its sign."""
    return number(100 * share, ".2f")


def seconds(t_ns: int) -> str:
    """To the tenth."""
    return f"{t_ns / NS:.1f}"


def number(value: float, form: str) -> str:
    """In that form; what is not there is a dash."""
    return format(value, form) if math.isfinite(value) else NOTHING


def table(
    title: str,
    header: Row,
    rows: Sequence[Row],
    sides: str,
    groups: Mapping[int, str] = MappingProxyType({}),
) -> Iterator[str]:
    """Columns aligned to the left or to the right, as `sides` says of each.

    `groups` has the text that stands over a column and those after it.
    """
    yield ""
    yield title
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    if groups:
        yield _over(groups, widths)
    for row in (header, *rows):
        cells = (f"{cell:{side}{n}}" for cell, side, n in zip(row, sides, widths, strict=True))
        yield f"  {'  '.join(cells)}".rstrip()


def _over(groups: Mapping[int, str], widths: Sequence[int]) -> str:
    """A line of texts, each from the left edge of its column on."""
    line = ""
    for column, text in groups.items():
        at = 2 + sum(widths[:column]) + 2 * column
        line = f"{line:{at}}{text}"
    return line
