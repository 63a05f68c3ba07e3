"""asterix-decoder as an independent reader, in a process of its own: bad input may crash it."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from typing import Any

import pytest

# Its errors are silent: a record that it cannot read is one without items.
_PROGRAM = """
import json, sys, asterix
print(json.dumps([asterix.parse(bytes.fromhex(b), verbose=False) for b in json.load(sys.stdin)]))
"""

_SECONDS = 120

PER_HOUR = 3600
IN_KNOTS = ("CGS", "SigmaV")
IN_HEXADECIMAL = ("ACAddr", "ADR")


def read_blocks(blocks: Iterable[bytes]) -> list[list[dict[str, Any]]]:
    """The records of each of the blocks, as asterix-decoder's dicts. Skips if it is missing."""
    _require()
    done = subprocess.run(
        [sys.executable, "-I", "-c", _PROGRAM],
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


def _require() -> None:
    # libasterix imports by the same name; only asterix-decoder has this extension module.
    if importlib.util.find_spec("_asterix") is None:
        reason = "asterix-decoder is not installed (it needs a C++ compiler: make test says so)"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
