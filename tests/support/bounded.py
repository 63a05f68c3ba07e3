"""Runs the command from outside, and says what it took: processor time and memory."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import NamedTuple

from support.command import PLOTFEED

# A small process between: a child's memory begins with that of who has started it.
LAUNCHER = """
import json, resource, subprocess, sys
cpu_s, *words = sys.argv[1:]
done = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
resource.prlimit(done.pid, resource.RLIMIT_CPU, (int(cpu_s), int(cpu_s)))
out, err = done.communicate()
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
took = [usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024]
print(json.dumps([done.returncode, out[:1 << 20], err[:1 << 20], *took]))
"""


class Bounded(NamedTuple):
    """What became of a process that may not take too much."""

    returncode: int
    stdout: str
    stderr: str
    cpu_s: float
    memory_mib: float


def bounded(*arguments: object, cpu_s: int, memory_mib: float) -> Bounded:
    """Run it to its end; fails if it takes more than that, which no load of the machine changes.

    The system ends it after so many seconds of processor time.
    """
    words = [sys.executable, "-c", LAUNCHER, str(cpu_s), *PLOTFEED, *map(str, arguments)]
    done = Bounded(*json.loads(subprocess.check_output(words)))
    assert done.returncode >= 0, f"ended by signal {-done.returncode}: {done.stderr[-1000:]}"
    assert "Traceback" not in done.stderr, done.stderr
    assert done.memory_mib <= memory_mib, f"{done.memory_mib:.0f} MiB"
    return done
