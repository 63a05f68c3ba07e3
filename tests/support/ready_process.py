"""A process that has loaded the command and waits: its forks are `plotfeed`, without the start.

It has imported what commands import, and read and run each shipped scene for a second, as what
scenes name is loaded, and their keys are compiled, when the first one does.

Its argument is the number of a socket. Over that come the words, folder and environment of each
fork, with four files: where its number and its end are told, and its standard ones.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import runpy
import signal
import socket
import sys
import tempfile
from collections.abc import Sequence

from plotfeed.feeds.engine.simulation import simulate
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.scene import example

MOST_OCTETS = 1 << 17  # Of words and environment
# In `plotfeed.feeds`: what commands import once they know what they are to do.
LOADED = (
    *("cli.main", "cli.run", "cli.inject", "cli.check"),
    *("page.server", "transport.embedded_broker"),
    *("lab.live", "recording.recorder", "lab.gathering"),
)


def asked(control: socket.socket) -> list[str]:
    """The words of a fork, in that fork; ends with who asks."""
    while True:
        orders, files, _, _ = socket.recv_fds(control, MOST_OCTETS, 4)
        if not orders:
            _wait_for_forks()
            os._exit(0)
        if not os.fork():
            control.close()
            _keep(files[0], files[1:])
            return _become(*json.loads(orders))
        for file in files:
            os.close(file)
        _wait_for_forks(os.WNOHANG)


def _wait_for_forks(how: int = 0) -> None:
    try:
        while os.waitpid(-1, how)[0]:
            pass
    except ChildProcessError:
        return


def _keep(news: int, standard: Sequence[int]) -> None:
    """Fork once more; tell of that fork, and return in it with those standard files."""
    fork = os.fork()
    if fork:
        for file in standard:
            os.close(file)
        with os.fdopen(news, "w") as told:
            print(fork, file=told, flush=True)
            print(os.waitstatus_to_exitcode(os.waitpid(fork, 0)[1]), file=told)
        os._exit(0)
    os.close(news)
    for number, file in enumerate(standard):
        os.dup2(file, number)
        os.close(file)


def _become(words: list[str], folder: str, environment: dict[str, str]) -> list[str]:
    """Be as a process that was started so."""
    os.chdir(folder)
    sys.path[0] = folder
    os.environ.clear()
    os.environ.update(environment)
    tempfile.tempdir = None  # the environment says which
    sys.stdin = os.fdopen(0, closefd=False)
    sys.stdout = os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, errors="backslashreplace", closefd=False)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    return words


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # forks are told what is meant for them
    for name in LOADED:
        importlib.import_module(f"plotfeed.feeds.{name}")
    for scene in map(example, summaries()):
        simulate(scene, 1.0)
    gc.collect()
    gc.freeze()
    sys.argv[1:] = asked(socket.socket(fileno=int(sys.argv[1])))
    runpy.run_module("plotfeed.feeds.cli", run_name="__main__", alter_sys=True)
