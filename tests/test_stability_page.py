"""The page of places where plain forms fail is what its script writes, on any machine."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import pytest
from support.doc_commands import DOCS, doc_command

PLAIN, OURS = 3, 5  # Which cells of a row hold figures
# Another machine's last digits may be others: the plain form's error is hardly anything else.
SLACK = {PLAIN: 10.0, OURS: 100.0}


def script() -> dict[str, Any]:
    return doc_command("write_stability")


@cache
def both() -> tuple[list[list[str]], list[list[str]]]:
    return cells((DOCS / "stability.md").read_text()), cells(script()["page"]())


def cells(page: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.split("|")] for line in page.splitlines()]


def figure_of(words: str) -> float | None:
    found = script()["in_words"].__globals__["figure_of"](words)
    return None if found is None else float(found)


def test_words_and_rows_are_those_that_the_script_writes() -> None:
    stored, written = both()
    assert [without_figures(row) for row in stored] == [without_figures(row) for row in written], (
        "run python docs/commands/write_stability.py"
    )


def without_figures(row: list[str]) -> list[str]:
    return [
        "a figure" if k in SLACK and figure_of(cell) is not None else cell
        for k, cell in enumerate(row)
    ]


def test_figures_are_of_the_order_that_the_page_says() -> None:
    stored, written = both()
    for old, new in zip(stored, written, strict=True):
        for k, slack in SLACK.items():
            before, now = (figure_of(row[k]) if len(row) > k else None for row in (old, new))
            if before and now:
                assert 1 / slack <= now / before <= slack, f"{old[1]}: {new[k]}, was {old[k]}"


def test_ours_is_better_than_the_plain_form_in_every_row() -> None:
    for _, cases in script()["cases"]():
        for case in cases:
            if isinstance(case.plain, float) and isinstance(case.ours, float):
                better = case.ours < case.plain / 1000 or math.isnan(case.plain)
                assert better, case.where


@pytest.mark.parametrize(
    ("error", "unit", "words"),
    [
        (3.4e-6, "", "3·10⁻⁶"),
        (1e-6, "", "10⁻⁶"),
        (0.0, "", "under 10⁻¹⁴"),
        (2e-9, "m", "under 10⁻⁸ m"),
        (0.0, "m", "0 m"),
        (4.0e7, "m", "4·10⁷ m"),
        (1.0, "°", "1°"),
        (17.2, "", "20"),
        (float("nan"), "s", "no number"),
    ],
)
def test_a_figure_is_written_to_one_digit_and_read_again(
    error: float, unit: str, words: str
) -> None:
    assert script()["in_words"](error, unit) == words
    if not math.isnan(error) and not words.startswith("under"):
        assert figure_of(words) == pytest.approx(error, rel=0.5)
