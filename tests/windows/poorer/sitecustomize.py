"""Makes this system as poor as Windows for the package's own modules, in a Python that finds it.

A file of JSON, named by PLOTFEED_TEST_LACKS, has the modules that Windows lacks, each with null,
and the names that it lacks in others. The standard library and other packages keep what they need.
"""

from __future__ import annotations

import asyncio
import builtins
import json
import os
import re
import shutil
import signal
import socket
import sys
import time
import types
import warnings
from asyncio.base_events import BaseEventLoop
from asyncio.selector_events import BaseSelectorEventLoop
from collections.abc import Callable
from pathlib import Path
from typing import Any

TICK_NS = 15_625_000  # By so much clocks of Windows step
SIGNALS = {"SIGABRT", "SIGFPE", "SIGILL", "SIGINT", "SIGSEGV", "SIGTERM"}
OPEN_FILES = Path("/proc/self/fd")


class Poorer(types.ModuleType):
    """A module without some of its names, and with others in place of its own."""

    def __init__(self, whole: Any, lacking: set[str], other: dict[str, Any]) -> None:
        super().__init__(whole.__name__)
        object.__setattr__(self, "_whole", whole)
        object.__setattr__(self, "_lacking", lacking)
        self.__dict__.update(other)

    def __getattr__(self, name: str) -> Any:
        if name in self._lacking:
            raise AttributeError(f"module {self.__name__!r} of Windows has no {name!r}")
        return getattr(self._whole, name)


def stepping(clock_ns: Callable[[], int]) -> Callable[[], int]:
    return lambda: clock_ns() // TICK_NS * TICK_NS


MONOTONIC_NS, TIME_NS = stepping(time.monotonic_ns), stepping(time.time_ns)
OTHERS: dict[str, dict[str, Any]] = {
    "os": {"name": "nt", "linesep": "\r\n"},
    "sys": {"platform": "win32"},
    "time": {
        "monotonic_ns": MONOTONIC_NS,
        "monotonic": lambda: MONOTONIC_NS() / 1e9,
        "time_ns": TIME_NS,
        "time": lambda: TIME_NS() / 1e9,
    },
}


def hide(lacks: dict[str, list[str] | None]) -> None:
    """From modules of the package, or run as such, whatever they import from now on."""
    whole_import = builtins.__import__
    poorer: dict[str, Poorer] = {}

    def poorer_import(name: str, globals: Any = None, *more: Any, **named: Any) -> Any:  # noqa: A002
        importer = str((globals or {}).get("__package__") or "")
        if not importer.startswith("plotfeed"):
            return whole_import(name, globals, *more, **named)
        if lacks.get(name, ()) is None:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        found = whole_import(name, globals, *more, **named)
        known = found.__name__
        if known not in lacks and known not in OTHERS:
            return found
        if known not in poorer:
            poorer[known] = Poorer(found, set(lacks.get(known) or ()), OTHERS.get(known, {}))
        return poorer[known]

    builtins.__import__ = poorer_import


def refused(*_: Any, **__: Any) -> Any:
    raise NotImplementedError


def refused_of(name: str) -> property:
    def get(_: object) -> Any:
        raise AttributeError(f"'socket' object has no attribute {name!r}")

    return property(get)


def refused_while_open(name: str) -> None:
    """A function of `os` that Windows refuses for a file that this process has open."""
    whole = getattr(os, name)

    def checked(*paths: Any, **options: Any) -> Any:
        opened = set()
        for each in OPEN_FILES.iterdir():
            try:
                opened.add(str(each.readlink()))
            except OSError:  # that of the listing itself
                continue
        for path in paths:
            if os.path.realpath(path) in opened:
                raise PermissionError(13, "another process is using it", os.fspath(path))
        return whole(*paths, **options)

    setattr(os, name, checked)


def set_signal(which: int, handler: Any, whole: Any = signal.signal) -> Any:
    if signal.Signals(which).name not in SIGNALS:
        raise ValueError("signal number out of range")
    return whole(which, handler)


def be_windows() -> None:
    loop: Any = BaseSelectorEventLoop
    for name in ("add_reader", "add_writer"):
        setattr(loop, name, refused)
    unix: Any = asyncio.SelectorEventLoop
    for name in ("add_signal_handler", "remove_signal_handler"):
        setattr(unix, name, refused)
    for name in ("create_unix_connection", "create_unix_server"):
        setattr(unix, name, refused)
    base: Any = BaseEventLoop
    base.time = lambda _: MONOTONIC_NS() / 1e9
    time.get_clock_info = lambda _: types.SimpleNamespace(resolution=TICK_NS / 1e9)  # type: ignore[assignment]
    for name in ("recvmsg", "recvmsg_into", "sendmsg"):
        setattr(socket.socket, name, refused_of(name))
    for name in ("replace", "rename", "unlink", "remove"):
        refused_while_open(name)
    shutil._use_fd_functions = False  # type: ignore[attr-defined]
    signal.signal = set_signal
    # Files have the encoding of the machine, which is another there: each has to be named.
    warnings.simplefilter("ignore", EncodingWarning)
    warnings.filterwarnings("error", category=EncodingWarning, module=r"plotfeed\.")


# Other programs are their own business; the folder of a clone may have any name.
if {"plotfeed", "windows_commands"} & set(re.findall(r"\w+", " ".join(sys.orig_argv))):
    be_windows()
    hide(json.loads(Path(os.environ["PLOTFEED_TEST_LACKS"]).read_text(encoding="utf-8")))
