"""Text that commands write into pages: tables, and what stands between two marks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path


def between(page: Path, mark: str, text: str) -> None:
    """Put a text between the two marks of that name on a page."""
    begin, end = f"<!-- {mark}: begin -->", f"<!-- {mark}: end -->"
    before, found, rest = page.read_text().partition(begin)
    _, found_too, after = rest.partition(end)
    if not (found and found_too):
        raise SystemExit(f"{page}: no marks {begin} and {end}")
    page.write_text(f"{before}{begin}\n\n{text}\n\n{end}{after}")


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """Lines of a table; columns whose heads begin with ">" are flush right."""
    marks = ["--:" if name.startswith(">") else "---" for name in head]
    names = [name.removeprefix(">") for name in head]
    cells = [names, *([str(cell) for cell in row] for row in rows)]
    lines = [f"| {' | '.join(row)} |" for row in cells]
    return [lines[0], f"|{'|'.join(marks)}|", *lines[1:]]
