"""The process: signals as a request to end, a file that is whole or not there, memory, threads."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from io import BufferedWriter, FileIO
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from types import FrameType
from typing import TYPE_CHECKING, BinaryIO

from plotfeed.feeds.console import TERMINATED
from plotfeed.feeds.console.posix import HAS_POSIX, lock, on_signal
from plotfeed.feeds.console.printed import naming
from plotfeed.proto.errors import PlotfeedError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

# Objects more than before at which the garbage collector looks at the youngest.
GARBAGE_OF_SESSION, GARBAGE_OF_REPLAY = 50_000, 100_000
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # Of mallopt(3)
KEPT_OCTETS, OF_ITS_OWN_OCTETS = 128 << 20, 32 << 20
# How temporary folders begin, and what in them is locked while they are used.
FOLDERS, LOCK = "plotfeed-run-", "lock"
PRIVATE = 0o600  # Permissions of a file that its owner alone may read
# So long at most a thread that reads keeps the loop from sending; usually it is 5 ms.
SWITCH_S = 1e-5


@contextlib.contextmanager
def stopped_by_signals(stop: Callable[[], object]) -> Iterator[list[signal.Signals]]:
    """Call `stop` at each SIGINT or SIGTERM; gives the list of those that came."""
    came: list[signal.Signals] = []

    def note(which: signal.Signals) -> None:
        came.append(which)
        stop()

    with contextlib.ExitStack() as handled:
        for which in (signal.SIGINT, signal.SIGTERM):
            handled.callback(on_signal(which, partial(note, which)))
        yield came


def processor() -> str:
    """What the machine says that it is."""
    import platform  # which a session does without

    cpuinfo = Path("/proc/cpuinfo")
    told = cpuinfo.read_text("utf-8", "replace").splitlines() if cpuinfo.exists() else []
    names = [line.partition(":")[2].strip() for line in told if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def keep_freed() -> None:
    """Let the C library keep freed memory for the next array, where that is glibc.

    By default it hands back whatever lies free at the end of the heap: columns of ten thousand
    targets then cost more in page faults than in arithmetic.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library
        return
    mallopt(M_TRIM_THRESHOLD, KEPT_OCTETS)
    mallopt(M_MMAP_THRESHOLD, OF_ITS_OWN_OCTETS)


@contextlib.contextmanager
def undisturbed(garbage: int = GARBAGE_OF_REPLAY) -> Iterator[None]:
    """Let neither a thread nor the garbage collector, which finds little, hold up the loop.

    The collector looks at what is `garbage` objects more than before, and never again at what is
    there by now: sectors and messages leave no cycles behind, and each look at all that hundreds
    of sensors consist of would hold everything up.
    """
    switch_s, thresholds = sys.getswitchinterval(), gc.get_threshold()
    gc.freeze()
    gc.set_threshold(garbage, 10, 10)
    sys.setswitchinterval(SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(switch_s)
        gc.set_threshold(*thresholds)
        gc.unfreeze()


def leave_alone_what_is_there() -> None:
    """Collect garbage now, and let the collector never look again at what is left."""
    gc.collect()
    gc.freeze()


def already_there(path: Path) -> PlotfeedError:
    """The error where a file stands that nobody said to replace."""
    return PlotfeedError(f"{path}: is there already; --force writes another in its place")


def refuse_if_there(path: Path, *, force: bool) -> None:
    """Raise `PlotfeedError` where a file would be replaced unasked; a pipe is none."""
    if path.is_file() and not force:
        raise already_there(path)


class OutputFile(FileIO):
    """A file that is written, of which every error names it: a disk is full, a pipe broken."""

    def __init__(self, path: Path, how: int, mode: int = 0o666, shown: Path | None = None) -> None:
        """Opened as `os.open` does; `shown` is what errors name in place of its path."""
        super().__init__(os.open(path, how, mode), "w")
        self._shown = str(shown or path)

    def write(self, data: ReadableBuffer, /) -> int:
        """Write some of the octets, and say how many; raises `OSError` with the name."""
        with naming(self._shown):
            return super().write(data)

    def close(self) -> None:
        """Close it; a network's file may only then say that its disk is full."""
        with naming(self._shown):
            super().close()


def new_file(path: Path, *, force: bool, is_private: bool = False) -> OutputFile:
    """Open a file for writing, which its owner alone may read if it is private.

    Raises `PlotfeedError` where it would replace one that nobody said to replace, and `OSError`.
    """
    refuse_if_there(path, force=force)
    is_ours = not path.exists() or path.is_file()
    how = os.O_TRUNC if force or not is_ours else os.O_EXCL
    mode = PRIVATE if is_private else 0o666
    try:
        file = OutputFile(path, os.O_WRONLY | os.O_CREAT | how, mode)
    except FileExistsError:  # it has come just now
        raise already_there(path) from None
    if is_private and is_ours:
        path.chmod(mode)  # it may have been there
    return file


@contextlib.contextmanager
def own_folder() -> Iterator[Path]:
    """A temporary folder; those that killed processes have left are cleared first."""
    if not HAS_POSIX:
        with TemporaryDirectory(prefix=FOLDERS) as name:
            yield Path(name)
        return
    for left in Path(gettempdir()).glob(f"{FOLDERS}*/{LOCK}"):
        with contextlib.suppress(OSError), left.open("rb") as held:
            lock(held.fileno())  # whose process lives is locked
            shutil.rmtree(left.parent, ignore_errors=True)
    with TemporaryDirectory(prefix=FOLDERS) as name:
        folder = Path(name)
        with (folder / f"{LOCK}.part").open("wb") as held:
            lock(held.fileno())
            (folder / f"{LOCK}.part").rename(folder / LOCK)  # from now on others may find it
            yield folder


@contextlib.contextmanager
def part_file(target: Path, mode: int) -> Iterator[tuple[BinaryIO, Callable[[bool], None]]]:
    """A hidden file beside `target` that takes its place if it is kept and nothing is raised.

    It has these permissions at most. Else it is gone, after SIGTERM too, which ends the process
    with 143: for the main thread only.
    """
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    kept = False

    def keep(wanted: bool) -> None:
        nonlocal kept
        kept = wanted

    with _terminated_in_order():
        try:
            how = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
            with BufferedWriter(OutputFile(part, how, mode, shown=target)) as file:
                yield file, keep
            if kept:
                part.replace(target)
        finally:
            with contextlib.suppress(FileNotFoundError):
                part.unlink()


@contextlib.contextmanager
def made_of(
    sources: Sequence[Path], target: Path, *, force: bool
) -> Iterator[tuple[BinaryIO, Callable[[bool], None]]]:
    """A file that becomes `target` if it is to be kept and nothing is raised; else there is none.

    It may be read by nobody who may not read all `sources`, of which it is made. What is no
    ordinary file, such as a pipe, is written as it is. Raises `PlotfeedError`.
    """
    there = target.exists()
    if there and any(target.samefile(source) for source in sources):
        raise PlotfeedError(f"{target}: is what is read")
    if there and not target.is_file() and not target.is_dir():
        with BufferedWriter(OutputFile(target, os.O_WRONLY)) as file:
            yield file, lambda _: None
        return
    if there and not force:
        raise already_there(target)
    if target.is_dir() or not target.parent.is_dir():
        raise PlotfeedError(f"{target}: expected the name of a file in a folder that is there")
    mode = 0o666
    for source in sources:
        mode &= source.stat().st_mode
    with part_file(target, mode) as part:
        yield part


@contextlib.contextmanager
def _terminated_in_order() -> Iterator[None]:
    """SIGTERM raises `SystemExit` meanwhile, so that what is open is tidied up."""

    def end(_: int, __: FrameType | None) -> None:
        sys.exit(TERMINATED)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
