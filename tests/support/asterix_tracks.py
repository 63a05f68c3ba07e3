"""Tracks for the tests of category 062."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from plotfeed.proto.asterix.encode_062 import Tracks


def tracks(**columns: Any) -> Tracks:
    """Tracks with those columns, not estimated or false in the others; as long as the longest."""
    n = max(np.size(column) for column in columns.values())
    flags = dict.fromkeys(("tentative", "coasted", "first", "last"), False)
    filled = dict.fromkeys((f.name for f in fields(Tracks)), np.nan)
    zeros = dict.fromkeys(
        ("latitude_deg", "longitude_deg", "east_m", "north_m"), 0.0
    ) | dict.fromkeys(("velocity_east_m_s", "velocity_north_m_s"), 0.0)
    given = filled | flags | zeros | {"track": 1, "t_utc_ns": 0} | columns
    return Tracks(**{name: np.broadcast_to(np.asarray(v), (n,)) for name, v in given.items()})
