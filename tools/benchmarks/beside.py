"""What runs beside what is measured: C that sleeps, and who counts what arrives."""

from __future__ import annotations

import subprocess
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from support.tools import place_of

from plotfeed.testing import MqttReceiver

SOURCE = r"""
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <sys/prctl.h>
int main(int n_arguments, char **arguments) {
    if (n_arguments != 3) return 2;
    long n = atol(arguments[1]), step_ns = atol(arguments[2]);
    double *late_us = malloc(n * sizeof *late_us);
    struct timespec due, now;
    prctl(PR_SET_TIMERSLACK, 1UL);
    clock_gettime(CLOCK_MONOTONIC, &due);
    for (long i = 0; i < n; i++) {
        due.tv_nsec += step_ns;
        while (due.tv_nsec >= 1000000000L) { due.tv_nsec -= 1000000000L; due.tv_sec++; }
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        clock_gettime(CLOCK_MONOTONIC, &now);
        late_us[i] = (now.tv_sec - due.tv_sec) * 1e6 + (now.tv_nsec - due.tv_nsec) / 1e3;
    }
    for (long i = 0; i < n; i++) printf("%.3f\n", late_us[i]);
    return 0;
}
"""


@cache
def compiled(source: str, name: str) -> Path | None:
    """A program of that C source, for as long as this process lives; None without a compiler."""
    compiler = place_of("cc")
    if compiler is None:
        return None
    folder = Path(tempfile.mkdtemp(prefix="plotfeed-c-"))
    file, program = folder / f"{name}.c", folder / name
    file.write_text(source)
    subprocess.run([compiler, "-O2", "-o", program, file], check=True)
    return program


def nanosleep(deadlines: int, step_ns: int) -> Callable[[], NDArray[np.float64]] | None:
    """Have C wake so many times, `step_ns` apart: what the machine itself can do at the moment.

    What it gives waits until the last, and tells how late each was, microseconds. None without a
    compiler.
    """
    program = compiled(SOURCE, "nanosleep")
    if program is None:
        return None
    words = [program, str(deadlines), str(step_ns)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE)
    return lambda: np.array(process.communicate()[0].split(), float)


def nanosleep_late_us(deadlines: int, step_ns: int) -> NDArray[np.float64] | None:
    """How late each of them was, microseconds; None without a compiler."""
    begun = nanosleep(deadlines, step_ns)
    return None if begun is None else begun()


class Arrivals(MqttReceiver):
    """Counts what arrives, and keeps nothing, so that the machine is left to what is measured.

    It hears those topics once it is made. mosquitto_sub takes 20 us of the processor for each
    message, as it writes a line for each.
    """

    def __init__(self, port: int, topic_filter: str = "plotfeed/+/asterix/#") -> None:
        self._count = 0
        super().__init__(port, 5, topic_filter)

    def _take(self, kind: int, body: bytes) -> None:
        if kind & 0x06:
            super()._take(kind, body)  # it has to be acknowledged
        self._count += kind & 0xF0 == 0x30

    def count(self, settle_s: float = 1.0) -> int:
        """How many messages came; a second later it hears no more."""
        time.sleep(settle_s)
        self.close()
        return self._count
