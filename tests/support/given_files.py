"""Files that tests compare with: those of tests/golden, and more from a folder of one's own.

That folder is named by the environment variable PLOTFEED_TEST_INPUT; what is in it is tested as
well, and adds to what tests/golden has.
"""

from __future__ import annotations

import csv
import os
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

VARIABLE = "PLOTFEED_TEST_INPUT"
GOLDEN = Path(__file__).parents[1] / "golden"


def places(name: str) -> list[Path]:
    """Where a file of that name is: of ours, of the folder, or of both. Raises if it is nowhere."""
    folders = [GOLDEN]
    if given := os.environ.get(VARIABLE):
        folders.append(Path(given))
    found = [folder / name for folder in folders if (folder / name).exists()]
    if not found:
        raise FileNotFoundError(f"{name} is in none of {', '.join(map(str, folders))}")
    return found


def more_input() -> bool:
    """Whether there is a folder of more; raises if it is named but is not there."""
    given = os.environ.get(VARIABLE)
    if given and not Path(given).is_dir():
        raise NotADirectoryError(f"{VARIABLE} is {given}, which is no folder")
    return bool(given)


def reference_rows(name: str) -> list[dict[str, str]]:
    """The rows of a table of reference values, in the columns that all tables of that name have."""
    texts = [path.read_text() for path in places(f"reference/{name}")]
    tables = [list(csv.DictReader(text.splitlines())) for text in texts]
    common = [column for column in tables[0][0] if all(column in table[0] for table in tables)]
    return [{column: row[column] for column in common} for table in tables for row in table]


def reference(name: str) -> dict[str, NDArray[np.float64]]:
    """The numeric columns of those rows, by name; text columns are left out."""
    rows = reference_rows(name)
    columns = {}
    for column in rows[0]:
        try:
            columns[column] = np.array([row[column] for row in rows], dtype=np.float64)
        except ValueError:
            continue
    return columns


def values_of(name: str) -> list[tuple[dict[str, str], float]]:
    """Arguments and the value of each row of that name; one at least."""
    found = [
        (dict(re.findall(r"(\w+)=([^;]+)", row["args"])), float(row["value"]))
        for row in reference_rows("effects.csv")
        if row["name"] == name
    ]
    assert found, f"no reference value of {name}"
    return found
