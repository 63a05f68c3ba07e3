"""The parts of a fleet as processes of this machine, started again where they fail."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from asyncio.subprocess import PIPE, Process
from collections import Counter
from collections.abc import Callable, Sequence

from plotfeed.feeds.console import INTERRUPTED

log = logging.getLogger(__name__)

# One that has run for less than the latter is started again after the former, others at once.
AGAIN_S, RAN_S = 1.0, 10.0
STOP_S = 15.0  # A process that is told to end is killed after that
FOR_GOOD = (0, 2, INTERRUPTED)  # Exit codes after which nothing else would come of another start
COUNTED = ("looks", "plots", "false_alarms", "messages", "undelivered", "missed_scans")


class LocalParts:
    """Keeps processes running; what they do is between them and their broker."""

    def __init__(self, command: Callable[[int, int], Sequence[str]], parts: int) -> None:
        """`command` is given a part, from 1, and how often it has been started."""
        # Totals of processes that have ended by themselves, or were told to.
        self.counts: Counter[str] = Counter()
        self.starts = [0] * parts
        self._command = command

    async def run(self, stop: asyncio.Event, spares: int) -> int:
        """Run all parts, each by one process more than `spares`, to the end; the exit code."""
        kept = [self._keep(k, stop) for k in range(len(self.starts)) for _ in range(1 + spares)]
        return max(await asyncio.gather(*kept))

    async def _keep(self, k: int, stop: asyncio.Event) -> int:
        while not stop.is_set():
            self.starts[k] += 1
            began_s = asyncio.get_running_loop().time()
            command = self._command(k + 1, self.starts[k])
            process = await asyncio.create_subprocess_exec(*command, stdout=PIPE)
            stopping = asyncio.create_task(_stop_when_told(process, stop))
            told, _ = await process.communicate()
            stopping.cancel()
            with contextlib.suppress(ValueError):
                totals = json.loads(told)
                self.counts.update({name: totals[name] for name in COUNTED})
            code = process.returncode or 0
            if stop.is_set() or code in FOR_GOOD:
                return 0 if stop.is_set() else code
            which = f"part {k + 1}/{len(self.starts)}"
            log.warning("%s: its process has ended (%d), another is started", which, code)
            if asyncio.get_running_loop().time() - began_s < RAN_S:
                await asyncio.sleep(AGAIN_S)
        return 0


async def _stop_when_told(process: Process, stop: asyncio.Event) -> None:
    await stop.wait()
    with contextlib.suppress(ProcessLookupError):
        process.terminate()
        await asyncio.sleep(STOP_S)
        process.kill()
