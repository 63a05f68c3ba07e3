"""Report profiles: a fixed choice of items, so that every record has one length and one FSPEC."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from plotfeed.proto.asterix.layout import (
    Category,
    Compound,
    Extended,
    Fixed,
    Group,
    Item,
    Named,
    Repetitive,
)
from plotfeed.proto.errors import EncodeError


@dataclass(frozen=True, slots=True)
class Slot:
    """Where a named part lies: its path, and the bits of the record to its right."""

    path: str
    part: Named
    right: int


@dataclass(frozen=True, slots=True)
class Profile:
    """Records of `octets` octets; `template` is one of them as an integer, with every slot zero."""

    octets: int
    template: int
    slots: tuple[Slot, ...]


def profile(category: Category, paths: Iterable[str]) -> Profile:
    """The profile with those items.

    A path is an item ("I048/040"), a subfield of a compound ("I048/130/PRL") or a part of an
    extended item, which takes the item up to and including that part's group ("I048/020/ME").
    """
    chosen = set(paths)
    drawing = _Drawing(chosen)
    places = [
        place
        for place, item in enumerate(category.uap)
        if item and any(p == item.name or p.startswith(f"{item.name}/") for p in chosen)
    ]
    drawing.flags(places)
    for place in places:
        item = category.uap[place]
        if item is not None:
            drawing.item(item)
    if unknown := chosen - drawing.used:
        raise EncodeError(f"category {category.number} has no such item", field=min(unknown))
    return drawing.profile()


@dataclass(slots=True)
class _Drawing:
    """A record as it is put together from left to right."""

    chosen: set[str]
    used: set[str] = field(default_factory=set)
    octets: int = 0
    bits: int = 0
    slots: list[tuple[str, Named, int]] = field(default_factory=list)
    """Path, part, and where the part ends, in bits from the start."""

    def profile(self) -> Profile:
        end = self.octets * 8
        slots = tuple(Slot(path, part, end - stop) for path, part, stop in self.slots)
        return Profile(self.octets, self.bits, slots)

    def append(self, octets: int, bits: int) -> None:
        self.octets += octets
        self.bits = self.bits << octets * 8 | bits

    def flags(self, places: Sequence[int]) -> None:
        """The octets of seven flags and FX that announce those places, counted from 0."""
        last = max(places, default=0) // 7
        for octet in range(last + 1):
            bits = sum(1 << 7 - place % 7 for place in places if place // 7 == octet)
            self.append(1, bits | (octet < last))

    def group(self, prefix: str, group: Group, *, more: bool = False) -> None:
        self.append(group.octets, int(more))
        end = self.octets * 8
        for part, right in group.fields:
            path = prefix if len(group.fields) == 1 and not group.fx else f"{prefix}/{part.name}"
            self.slots.append((path, part, end - right))

    def item(self, item: Item) -> None:
        self.used.add(item.name)
        match item:
            case Fixed(name, group):
                self.group(name, group)
            case Extended():
                self.extended(item)
            case Compound():
                self.compound(item)
            case _:
                raise EncodeError("an item of no fixed length fits no profile", field=item.name)

    def extended(self, item: Extended) -> None:
        last = 0
        for index, group in enumerate(item.groups):
            paths = {f"{item.name}/{part.name}" for part, _ in group.fields}
            if found := paths & self.chosen:
                self.used |= found
                last = index
        for index, group in enumerate(item.groups[: last + 1]):
            self.group(item.name, group, more=index < last)

    def compound(self, item: Compound) -> None:
        subfields = {
            place: sub
            for place, sub in enumerate(item.subfields)
            if sub and f"{item.name}/{sub.name}" in self.chosen
        }
        if not subfields:
            asked = min(path for path in self.chosen if path.startswith(item.name))
            raise EncodeError("name a subfield that it has", field=asked)
        self.flags(list(subfields))
        for sub in subfields.values():
            path = f"{item.name}/{sub.name}"
            self.used.add(path)
            if isinstance(sub, Repetitive):
                raise EncodeError("a subfield of no fixed length fits no profile", field=path)
            self.group(path, sub.group)
