"""Random numbers that depend on what they are for, and on nothing else.

A Philox generator keyed by (seed, sensor) starts at the counter (scan, purpose, sector): the same
draws come whatever ran before, in whatever order, and in however many processes.
"""

from __future__ import annotations

from enum import IntEnum
from hashlib import blake2b
from typing import Any

import numpy as np


class Purpose(IntEnum):
    """What draws are for; each has a stream of its own."""

    DETECTION = 0
    FALSE_ALARMS = 1
    TRACKS = 2
    COOPERATION = 3
    IMPAIRMENT = 4
    SCAN_TIMES = 5
    DRIFT = 6


class Chance:
    """The random numbers of one sensor."""

    def __init__(self, seed: int, sensor: str) -> None:
        sensor_key = int.from_bytes(blake2b(sensor.encode(), digest_size=8).digest(), "big")
        self.key = sensor_key
        """A number of the sensor's own, from its name alone."""
        self._generators = {
            purpose: np.random.Generator(np.random.Philox(key=(seed << 64) | sensor_key))
            for purpose in Purpose
        }
        self._states: dict[Purpose, dict[str, Any]] = {
            purpose: dict(generator.bit_generator.state)
            for purpose, generator in self._generators.items()
        }

    def rng(self, purpose: Purpose, scan: int, sector: int = 0) -> np.random.Generator:
        """The generator for that purpose, at the start of its draws for that scan and sector.

        The one object a purpose is re-keyed at each call (2 us, where a new one takes 9): finish
        with it before asking for the next.
        """
        generator, state = self._generators[purpose], self._states[purpose]
        counter = np.array([0, sector, purpose, scan], dtype=np.uint64)
        state["state"] = {"counter": counter, "key": state["state"]["key"]}
        generator.bit_generator.state = state
        return generator
