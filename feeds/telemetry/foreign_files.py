"""Files from strangers: what is taken of each kind at most, and reading the heavy ones apart.

What others' libraries read, or XML, is read by another process (`foreign_readers`): without our
sockets and secrets, with limits of the system where it has them. It hands back texts and arrays.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, BinaryIO

from plotfeed.proto.errors import PlotfeedError


@dataclass(frozen=True, slots=True)
class FileLimits:
    """What is taken of a kind of file at most; a greater one is refused with the number.

    Both numbers are 0 where a file is read in pieces, and each of them is bounded.
    """

    octets: int
    count: int  # Of what it holds: samples, points, records or corners
    depth: int = 0  # Of what is in each other
    memory_mib: int = 0  # Of the process that reads it; 0 where that is ours
    seconds: int = 0  # That it may read


MIB = 1 << 20
FILE_LIMITS: Mapping[str, FileLimits] = {
    # 14 tiles of 1 arc second.
    "GeoTIFF": FileLimits(1024 * MIB, 200_000_000, memory_mib=4096, seconds=120),
    # A tile of 1/3 arc second, of which there are none larger.
    "SRTM tile": FileLimits(2 * 10_801**2, 10_801**2),
    "GeoJSON": FileLimits(128 * MIB, 4_000_000),
    "basemap": FileLimits(32 * MIB, 300_000, 8),
    "GPX or KML": FileLimits(64 * MIB, 4_000_000, 64, memory_mib=2048, seconds=60),
    "ULog": FileLimits(256 * MIB, 1000, 8, memory_mib=2048, seconds=60),
    "other flight": FileLimits(256 * MIB, 2_000_000),
    "recording": FileLimits(0, 0, memory_mib=2048, seconds=24 * 3600),
}
# Octets of content for each of a file's, and in any case: what grows more is made to use us up.
MOST_UNPACKED, SPARE_OCTETS = 256, 64 * MIB
# All that a process needs to know of ours: of tokens and passwords it is told none.
_ENVIRONMENT = (
    *("PATH", "PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "LD_LIBRARY_PATH", "SYSTEMROOT"),
    *("HOME", "USERPROFILE", "TMPDIR", "TEMP", "TMP", "LANG", "LC_ALL"),
)
_CONFINED = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",  # no file beside the one that is named
    "GDAL_PAM_ENABLED": "NO",
    "CPL_VSIL_CURL_ALLOWED_EXTENSIONS": ".none",
    "GDAL_HTTP_PROXY": "127.0.0.1:9",
    "PROJ_NETWORK": "OFF",
    "OPENBLAS_NUM_THREADS": "1",
}
_START = "from plotfeed.feeds.telemetry.foreign_readers import main; main()"


def process_apart(start: str, *arguments: str) -> dict[str, Any]:
    """Words and environment, as `subprocess` takes them, of a process that runs Python's `start`.

    It is to confine itself, and to write what it finds; what it complains of is thrown away.
    """
    environment = {name: os.environ[name] for name in _ENVIRONMENT if name in os.environ}
    return {
        "args": [sys.executable, "-P", "-c", start, *arguments],
        "stderr": subprocess.DEVNULL,
        "env": environment | _CONFINED,
        "start_new_session": True,  # Ctrl-C is for us: who reads for us ends with us
    }


def broken_or_beyond(kind: str) -> str:
    """Why a process that read that kind has ended without a word, in a line."""
    limits = FILE_LIMITS[kind]
    return (
        f"reading it takes more than {limits.memory_mib} MiB or {limits.seconds} s of a "
        "processor, or breaks it"
    )


def why_not(kind: str, what: str, error: Exception) -> str:
    """Why a process that reads that kind finds nothing, in a line, by what its reader raised."""
    if isinstance(error, PlotfeedError):
        return str(error)
    if isinstance(error, MemoryError):
        return f"reading it takes more than {FILE_LIMITS[kind].memory_mib} MiB"
    line = " ".join(str(error).split())[:200] or type(error).__name__
    return f"not a {what} that can be read: {line}"


def file_octets(path: Path, kind: str) -> bytes:
    """All octets of a file of that kind; raises `PlotfeedError`."""
    most = FILE_LIMITS[kind].octets
    try:
        with path.open("rb") as file:
            is_larger = path.stat().st_size > most
            data = b"" if is_larger else file.read(most + 1)
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else None
        raise PlotfeedError(f"cannot be read: {why or error}") from error
    if is_larger or len(data) > most:
        raise PlotfeedError(f"larger than {most} octets, the most that is read")
    return data


def read_apart(kind: str, source: bytes | Path) -> Any:
    """What another process finds in octets, or in a file, of that kind; raises `PlotfeedError`.

    It is a tree of lists, texts, numbers and arrays, as the kind's function of `foreign_readers`
    makes it.
    """
    limits = FILE_LIMITS[kind]
    path, data = ("", source) if isinstance(source, bytes) else (str(source.absolute()), b"")
    octets = len(source) if isinstance(source, bytes) else source.stat().st_size
    if octets > limits.octets:
        raise PlotfeedError(f"larger than {limits.octets} octets, the most that is read")
    with TemporaryFile() as out:
        try:
            started = process_apart(_START, kind, path)
            done = subprocess.run(
                **started, input=data, stdout=out, timeout=limits.seconds, check=False
            )
        except subprocess.TimeoutExpired:
            raise PlotfeedError(f"reading it takes more than {limits.seconds} s") from None
        out.seek(0)
        found = _found(out) if done.returncode == 0 else {}
    if "found" in found:
        return found["found"]
    raise PlotfeedError(found.get("error") or broken_or_beyond(kind))


def _found(file: BinaryIO) -> dict[str, Any]:
    """What a process wrote: a line of JSON, and behind it the octets of the arrays in it."""
    import numpy as np

    def array(tree: dict[str, Any]) -> Any:
        if tree.keys() != {"dtype", "shape"}:
            return tree
        shape = [int(n) for n in tree["shape"]]
        return np.fromfile(file, np.dtype(tree["dtype"]), int(np.prod(shape))).reshape(shape)

    try:
        found = json.loads(file.readline(), object_hook=array)
    except (ValueError, TypeError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
