"""Recordings of a folder, for a page to choose from, and the names of new ones."""

from __future__ import annotations

import os
from datetime import datetime
from itertools import count
from pathlib import Path

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.mcap.contents import library_of

SUFFIX = ".mcap"
LIBRARY = "plotfeed "
"""What those of plotfeed say that they were written by, before its version."""
MAX_LISTED = 50
MAX_LOOKED_AT = 500
"""Files, the newest first, of which it is found out whose they are."""


def recordings_in(folder: Path) -> dict[str, Path]:
    """Files by name, the newest first, at most `MAX_LISTED`; none if the folder cannot be read."""
    found: dict[str, Path] = {}
    for path in _newest_first(folder)[:MAX_LOOKED_AT]:
        if len(found) < MAX_LISTED and _is_ours(path):
            found[path.name] = path
    return found


def new_path(folder: Path, scene: str, at: datetime) -> Path:
    """The name of a recording of that scene from then on, in UTC; numbered if there is one."""
    stem = f"{scene}-{at:%Y%m%dT%H%M%SZ}"
    names = (f"{stem}-{number}" if number > 1 else stem for number in count(1))
    return next(path for name in names if not (path := folder / f"{name}{SUFFIX}").exists())


def _newest_first(folder: Path) -> list[Path]:
    times: dict[Path, int] = {}
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.endswith(SUFFIX) and entry.name.isprintable() and entry.is_file():
                    times[Path(entry.path)] = entry.stat().st_mtime_ns
    except OSError:
        pass
    return sorted(times, key=lambda path: (-times[path], path.name))


def _is_ours(path: Path) -> bool:
    try:
        return library_of(path).startswith(LIBRARY)
    except (DecodeError, OSError):
        return False
