"""The command's process: from its first import to its end, Ctrl-C ends it without a traceback."""

from __future__ import annotations

import signal
import sys


def main() -> None:
    """Entry point: what it imports takes the first tenths of a second."""
    try:
        from plotfeed.feeds.cli.main import main as run_command

        run_command()
    except KeyboardInterrupt:
        from plotfeed.feeds.console import INTERRUPTED

        sys.exit(INTERRUPTED)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # nothing is left but to end


if __name__ == "__main__":
    main()
