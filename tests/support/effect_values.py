"""Reference values of effects, by the name of the quantity."""

from __future__ import annotations

import re

from support.given_files import reference_rows


def values_of(name: str) -> list[tuple[dict[str, str], float]]:
    """Arguments and the value of each row of that name; one at least."""
    found = [
        (dict(re.findall(r"(\w+)=([^;]+)", row["args"])), float(row["value"]))
        for row in reference_rows("effects.csv")
        if row["name"] == name
    ]
    assert found, f"no reference value of {name}"
    return found
