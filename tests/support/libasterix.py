"""libasterix as an independent reader, in the environment of its own where there is one."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

ENVIRONMENT = "PLOTFEED_LIBASTERIX"
"""Says which Python has it, instead of that of `.venv-libasterix`."""
OWN = Path(__file__).parents[2] / ".venv-libasterix" / "bin" / "python"

# The newest edition of each category. A record is read strictly, and made of its items again.
_PROGRAM = """
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
    """The data blocks that lie back to back; skips the test where there is no libasterix."""
    python = Path(os.environ.get(ENVIRONMENT, OWN))
    if not python.exists():
        pytest.skip(f"no libasterix: neither {ENVIRONMENT} nor {OWN} is there")
    done = subprocess.run(
        [python, "-I", "-c", _PROGRAM],
        input=octets.hex(),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return [
        TheirBlock(category, bytes.fromhex(made), records)
        for category, made, records in json.loads(done.stdout)
    ]
