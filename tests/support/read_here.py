"""Recordings read in the test's own process: the process apart takes longer to start than to read.

That it reads the same, and that it is confined, is tested with processes that are started.
"""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO
from unittest.mock import patch

import pytest

from plotfeed.feeds.recording import foreign_recordings
from plotfeed.feeds.telemetry.foreign_files import found_in
from plotfeed.proto.errors import PlotfeedError

APART = ("test_foreign_recordings",)  # Files whose tests are of the process


class _Done:
    """What is left of a process that has written all that it was asked for."""

    returncode = 0

    def __init__(self, args: list[str], *, stdin: BinaryIO, **_: Any) -> None:
        self.stdout = io.BytesIO()
        with (
            patch.object(sys, "argv", ["", args[-1]]),
            patch.object(sys, "stdin", SimpleNamespace(buffer=stdin)),
            patch.object(sys, "stdout", SimpleNamespace(buffer=self.stdout)),
            patch.object(foreign_recordings, "confine_process", lambda *_: None),
        ):
            foreign_recordings.main()
        self.stdout.seek(0)

    def kill(self) -> None:
        """It has ended."""

    def wait(self) -> int:
        """It has ended."""
        return self.returncode


@pytest.fixture(autouse=True)
def read_here(request: pytest.FixtureRequest) -> Iterator[None]:
    """Read in this process, but in files whose tests are of the other."""
    if request.path.stem in APART:
        yield
        return
    here = SimpleNamespace(Popen=_Done, PIPE=subprocess.PIPE)
    with patch.object(foreign_recordings, "subprocess", here):
        yield


def found_here(kind: str, source: bytes | Path) -> Any:
    """As `read_apart`, in this process and without its limits."""
    found = found_in(kind, source if isinstance(source, bytes) else str(source))
    if "error" in found:
        raise PlotfeedError(found["error"])
    return found["found"]
