"""What POSIX systems have and Windows lacks, and what plotfeed does there instead.

Nothing else in the package uses such a module, function or constant, but for what Linux alone has.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from asyncio.subprocess import Process

try:
    import fcntl
    import resource
    import termios
    import tty
except ImportError:
    HAS_POSIX = False
else:
    HAS_POSIX = True

_NEW_USER, _NEW_NETWORK = 0x10000000, 0x40000000  # Of Linux: CLONE_NEWUSER, CLONE_NEWNET
LOOK_EVERY_S = 0.005  # From one look at a socket to the next; clocks of Windows make 16 ms of it
_CLOCK = getattr(time, "CLOCK_BOOTTIME", getattr(time, "CLOCK_MONOTONIC", None))
# On Windows SO_REUSEADDR would give us a port on which somebody else listens.
_LISTEN = getattr(socket, "SO_EXCLUSIVEADDRUSE", socket.SO_REUSEADDR)


def lock(file: int) -> None:
    """Lock a file for this process until it is closed; raises `OSError` where another has it.

    Without POSIX every process may have it at once.
    """
    if HAS_POSIX:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def alive_s() -> float:
    """Seconds of a clock of this machine that also goes on while it is suspended, if it has one."""
    return time.monotonic() if _CLOCK is None else time.clock_gettime(_CLOCK)


def allow_many_files() -> None:
    """Have as many connections as the system lets us, since each is a file."""
    if HAS_POSIX:
        with contextlib.suppress(OSError, ValueError):
            most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def confine_process(memory_octets: int, seconds: int) -> None:
    """Have this process end, or get no more, beyond so much memory or time of a processor.

    It has few files from now on and writes none that is larger, and on Linux, where users may have
    namespaces of their own, no network. Without POSIX nothing holds it.
    """
    if HAS_POSIX:
        if sys.platform == "linux":
            with contextlib.suppress(OSError, AttributeError):
                ctypes.CDLL(None).unshare(_NEW_USER | _NEW_NETWORK)
        for name, most in (
            ("RLIMIT_AS", memory_octets),
            ("RLIMIT_FSIZE", memory_octets),
            ("RLIMIT_CPU", seconds),
            ("RLIMIT_NOFILE", 64),
            ("RLIMIT_CORE", 0),
        ):
            with contextlib.suppress(OSError, ValueError, AttributeError):
                resource.setrlimit(getattr(resource, name), (most, most))


def listen_again(listener: socket.socket) -> None:
    """Let a socket listen on a port that was another's just now, but is nobody's."""
    listener.setsockopt(socket.SOL_SOCKET, _LISTEN, 1)


def end_group(process: Process, *, kill: bool) -> None:
    """Ask a process that leads a session to end, and all that it started; or kill them.

    Without POSIX it is the process alone, and it is killed at once.
    """
    with contextlib.suppress(ProcessLookupError, PermissionError):
        if HAS_POSIX:
            os.killpg(process.pid, signal.SIGKILL if kill else signal.SIGTERM)
        else:
            process.kill()


def on_signal(which: signal.Signals, call: Callable[[], object]) -> Callable[[], object]:
    """Have the running loop call that at a signal; gives what ends that."""
    import asyncio

    loop = asyncio.get_running_loop()
    with contextlib.suppress(NotImplementedError):
        loop.add_signal_handler(which, call)
        return partial(loop.remove_signal_handler, which)
    before = signal.signal(which, lambda *_: loop.call_soon_threadsafe(call))
    return partial(signal.signal, which, before)


def watched(opened: socket.socket, take: Callable[[], object]) -> Callable[[], object]:
    """Have the running loop call `take` when there is something to read; gives what ends that.

    For a loop that watches no sockets, as that of Windows, a task looks at it again and again.
    """
    import asyncio

    loop = asyncio.get_running_loop()
    with contextlib.suppress(NotImplementedError):
        loop.add_reader(opened, take)
        return partial(loop.remove_reader, opened)

    async def look() -> None:
        while True:
            take()
            await asyncio.sleep(LOOK_EVERY_S)

    return asyncio.create_task(look(), name="looks at a socket").cancel


@contextlib.contextmanager
def keys_of(stdin: TextIO, press: Callable[[bytes], object]) -> Iterator[bool]:
    """Meanwhile the running loop calls `press` with what is typed; gives whether anything can be.

    That is at a terminal of POSIX, in whose foreground we are: else asking it would stop us.
    """
    try:
        is_ours = HAS_POSIX and stdin.isatty() and os.tcgetpgrp(stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        is_ours = False
    if not is_ours:
        yield False
        return
    terminal = stdin.fileno()
    before = termios.tcgetattr(terminal)
    import asyncio

    loop = asyncio.get_running_loop()
    tty.setcbreak(terminal)
    loop.add_reader(terminal, lambda: press(os.read(terminal, 64)))
    try:
        yield True
    finally:
        loop.remove_reader(terminal)
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
