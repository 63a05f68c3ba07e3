"""A terminal's and a process's manners: signals, progress, a file that is whole or not there.

Nothing here knows of sensors, messages or sessions.
"""

FAILED = 1  # Exit code of what was begun and did not work
INTERRUPTED, TERMINATED = 130, 143  # Exit codes after SIGINT and SIGTERM, as shells have them
