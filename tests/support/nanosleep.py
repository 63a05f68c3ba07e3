"""How late clock_nanosleep wakes a program in C: what the machine itself can do at the moment."""

from __future__ import annotations

import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from support.tools import place_of

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


class Nanosleep:
    """A program that wakes so many times, `step_ns` apart, beside whatever else runs."""

    def __init__(self, deadlines: int, step_ns: int) -> None:
        """Starts it. Raises `FileNotFoundError` without a compiler."""
        program = compiled(SOURCE, "nanosleep")
        if program is None:
            raise FileNotFoundError("no C compiler")
        self._process = subprocess.Popen(
            [program, str(deadlines), str(step_ns)], stdout=subprocess.PIPE
        )

    def late_us(self) -> NDArray[np.float64]:
        """How late each wake-up was, microseconds; waits until the last."""
        out, _ = self._process.communicate()
        return np.array(out.split(), float)

    def stop(self) -> None:
        """End it; it tells nothing."""
        self._process.kill()
        self._process.communicate()


def nanosleep_late_us(deadlines: int, step_ns: int) -> NDArray[np.float64] | None:
    """How late each of them was, microseconds; None without a compiler."""
    try:
        return Nanosleep(deadlines, step_ns).late_us()
    except FileNotFoundError:
        return None
