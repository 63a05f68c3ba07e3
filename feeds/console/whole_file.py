"""A new file that is in its place only when it is whole."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import BinaryIO

TERMINATED = 143
"""Exit code after SIGTERM, as shells have it."""


@contextmanager
def part_file(target: Path) -> Iterator[tuple[BinaryIO, Callable[[bool], None]]]:
    """A hidden file beside `target` that takes its place if it is kept and nothing is raised.

    Else it is gone, after SIGTERM too, which ends the process with 143: for the main thread only.
    """
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    kept = False

    def keep(wanted: bool) -> None:
        nonlocal kept
        kept = wanted

    with _terminated_in_order():
        try:
            with part.open("wb") as file:
                yield file, keep
            if kept:
                part.replace(target)
        finally:
            with contextlib.suppress(FileNotFoundError):
                part.unlink()


@contextmanager
def _terminated_in_order() -> Iterator[None]:
    """SIGTERM raises `SystemExit` meanwhile, so that what is open is tidied up."""

    def end(_: int, __: FrameType | None) -> None:
        sys.exit(TERMINATED)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
