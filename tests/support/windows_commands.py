"""Runs commands one after the other in this process, whose output has the encoding of Windows.

Words of each come as a line of JSON; exit code, output and errors of each go out as one.
"""

from __future__ import annotations

import io
import json
import logging
import sys
import traceback
from contextlib import redirect_stderr, redirect_stdout
from unittest.mock import patch

from plotfeed.feeds.cli.main import main


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
