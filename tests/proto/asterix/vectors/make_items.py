"""Makes items.json: records of every item of every category, and what libasterix reads in them.

Run it as make_vectors.py says. For each category there is a record of everything and then some of
items, subfields and values drawn at random. Beside its octets stand the values of each item from
left to right, scaled by libasterix.
"""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from asterix import base
from asterix.generated import (
    Cat_015_1_2,
    Cat_016_1_0,
    Cat_025_1_6,
    Cat_034_1_29,
    Cat_048_1_32,
    Cat_062_1_21,
    Cat_063_1_7,
    Cat_205_1_0,
)

CATEGORIES = {
    15: Cat_015_1_2,
    16: Cat_016_1_0,
    25: Cat_025_1_6,
    34: Cat_034_1_29,
    48: Cat_048_1_32,
    62: Cat_062_1_21,
    63: Cat_063_1_7,
    205: Cat_205_1_0,
}
VECTORS = Path(__file__).with_name("items.json")
RECORDS = 12
MOST = 3  # Members of a repetitive item


class Draw:
    """Octets at random for a specification of libasterix: everything, or some of it."""

    def __init__(self, seed: int, *, everything: bool) -> None:
        self._random = random.Random(seed)  # noqa: S311 - not for secrets
        self._everything = everything

    def _take(self) -> bool:
        return self._everything or self._random.random() < 0.4

    def bits(self, size: int) -> str:
        """A number, as often as not at one of its limits."""
        edges = [0, (1 << size) - 1, 1 << size - 1, (1 << size - 1) - 1]
        number = self._random.choice([*edges, *(self._random.getrandbits(size) for _ in edges)])
        return f"{number:0{size}b}"

    def variation(self, spec: Any) -> str:
        """The bits of a variation."""
        if issubclass(spec, base.Element):
            return self.bits(spec.cv_bit_size)
        if issubclass(spec, base.Group):
            return "".join(self.item(item) for item, _ in spec.cv_items_list)
        if issubclass(spec, base.Extended):
            return self._extended(spec)
        if issubclass(spec, base.Repetitive):
            return self._repetitive(spec)
        if issubclass(spec, base.Explicit):
            octets = self._random.randint(0, 4)
            return f"{octets + 1:08b}" + "".join(self.bits(8) for _ in range(octets))
        return self.compound(spec.cv_items_list)

    def item(self, item: Any) -> str:
        """The bits of a part: spare ones are zero."""
        if issubclass(item, base.Spare):
            return "0" * item.cv_bit_size
        return self.variation(item.cv_non_spare.cv_rule.cv_variation)

    def _extended(self, spec: Any) -> str:
        groups = len(spec.cv_items_list)
        last = groups if self._everything else self._random.randint(1, groups)
        text = ""
        for index, group in enumerate(spec.cv_items_list[:last], 1):
            for part in group:
                text += str(int(index < last)) if part is None else self.item(part[0])
        return text

    def _repetitive(self, spec: Any) -> str:
        counted = spec.cv_rep_bytes is not None
        times = self._random.randint(not counted, MOST)
        members = [self.variation(spec.cv_variation) for _ in range(times)]
        if counted:
            return f"{times:0{spec.cv_rep_bytes * 8}b}" + "".join(members)
        return "".join(f"{m}{int(i < times)}" for i, m in enumerate(members, 1))

    def compound(self, specs: list[Any]) -> str:
        """Flags, and what they announce."""
        taken = [spec is not None and self._take() for spec in specs]
        if not any(taken):
            taken[self._random.choice([i for i, spec in enumerate(specs) if spec])] = True
        octets = max(i for i, there in enumerate(taken) if there) // 7 + 1
        flags = "".join(
            "".join(str(int(there)) for there in taken[at * 7 : at * 7 + 7]).ljust(7, "0")
            + str(int(at < octets - 1))
            for at in range(octets)
        )
        members = [
            spec.cv_rule.cv_variation for spec, there in zip(specs, taken, strict=True) if there
        ]
        return flags + "".join(self.variation(member) for member in members)


def values(variation: Any) -> Iterator[Any]:
    """The values of a variation from left to right, without spare bits and extension bits."""
    if isinstance(variation, base.Element):
        yield value(variation)
    elif isinstance(variation, base.Group):
        yield from parts(variation.arg)
    elif isinstance(variation, base.Extended):
        for group in variation.arg:
            yield from parts(group)
    elif isinstance(variation, base.Repetitive):
        for member in variation.arg:
            yield from values(member)
    elif isinstance(variation, base.Explicit):
        yield variation.get_bytes().hex()
    else:
        for name in variation.cv_items_dict:
            if (sub := variation._get_item(name)) is not None:
                yield from values(sub.arg.arg)


def parts(items: list[Any]) -> Iterator[Any]:
    """The values of parts."""
    for item in items:
        if isinstance(item, base.Item):
            yield from values(item.arg.arg.arg)


def value(element: Any) -> Any:
    """The value of an element."""
    rule = element.cv_rule
    if not issubclass(rule, base.RuleContentContextFree):
        return element.as_uint()
    content = rule.cv_content(element.bs)
    if isinstance(content, base.ContentQuantity):
        return content._as_quantity()
    if isinstance(content, base.ContentInteger):
        return content.as_integer()
    if isinstance(content, base.ContentString):
        return content.as_string()
    return element.as_uint()


def vector(number: int, seed: int) -> dict[str, Any]:
    """One record."""
    category = CATEGORIES[number]
    uap = [
        item.cv_non_spare if issubclass(item, base.UapItem) else None
        for item in category.cv_record.cv_items_list
    ]
    bits = Draw(seed, everything=not seed).compound(uap)
    octets = int(bits, 2).to_bytes(len(bits) // 8, "big")
    parsed = category.cv_record.parse(base.ParsingMode.StrictParsing, base.Bits.from_bytes(octets))
    if isinstance(parsed, ValueError):
        raise parsed
    record, rest = parsed
    if len(rest):
        raise ValueError(f"{len(rest)} bits of {octets.hex()} are left")
    block = bytes([number]) + (3 + len(octets)).to_bytes(2, "big") + octets
    items = {
        f"I{number:03}/{spec.cv_name}": list(values(record.get_item(spec.cv_name).arg.arg))
        for spec in uap
        if spec and record.get_item(spec.cv_name) is not None
    }
    return {"block": block.hex(), "items": items}


def main() -> None:
    """Writes the vectors."""
    lines = [json.dumps(vector(number, seed)) for number in CATEGORIES for seed in range(RECORDS)]
    VECTORS.write_text("[\n" + ",\n".join(lines) + "\n]\n")


if __name__ == "__main__":
    main()
