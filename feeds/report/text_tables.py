"""Tables of text, and how numbers stand in them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

from plotfeed.feeds.console.printed import Row, aligned, widths
from plotfeed.proto.utc import NS

NOTHING = "-"


def percent(share: float) -> str:
    """A share from 0 to 1 in percent, without the sign."""
    return number(100 * share, ".2f")


def seconds(t_ns: int) -> str:
    """Seconds to the tenth."""
    return f"{t_ns / NS:.1f}"


def number(value: float, form: str) -> str:
    """A number in that form; what is not there is a dash."""
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
    rows = [header, *rows]
    if groups:
        over, wide = "", widths(rows)
        for column, text in groups.items():
            over = f"{over:{2 + sum(wide[:column]) + 2 * column}}{text}"
        yield over
    for line in aligned(rows, sides):
        yield f"  {line}".rstrip()
