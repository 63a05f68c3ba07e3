"""Report profiles: a fixed choice of items, so that every record has one length and one FSPEC."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from plotfeed.proto.asterix.codec.layout import (
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

MAX_REPETITIONS = 255  # the octet that counts them holds no more


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
    What is repetitive is followed by how often: "I016/410*2" has the slots of "I016/410/0" and
    "I016/410/1".
    """
    chosen = dict(map(_split, paths))
    drawing = _Drawing(chosen)
    places = [
        place
        for place, item in enumerate(category.uap)
        if item and any(is_at(path, item.name) for path in chosen)
    ]
    drawing.flags(places)
    for place in places:
        item = category.uap[place]
        if item is not None:
            drawing.item(item)
    if unknown := chosen.keys() - drawing.used:
        raise EncodeError(f"category {category.number} has no such item", field=min(unknown))
    return drawing.profile()


def _split(path: str) -> tuple[str, int | None]:
    """A path and how often what it names is repeated; None if it does not say."""
    name, star, times = path.partition("*")
    if not star:
        return path, None
    if not times.isdecimal() or not 0 <= int(times) <= MAX_REPETITIONS:
        raise EncodeError(f"repeated not 0 to {MAX_REPETITIONS} times", field=path)
    return name, int(times)


@dataclass(slots=True)
class _Drawing:
    """A record as it is put together from left to right."""

    chosen: Mapping[str, int | None]
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

    def group(self, prefix: str, group: Group, *, more: bool = False, named: bool = False) -> None:
        """A group; its only part needs no name unless `named`. `more` is its extension bit."""
        self.append(group.octets, int(more))
        end = self.octets * 8
        for part, right in group.fields:
            path = f"{prefix}/{part.name}" if named or len(group.fields) > 1 else prefix
            self.slots.append((path, part, end - right))

    def item(self, item: Item, path: str = "") -> None:
        """An item, or a subfield at `path`."""
        path = path or item.name
        self.used.add(path)
        match item:
            case Fixed(_, group):
                self.group(path, group)
            case Extended(_, groups):
                self.extended(path, groups)
            case Repetitive(_, group):
                self.repetitive(path, group)
            case Compound():
                self.compound(item)
            case _:
                raise EncodeError("an item of no fixed length fits no profile", field=path)

    def extended(self, path: str, groups: Sequence[Group]) -> None:
        last = 0
        for index, group in enumerate(groups):
            paths = {f"{path}/{part.name}" for part, _ in group.fields}
            if found := paths & self.chosen.keys():
                self.used |= found
                last = index
        for index, group in enumerate(groups[: last + 1]):
            self.group(path, group, more=index < last, named=True)

    def repetitive(self, path: str, group: Group) -> None:
        times = self.chosen.get(path)
        if times is None or (group.fx and not times):
            raise EncodeError("say how often it is repeated, such as *1", field=path)
        if not group.fx:
            self.append(1, times)
        for index in range(times):
            self.group(f"{path}/{index}", group, more=group.fx and index < times - 1)

    def compound(self, item: Compound) -> None:
        subfields = {
            place: sub
            for place, sub in enumerate(item.subfields)
            if sub and any(is_at(path, f"{item.name}/{sub.name}") for path in self.chosen)
        }
        if not subfields:
            asked = min(path for path in self.chosen if is_at(path, item.name))
            raise EncodeError("name a subfield that it has", field=asked)
        self.flags(list(subfields))
        for sub in subfields.values():
            self.item(sub, f"{item.name}/{sub.name}")


def is_at(path: str, name: str) -> bool:
    """Whether a path is that of `name` or of something in it."""
    return path == name or path.startswith(f"{name}/")
