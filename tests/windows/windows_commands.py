"""Runs commands one after the other in this process, whose output has the encoding of Windows.

Words of each come as a line of JSON; exit code, output and errors of each go out as one. The last
line is how many modules there are, each of which can be imported.
"""

from __future__ import annotations

import io
import json
import logging
import sys
import traceback
from contextlib import redirect_stderr, redirect_stdout
from importlib import import_module
from pkgutil import walk_packages
from unittest.mock import patch

import plotfeed.feeds.console.posix
import plotfeed.models
import plotfeed.proto
import plotfeed.replay
from plotfeed.feeds.cli.main import main

ROOMS = (plotfeed.feeds, plotfeed.models, plotfeed.proto, plotfeed.replay)


def run(words: list[str]) -> tuple[int, str, str]:
    out, err = (
        io.TextIOWrapper(io.BytesIO(), "cp1252", newline="\r\n", write_through=True)
        for _ in range(2)
    )
    logging.getLogger().handlers.clear()
    code = 0
    with (
        patch.object(sys, "argv", ["plotfeed", *words]),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
        except Exception:  # noqa: BLE001 - to be told
            traceback.print_exc()
            code = -1
    return code, *(each.buffer.getvalue().decode("cp1252") for each in (out, err))


if __name__ == "__main__":
    for line in sys.stdin:
        print(json.dumps(run(json.loads(line))), flush=True)
    assert not plotfeed.feeds.console.posix.HAS_POSIX
    found = [
        each.name for room in ROOMS for each in walk_packages(room.__path__, f"{room.__name__}.")
    ]
    for name in found:
        if not name.endswith("__main__"):
            import_module(name)
    print(len(found))
