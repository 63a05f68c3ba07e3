"""Layouts of every category that libasterix knows, made from its tables, and its names of items.

Our own layouts (`categories`) are those that plotfeed writes, and are there without it. libasterix
is an extra and takes the better part of a second to import: whoever asks first imports it.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from plotfeed.proto.asterix.codec.decode import BROKEN, FURTHER, reader_of
from plotfeed.proto.asterix.codec.layout import (
    ASCII,
    CALLSIGN,
    DAY_LSB,
    OCTAL,
    Category,
    Characters,
    Compound,
    Explicit,
    Extended,
    Fixed,
    Group,
    Item,
    Named,
    Part,
    Quantity,
    Raw,
    Repetitive,
    Spare,
    Undecoded,
)
from plotfeed.proto.asterix.other_categories import OTHER_CATEGORIES

_ALPHABETS = {"StringAscii": ASCII, "StringICAO": CALLSIGN, "StringOctal": OCTAL}
Subfield = Fixed | Extended | Repetitive | None
TIME_BITS, TIME_LSB_S = 24, 1 / 128


@dataclass(frozen=True, slots=True)
class Meaning:
    """What an item or a part of one is called, its unit, and what its integers say."""

    title: str
    unit: str = ""
    words: Mapping[int, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Standard:
    """A category as its newest edition that libasterix knows has it."""

    category: Category
    edition: str
    meanings: Mapping[str, Meaning]  # By paths such as I048/040/RHO
    # What the flags in the first octet of the RE field stand for; none if that is not known.
    expansion: tuple[Item | None, ...]

    def read_expansion(self, octets: bytes) -> dict[str, Any] | None:
        """The parts of an RE field behind its length; None if it is not as this edition has it."""
        found: dict[str, Any] = {}
        at = 1
        try:
            for place in range(8):
                if octets[0] >> 7 - place & 1:
                    item = self.expansion[place]
                    if item is None:
                        return None
                    found[item.name], at = reader_of(item)(octets, at)
        except BROKEN:
            return None
        if at < len(octets):
            found[FURTHER] = octets[at:]
        return found if at <= len(octets) else None


class StandardCategories(Mapping[int, Category]):
    """Layouts of ours, and of libasterix for every other category.

    Where that is not installed, they are those of `other_categories`, which cut alone.
    """

    def __init__(self, ours: Mapping[int, Category]) -> None:
        self._ours = ours

    def __getitem__(self, number: int) -> Category:
        found = self._ours.get(number)
        if found is None:
            theirs = standard(number)
            return OTHER_CATEGORIES[number] if theirs is None else theirs.category
        return found

    def __iter__(self) -> Iterator[int]:
        return iter(self._ours)

    def __len__(self) -> int:
        return len(self._ours)


@cache
def tables() -> tuple[Any, Any] | None:
    """Modules `generated` and `base` of libasterix; None if it is not installed."""
    try:
        return importlib.import_module("asterix.generated"), importlib.import_module("asterix.base")
    except ImportError:  # or asterix-decoder is, which has the same name
        return None


@cache
def standard(number: int) -> Standard | None:
    """A category; None if libasterix is not installed or does not know it."""
    found = tables()
    if found is None or number not in found[0].manifest["CATS"]:
        return None
    generated, base = found
    newest = max(generated.manifest["CATS"][number], key=lambda each: each.cv_edition)
    maker = _Maker(number, base)
    profile = newest.cv_uap
    if issubclass(profile, base.UapMultiple):
        profiles = [maker.slots(each) for each in profile.cv_uaps.values()]
        selector = profile.cv_selector[0] if profile.cv_selector else None
        if selector != ["020", "TYP"]:  # plots and tracks of 001
            return None
        category = Category(number, *profiles)
    else:
        category = Category(number, maker.slots(profile.cv_record))
    references = generated.manifest["REFS"].get(number)
    expansion: tuple[Item | None, ...] = (None,) * 8
    if references:
        theirs = max(references, key=lambda each: each.cv_edition).cv_expansion
        if theirs.cv_type == (base.FspecFixed, 1):
            given = [None if each is None else maker.inside(each) for each in theirs.cv_items_list]
            expansion = (*given, *[None] * (8 - len(given)))
    edition = ".".join(map(str, newest.cv_edition))
    return Standard(category, edition, maker.meanings, expansion)


class _Maker:
    """Makes the items of one category, and notes what they mean."""

    def __init__(self, number: int, base: Any) -> None:
        self._prefix = f"I{number:03d}/"
        self._base = base
        self.meanings: dict[str, Meaning] = {}

    def slots(self, record: Any) -> tuple[Item | None, ...]:
        """The items of a profile by their field reference numbers."""
        named = self._base.UapItem
        return tuple(
            self._item(each.cv_non_spare, "") if issubclass(each, named) else None
            for each in record.cv_items_list
        )

    def inside(self, of: Any) -> Item:
        """An item of the RE field."""
        return self._item(of, f"{self._prefix}RE/")

    def _item(self, of: Any, within: str) -> Item:
        path = f"{within or self._prefix}{of.cv_name}"
        name = of.cv_name if within else path
        base, variation = self._base, self._variation(of, path)
        if issubclass(variation, base.Explicit):
            return Explicit(name)
        if issubclass(variation, base.Compound):
            return Compound(name, tuple(self._subfields(variation.cv_items_list, path)))
        if issubclass(variation, base.Repetitive):
            group = self._group(variation.cv_variation, of, path, fx=not variation.cv_rep_bytes)
            return Repetitive(name, group)
        if issubclass(variation, base.Extended):
            inside = ([each[0] for each in listed if each] for listed in variation.cv_items_list)
            groups = (Group(tuple(self._parts(items, path)), fx=True) for items in inside)
            return Extended(name, tuple(groups))
        return Fixed(name, self._group(variation, of, path))

    def _subfields(self, listed: list[Any], path: str) -> Iterator[Subfield]:
        for each in listed:
            found = None if each is None else self._item(each, f"{path}/")
            if isinstance(found, Compound | Explicit | Undecoded):
                raise NotImplementedError(f"{path} has compound parts, which no edition has had")
            yield found

    def _variation(self, of: Any, path: str) -> Any:
        rule = of.cv_rule
        self.meanings[path] = Meaning(of.cv_title)
        if issubclass(rule, self._base.RuleVariationDependent):
            return rule.cv_default_variation
        return rule.cv_variation

    def _group(self, variation: Any, of: Any, path: str, *, fx: bool = False) -> Group:
        if issubclass(variation, self._base.Element):
            return Group((self._element(variation, of.cv_name, of.cv_title, path),), fx=fx)
        return Group(tuple(self._parts([each for each, _ in variation.cv_items_list], path)), fx=fx)

    def _parts(self, items: list[Any], path: str, outer: str = "") -> Iterator[Part]:
        for each in items:
            if issubclass(each, self._base.Spare):
                yield Spare(each.cv_bit_size)
                continue
            of = each.cv_non_spare
            name = outer + of.cv_name
            variation = self._variation(of, f"{path}/{name}")
            if issubclass(variation, self._base.Element):
                yield self._element(variation, name, of.cv_title, f"{path}/{name}")
            else:  # a group within: its parts, with its name before theirs
                inner = [each for each, _ in variation.cv_items_list]
                yield from self._parts(inner, path, f"{name}.")

    def _element(self, variation: Any, name: str, title: str, path: str) -> Named:
        rule, bits = variation.cv_rule, variation.cv_bit_size
        content = getattr(rule, "cv_content", None)  # else it depends on another part: an integer
        if content is None:
            return Raw(name, bits)
        kind = content.__mro__[1].__name__
        if kind == "ContentTable":
            self.meanings[path] = Meaning(title, words=content.cv_values)
        elif kind == "ContentString":
            alphabet = _ALPHABETS[content.cv_string_type.__name__]
            each = len(alphabet).bit_length() - 1
            if bits % each == 0:
                return Characters(name, bits // each, alphabet)
        elif kind in ("ContentQuantity", "ContentInteger"):
            signed = content.cv_signedness.__name__ == "Signed"
            if kind == "ContentInteger" and not signed:
                return Raw(name, bits)
            unit, lsb = getattr(content, "cv_unit", ""), getattr(content, "cv_lsb", 1.0)
            self.meanings[path] = Meaning(title, unit)
            is_time = (bits, lsb, signed) == (TIME_BITS, TIME_LSB_S, False) and "Time" in title
            return Quantity(name, bits, lsb, unit, signed, modulus=DAY_LSB if is_time else 0)
        return Raw(name, bits)
