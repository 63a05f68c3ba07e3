"""How large the project is, beside the ceilings of budget.toml.

    python tests/support/budget.py [--lower]

With --lower each ceiling comes down to what there is; none goes up.
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUDGET = ROOT / "budget.toml"
PACKAGES = ("models", "proto", "replay", "feeds", "face", "tests", "tools")
GENERATED = "_pb2"


def budget() -> dict[str, int]:
    """The ceilings, each by its table and name, such as lines.models."""
    tables = tomllib.loads(BUDGET.read_text())
    return {f"{table}.{name}": n for table, row in tables.items() for name, n in row.items()}


def measured() -> dict[str, int]:
    """What there is of each."""
    sys.path.insert(0, str(ROOT / "tools"))
    from digests.public_surface import counts, surface

    found = {
        f"lines.{name}": _lines(
            path for path in (ROOT / name).rglob("*.py") if not path.stem.endswith(GENERATED)
        )
        for name in PACKAGES
    }
    found["lines.page"] = _lines((ROOT / "feeds/page/static").iterdir())
    of_surface = counts(surface())
    found |= {f"surface.{kind}s": of_surface[kind] for kind in ("option", "key")}
    pages = (ROOT / "docs").rglob("*.md")
    return found | {"words.docs": sum(len(path.read_text().split()) for path in pages)}


def _lines(paths: Iterable[Path]) -> int:
    """Lines that are not blank."""
    return sum(bool(line.strip()) for path in paths for line in path.read_text().splitlines())


def main() -> None:
    ceilings, found = budget(), measured()
    for name, n in found.items():
        print(f"{name:16} {n:8,} of {ceilings[name]:8,}")
    if sys.argv[1:] == ["--lower"]:
        text = BUDGET.read_text()
        for name, n in found.items():
            key = name.partition(".")[2]
            least = f"{min(n, ceilings[name]):_}"
            text = re.sub(rf"^{key} = [\d_]+ *", f"{key} = {least}".ljust(17), text, flags=re.M)
        BUDGET.write_text(text)


if __name__ == "__main__":
    main()
