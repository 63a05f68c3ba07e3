"""Files beside the project that some tests compare with: reference values, recordings, flights."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

SHARED = Path(__file__).resolve().parents[2].parent / "shared"


def shared(name: str) -> Path:
    """The path of a shared file; skips the test where there is none."""
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"needs ../shared/{name}, which is not here")
    return path


def reference(name: str) -> dict[str, NDArray[np.float64]]:
    """The numeric columns of a table of reference values, by name; text columns are left out."""
    header, *rows = csv.reader(shared(f"reference/{name}").read_text().splitlines())
    columns = {}
    for column, cells in zip(header, zip(*rows, strict=True), strict=True):
        try:
            columns[column] = np.array(cells, dtype=np.float64)
        except ValueError:
            continue
    return columns
