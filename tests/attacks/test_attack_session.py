"""Garbage at every door at once, beside a session: what it says is what it would have said."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz.targets import LIVE
from support.chaos import DOORS, OVER_TCP, WAYS, beside

SECONDS = 1.5  # tools/soak/chaos.py has ten, for each door alone


@pytest.mark.parametrize("ways", [WAYS[:3], WAYS[3:]], ids=" ".join)
@pytest.mark.asyncio
async def test_whoever_misbehaves_at_all_doors_changes_no_octet(
    ways: tuple[str, ...], tmp_path: Path
) -> None:
    found = await beside(DOORS, ways, SECONDS, tmp_path)
    assert (found.differing, found.sectors > 5, found.refused > 0) == (0, True, True)


def test_every_kind_of_live_source_is_a_door() -> None:
    assert {door.partition(" ")[0] for door in DOORS if " " in door} == LIVE.keys()
    assert {*OVER_TCP} == LIVE.keys() - {"remote-id"}
