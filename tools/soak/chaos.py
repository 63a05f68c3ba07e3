"""Each door of a session, misused in each way for ten seconds: the table of docs/soak.md.

python tools/soak/chaos.py [--seconds S]    # a quarter of an hour; fails where octets differ
"""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path

sys.path.extend(
    str(Path(__file__).parents[2] / room) for room in ("tools", "tests", "docs/commands")
)

from pages import between, table
from support.chaos import DOORS, WAYS, beside

NOBODY = "nobody"
PAGE = Path(__file__).parents[2] / "docs" / "soak.md"


def main() -> None:
    """Do all of it, and write the table."""
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--seconds", type=float, default=10.0, help="of each door and way")
    asked = options.parse_args()
    rows, worst_s, sectors, differing = [], 0.0, 0, 0
    for door in DOORS:
        cells = [door]
        for way in (NOBODY, *WAYS):
            doors = [door] * (way != NOBODY)
            with tempfile.TemporaryDirectory() as folder:
                found = asyncio.run(beside(doors, [way], asked.seconds, Path(folder)))
            cells.append(f"{found.refused:,}; {found.lateness_p99_ms:.1f}")
            worst_s = max(worst_s, found.end_s)
            sectors, differing = sectors + found.sectors, differing + found.differing
        rows.append(cells)
        print(*cells, sep=" | ", flush=True)
    lines = [
        *table(("door", *(f">{way}" for way in (NOBODY, *WAYS))), rows),
        "",
        "Refused, and the 99th percentile of how late messages left, ms: "
        f"{asked.seconds:g} s of each. Of {sectors:,}",
        f"sectors, messages that differ from those of the engine alone: {differing}. When told to,",
        f"sessions ended within {worst_s:.1f} s. Tried on {datetime.now(UTC):%Y-%m-%d}, load "
        f"average {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores.",
    ]
    between(PAGE, "chaos", "\n".join(lines))
    sys.exit(differing > 0)


if __name__ == "__main__":
    main()
