"""Every fault of the list still has its place; whether tests notice it, `make mutations` says."""

from __future__ import annotations

import ast

import pytest
from mutations.plant_faults import ROOT, Fault, faults, place, planted


@pytest.mark.parametrize("fault", faults(), ids=lambda fault: f"{fault.where}: {fault.what}")
def test_a_fault_can_be_planted(fault: Fault) -> None:
    text = (ROOT / place(fault)[0]).read_text()
    wrong = planted(fault, text)
    assert wrong != text
    ast.parse(wrong)
    for word in fault.tests.split():
        if not word.startswith("-") and "/" in word:
            assert (ROOT / word.partition("::")[0]).exists()


def test_there_are_many_in_all_rooms() -> None:
    files = [place(fault)[0] for fault in faults()]
    assert len(files) >= 55
    assert {file.partition("/")[0] for file in files} == {"feeds", "models", "proto", "replay"}
