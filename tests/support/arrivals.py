"""Counts what arrives, and nothing else: mosquitto_sub, which takes least of the machine."""

from __future__ import annotations

import subprocess
import tempfile

from support.tools import place_of
from support.waiting import wait_until


class Arrivals:
    """It hears those topics once it is made."""

    def __init__(self, port: int, topic_filter: str = "plotfeed/+/asterix/#") -> None:
        subscriber, publisher = place_of("mosquitto_sub"), place_of("mosquitto_pub")
        assert subscriber, "counting needs mosquitto_sub, of Debian's mosquitto-clients"
        at = ["-h", "127.0.0.1", "-p", str(port), "-V", "mqttv5"]
        self._lengths = tempfile.TemporaryFile()  # noqa: SIM115 - of each payload, a line each
        self._process = subprocess.Popen(
            [subscriber, *at, "-t", topic_filter, "-F", "%l"], stdout=self._lengths
        )
        # What a sensor sends has octets: messages of none are ours, and show that it hears.
        ours = [publisher, *at, "-t", topic_filter.replace("+", "us").rstrip("#") + "us", "-n"]
        wait_until(lambda: not subprocess.run(ours, check=False).returncode and self._lines())

    def _lines(self) -> list[bytes]:
        self._lengths.seek(0)
        return self._lengths.read().splitlines()

    def count(self, settle_s: float = 1.0) -> int:
        """How many messages came; a second later it hears no more."""
        try:
            self._process.wait(settle_s)
        except subprocess.TimeoutExpired:
            self._process.terminate()
            self._process.wait()
        return sum(line != b"0" for line in self._lines())
