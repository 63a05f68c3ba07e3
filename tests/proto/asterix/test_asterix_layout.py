from __future__ import annotations

import re
from types import ModuleType

import pytest
from support.asterix_table import rows

from plotfeed.proto.asterix import (
    cat015,
    cat016,
    cat025,
    cat034,
    cat048,
    cat062,
    cat063,
    cat129,
    cat205,
)
from plotfeed.proto.asterix.codec.layout import Category, Extended, Fixed, Group, Raw, Spare

ROW = re.compile(r"^(\d+) +(I\d{3}/\w+) +(\d+)(\S*)", re.MULTILINE)


@pytest.mark.parametrize(("module", "category"), [(cat048, cat048.CAT048), (cat034, cat034.CAT034)])
def test_the_table_in_the_docstring_is_the_layout(module: ModuleType, category: Category) -> None:
    rows = ROW.findall(module.__doc__ or "")
    assert [(int(frn), name) for frn, name, _, _ in rows] == [
        (frn, item.name) for frn, item in enumerate(category.uap, 1) if item
    ]
    lengths = {name: (int(octets), more) for _, name, octets, more in rows}
    for item in category.uap:
        if isinstance(item, Fixed):
            assert lengths[item.name] == (item.group.octets, "")
        elif isinstance(item, Extended):
            assert lengths[item.name] == (item.groups[0].octets, "+FX")


@pytest.mark.parametrize(
    ("module", "category"),
    [
        (cat015, cat015.CAT015),
        (cat016, cat016.CAT016),
        (cat025, cat025.CAT025),
        (cat062, cat062.CAT062),
        (cat063, cat063.CAT063),
        (cat129, cat129.CAT129),
        (cat205, cat205.CAT205),
    ],
)
def test_the_table_in_the_docstring_has_every_part(module: ModuleType, category: Category) -> None:
    table = re.split(r"^[= ]+$", module.__doc__ or "", flags=re.MULTILINE)[2]
    assert table.split() == " ".join(" ".join(row) for row in rows(category)).split()


def test_parts_must_fill_octets() -> None:
    with pytest.raises(ValueError, match="9 bits"):
        Group((Raw("A", 8), Spare(1)))


def test_a_part_knows_its_place() -> None:
    group = Group((Spare(2), Raw("A", 3), Raw("B", 2)), fx=True)
    assert [(part.name, right) for part, right in group.fields] == [("A", 3), ("B", 1)]
