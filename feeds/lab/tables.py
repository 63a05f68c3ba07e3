"""Tables: rows with units, written as text, HTML, CSV or Parquet."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from html import escape
from operator import attrgetter, itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.printed import Row, aligned, naming, printable, widths
from plotfeed.feeds.lab.lab_settings import PARQUET
from plotfeed.replay.plots_csv import as_text

NOTHING = "-"


def number(value: Any, form: str) -> str:
    """A number, or text, in that form, % for shares; what is not there is a dash."""
    if isinstance(value, str):
        return printable(value)
    value, form = (100 * value, ".2f") if form == "%" else (value, form)
    return format(value, form) if math.isfinite(value) else NOTHING


class TextColumn(NamedTuple):
    """A column: its heading, what of a row stands in it, and the form of that."""

    head: str
    of: str | Callable[[Any], Any]  # An attribute of the row, or what makes a value of it
    form: str = ""  # Of numbers, which stand to the right; % for shares, and none for text

    def cell(self, row: Any) -> str:
        """What stands in the column."""
        value = attrgetter(self.of)(row) if isinstance(self.of, str) else self.of(row)
        if not self.form:
            return printable(str(value))
        return number(value, self.form)


def of_cells(heads: Sequence[str], sides: str) -> list[TextColumn]:
    """Columns of rows that are text already, each on its side."""
    return [
        TextColumn(head, itemgetter(i), "s" if side == ">" else "")
        for i, (head, side) in enumerate(zip(heads, sides, strict=True))
    ]


class Table(NamedTuple):
    """Rows of anything, by columns; `groups` has texts over a column and those after it."""

    title: str
    columns: Sequence[TextColumn]
    rows: Sequence[Any]
    groups: Mapping[int, str] = MappingProxyType({})

    @property
    def header(self) -> Row:
        """The headings."""
        return [column.head for column in self.columns]

    @property
    def sides(self) -> str:
        """The side of each column."""
        return "".join(">" if column.form else "<" for column in self.columns)

    def cells(self) -> list[Row]:
        """Rows of text."""
        return [[column.cell(row) for column in self.columns] for row in self.rows]

    def lines(self, most: int | None = None) -> Iterator[str]:
        """Aligned lines, with so many rows at most."""
        yield ""
        yield self.title
        rows = [self.header, *self.cells()[:most]]
        over, wide = "", widths(rows)
        for column, text in self.groups.items():
            over = f"{over:{2 + sum(wide[:column]) + 2 * column}}{text}"
        if over:
            yield over
        for line in aligned(rows, self.sides):
            yield f"  {line}".rstrip()
        if most is not None and len(self.rows) > most:
            yield f"  and {len(self.rows) - most} more; --json has all"

    def html(self) -> str:
        """An element of HTML, with its title before it."""
        marks = ["" if side == ">" else ' class="l"' for side in self.sides]

        def line(cells: Sequence[str], tag: str) -> str:
            each = (f"<{tag}{m}>{escape(c)}</{tag}>" for c, m in zip(cells, marks, strict=True))
            return "<tr>" + "".join(each) + "</tr>\n"

        head = line(self.header, "th") if any(self.header) else ""
        body = "".join(line(row, "td") for row in self.cells())
        table = f'<div class="wide"><table>\n{head}{body}</table></div>\n'
        return f"<h2>{escape(self.title)}</h2>\n{table}"


def check_suffix(path: Path) -> None:
    """Raise `PlotfeedError` if no such table can be written here."""
    if path.suffix == PARQUET:
        need_extra("pyarrow", "Parquet", "parquet")


def write_table(path: Path, kinds: Mapping[str, type], rows: Sequence[Sequence[Any]]) -> None:
    """Write a table, whole or not at all, by what its columns hold, None in empty cells.

    Raises `PlotfeedError` and `OSError`.
    """
    check_suffix(path)
    if path.suffix == PARQUET:
        import pyarrow as pa
        import pyarrow.parquet as pq

        types = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}
        schema = pa.schema([(name, types[kind]) for name, kind in kinds.items()])
        named = [dict(zip(kinds, row, strict=True)) for row in rows]
        file = io.BytesIO()
        pq.write_table(pa.Table.from_pylist(named, schema), file, compression="zstd")
        octets = file.getvalue()
    else:
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(kinds)
        writer.writerows([as_text(c) if isinstance(c, str) else c for c in row] for row in rows)
        octets = text.getvalue().encode()
    part = path.with_name(f".{path.name}.part")
    with naming(str(path)):
        part.write_bytes(octets)
        part.replace(path)
