"""The page of places where plain forms fail is what its script writes, on any machine."""

from __future__ import annotations

import math
import re
from functools import cache
from typing import Any

import pytest
from support.doc_commands import DOCS, doc_command

# Which cells of a row hold figures, and by how much another machine's last digits may be others:
# the plain form's error, or that of an extreme, is hardly anything else than that.
SLACK = {3: 100.0, 5: 100.0}
SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def script() -> dict[str, Any]:
    return doc_command("write_stability")


@cache
def both() -> tuple[list[list[str]], list[list[str]]]:
    return cells((DOCS / "stability.md").read_text()), cells(script()["page"]())


def cells(page: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.split("|")] for line in page.splitlines()]


def figure_of(words: str) -> float | None:
    """The number that the script wrote, without its unit; None where it wrote none."""
    first = words.removeprefix("under ").partition(" ")[0].removesuffix("°")
    power = re.fullmatch(r"(?:(\d)·)?10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", first)
    if power is not None:
        return float(power[1] or 1) * 10.0 ** int(power[2].translate(SUPERSCRIPTS))
    return float(first) if re.fullmatch(r"[\d.]+", first) else None


def test_words_and_rows_are_those_that_the_script_writes() -> None:
    stored, written = both()
    assert [without_figures(row) for row in stored] == [without_figures(row) for row in written], (
        "run python docs/commands/write_stability.py"
    )


def without_figures(row: list[str]) -> list[str]:
    return [
        "a figure" if k in SLACK and figure_of(cell) is not None and " looks" not in cell else cell
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
    for where, form in script()["FORMS"].items():
        plain, ours = form()
        assert ours < plain / 1000 or math.isnan(plain), where


def test_every_row_names_a_test_that_is_there() -> None:
    links = re.findall(
        r"\| \[(\w+)\]\(\.\./(tests/[\w/]+\.py)\) \|", (DOCS / "stability.md").read_text()
    )
    assert len(links) > 40
    for name, path in links:
        text = (DOCS.parent / path).read_text() if (DOCS.parent / path).exists() else ""
        assert f"def {name}(" in text, f"{path}::{name}"


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
