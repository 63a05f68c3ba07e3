from __future__ import annotations

import inspect
from importlib import import_module

import pytest
from support.asterix_table import table

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.layout import Category, Group, Raw, Spare, category


@pytest.mark.parametrize("layout", CATEGORIES.values(), ids=lambda layout: f"{layout.number:03d}")
def test_a_layout_writes_the_table_from_which_it_was_read(layout: Category) -> None:
    """With the octets of every item, which the table states beside its parts."""
    # A radar's two categories are one file, and those of tracks.
    place = {34: 48, 63: 62}.get(layout.number, layout.number)
    module = import_module(f"plotfeed.proto.asterix.cat{place:03d}")
    assert table(layout) in inspect.getsource(module)


def test_a_row_stands_in_for_that_of_another_edition() -> None:
    first = category(1, "1 I001/010 1 A 8\n2 I001/020 1 B 8")
    second = category(1, "2 I001/020 1 B ±8: 1/4 m", base=first)
    assert second.uap[0] == first.uap[0]
    assert table(second).splitlines()[2].split() == ["2", "I001/020", "1", "B", "±8:", "1/4", "m"]


@pytest.mark.parametrize("parts", ["A 8 9", "A ±8: 1 m often", "A 8;B 8", ""])
def test_what_is_not_in_the_notation_is_refused(parts: str) -> None:
    with pytest.raises(ValueError, match="no part"):
        category(1, f"1    I001/010  1       {parts}.")


@pytest.mark.parametrize("row", ["I001/020 1 B 8", "2 I001/020 B", "2 I001 1 B 8"])
def test_a_row_that_is_none_is_refused(row: str) -> None:
    with pytest.raises(ValueError, match="no row"):
        category(1, f"1 I001/010 1 A 8\n{row}")


def test_parts_must_fill_octets() -> None:
    with pytest.raises(ValueError, match="9 bits"):
        Group((Raw("A", 8), Spare(1)))


def test_a_part_knows_its_place() -> None:
    group = Group((Spare(2), Raw("A", 3), Raw("B", 2)), fx=True)
    assert [(part.name, right) for part, right in group.fields] == [("A", 3), ("B", 1)]
