"""Independent readers of ASTERIX, asterix-decoder and libasterix: bad input may crash them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

# Its errors are silent: a record that it cannot read is one without items.
_DECODER = """
import json, sys, asterix
print(json.dumps([asterix.parse(bytes.fromhex(b), verbose=False) for b in json.load(sys.stdin)]))
"""

_SECONDS = 120

PER_HOUR = 3600
IN_KNOTS = ("CGS", "SigmaV")
IN_HEXADECIMAL = ("ACAddr", "ADR")


def read_blocks(blocks: Iterable[bytes]) -> list[list[dict[str, Any]]]:
    """The records of each of the blocks, as asterix-decoder's dicts. Skips if it is missing."""
    done = subprocess.run(
        [asterix_decoder(), "-I", "-c", _DECODER],
        input=json.dumps([block.hex() for block in blocks]),
        capture_output=True,
        text=True,
        timeout=_SECONDS,
        check=True,
    )
    records: list[list[dict[str, Any]]] = json.loads(done.stdout)
    return records


def items_of(record: dict[str, Any]) -> dict[str, Any]:
    """The items of one of its records by our names, such as "I048/040"."""
    category = f"I{record['category']:03}"
    return {
        f"{category}/{name[1:]}": value for name, value in record.items() if name.startswith("I")
    }


def values_of(item: Any) -> list[Any]:
    """The values of an item from left to right, in our units, without spare bits and FX."""
    return list(_values(item))


def _values(item: Any) -> Iterator[Any]:
    if isinstance(item, list):
        for member in item:
            yield from _values(member)
        return
    for name, value in item.items():
        if "val" not in value:
            yield from _values(value)
        elif name in IN_KNOTS:
            yield value["val"] / PER_HOUR
        elif name in IN_HEXADECIMAL:
            yield int(value["val"], 16)
        elif name not in ("FX", "fx") and not name.startswith("spare"):
            yield value["val"]


ENVIRONMENT = "PLOTFEED_ASTERIX_DECODER"
"""Says which Python has it, instead of that of `.venv-asterix-decoder`."""
OWN = Path(__file__).parents[2] / ".venv-asterix-decoder" / "bin" / "python"


def asterix_decoder() -> Path:
    """The Python that has it, without libasterix, which imports by the same name; may skip."""
    python = Path(os.environ.get(ENVIRONMENT, OWN))
    if not python.exists():
        pytest.skip("asterix-decoder is not installed: it needs a C++ compiler")
    return python


# The newest edition of each category. A record is read strictly, and made of its items again.
_LIBASTERIX = """
import json, sys
from asterix.base import Bits, RawDatablock
from asterix.generated import manifest

def block(raw):
    category = raw.get_category()
    edition = max(manifest["CATS"][category], key=lambda each: each.cv_edition)
    records = edition.cv_uap.parse(raw.get_raw_records())
    if isinstance(records, ValueError):
        raise records
    items = [
        {name: r.get_item(name) for name in r.cv_items_dict if r.get_item(name) is not None}
        for r in records
    ]
    again = edition.create([type(r).create(each) for r, each in zip(records, items)])
    texts = [{name: i.unparse().to_bytes().hex() for name, i in each.items()} for each in items]
    return category, again.unparse().to_bytes().hex(), texts

def blocks(octets):
    raws = RawDatablock.parse(Bits.from_bytes(octets))
    if isinstance(raws, ValueError):
        raise raws
    return [block(raw) for raw in raws]

print(json.dumps(blocks(bytes.fromhex(sys.stdin.read()))))
"""


class TheirBlock(NamedTuple):
    """A data block as libasterix reads it."""

    category: int
    octets: bytes
    """That it makes of the items that it has read."""
    records: list[dict[str, str]]
    """Items by their number, in hexadecimal."""


def blocks_of(octets: bytes) -> list[TheirBlock]:
    """The data blocks that lie back to back."""
    done = subprocess.run(
        [sys.executable, "-I", "-c", _LIBASTERIX],
        input=octets.hex(),
        capture_output=True,
        text=True,
        timeout=_SECONDS,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return [
        TheirBlock(category, bytes.fromhex(made), records)
        for category, made, records in json.loads(done.stdout)
    ]
