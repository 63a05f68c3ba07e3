"""The keys that steer a replay in a terminal."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from typing import TextIO

from plotfeed.feeds.replay_control import ReplayControl
from plotfeed.replay.pacing import MAX_SPEED, MIN_SPEED

SKIP_S = 10.0
HELP = "space pauses, left and right seek 10 s, + and - change the speed, q ends"


def _faster(control: ReplayControl) -> None:
    control.set_speed(min(control.speed * 2, MAX_SPEED))


def _slower(control: ReplayControl) -> None:
    control.set_speed(max(control.speed / 2, MIN_SPEED))


KEYS: dict[bytes, Callable[[ReplayControl], object]] = {
    b"\x1b[C": lambda control: control.skip(SKIP_S),
    b"\x1b[D": lambda control: control.skip(-SKIP_S),
    b" ": lambda control: control.toggle(),
    b"+": _faster,
    b"=": _faster,
    b"-": _slower,
    b"q": lambda control: control.stop(),
}
"""What a terminal sends, and what is done then; the arrows first, for they hold other keys."""


def press(control: ReplayControl, typed: bytes) -> None:
    """Do what keys ask for; what is no key of ours is passed over."""
    while typed:
        key = next((key for key in KEYS if typed.startswith(key)), typed[:1])
        typed = typed[len(key) :]
        if key in KEYS:
            KEYS[key](control)


@contextlib.contextmanager
def steered_by_keys(control: ReplayControl, stdin: TextIO = sys.stdin) -> Iterator[bool]:
    """Meanwhile keys steer it, inside a running loop; gives whether there are any."""
    if not _is_ours(stdin):
        yield False
        return
    terminal = stdin.fileno()
    before = termios.tcgetattr(terminal)
    loop = asyncio.get_running_loop()
    tty.setcbreak(terminal)
    loop.add_reader(terminal, lambda: press(control, os.read(terminal, 64)))
    try:
        yield True
    finally:
        loop.remove_reader(terminal)
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def _is_ours(stdin: TextIO) -> bool:
    """Whether it is a terminal, in whose foreground we are; else asking it would stop us."""
    try:
        return stdin.isatty() and os.tcgetpgrp(stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        return False
