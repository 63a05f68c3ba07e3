"""Every fault of the list still has its place; whether tests notice it, `make mutations` says."""

from __future__ import annotations

import pytest
from mutations.plant_faults import ROOT, Fault, faults, planted


@pytest.mark.parametrize("fault", faults(), ids=lambda fault: f"{fault.file}: {fault.what}")
def test_a_fault_can_be_planted(fault: Fault) -> None:
    text = (ROOT / fault.file).read_text()
    assert planted(fault, text) != text
    for word in fault.tests.split():
        if not word.startswith("-") and "/" in word:
            assert (ROOT / word.partition("::")[0]).exists()


def test_there_are_many_in_all_rooms() -> None:
    files = [fault.file for fault in faults()]
    assert len(files) >= 55
    assert {file.partition("/")[0] for file in files} == {"feeds", "models", "proto", "replay"}
