"""Independent readers: asterix-decoder, which bad input may crash, and tshark."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from support.tools import ROOT, needed, skip

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


# Says which Python has it, instead of that of `.venv-asterix-decoder`.
ENVIRONMENT = "PLOTFEED_ASTERIX_DECODER"
OWN = ROOT / ".venv-asterix-decoder" / "bin" / "python"


def asterix_decoder() -> Path:
    """The Python that has it, without libasterix, which imports by the same name; may skip."""
    python = Path(os.environ.get(ENVIRONMENT, OWN))
    if not python.exists():
        skip("asterix-decoder", "c++")
    return python


def tshark_fields(path: Path, *fields: str) -> list[list[str]]:
    """The fields of each packet, those that occur more than once joined by commas."""
    wanted = [word for field in fields for word in ("-e", field)]
    checks = [word for kind in ("udp", "ip") for word in ("-o", f"{kind}.check_checksum:TRUE")]
    done = subprocess.run(
        [needed("tshark"), "-n", "-r", str(path), *checks, "-T", "fields", *wanted],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    return [line.split("\t") for line in done.stdout.splitlines()]
