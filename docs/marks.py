"""Text that commands write into pages, between two marks."""

from __future__ import annotations

from pathlib import Path


def between(page: Path, mark: str, text: str) -> None:
    """Put a text between the two marks of that name on a page."""
    begin, end = f"<!-- {mark}: begin -->", f"<!-- {mark}: end -->"
    before, found, rest = page.read_text().partition(begin)
    _, found_too, after = rest.partition(end)
    if not (found and found_too):
        raise SystemExit(f"{page}: no marks {begin} and {end}")
    page.write_text(f"{before}{begin}\n\n{text}\n\n{end}{after}")
