"""Names of this machine in requests, so that no web site gets at what listens on loopback.

A page of anywhere may have its browser ask a port of this machine. Where its name stands for a
loopback address (DNS rebinding), the header Host tells it; else the header Origin does.
"""

from __future__ import annotations

LOOPBACK = "127.0.0.1"
LOOPBACK_NAMES = frozenset({"localhost", LOOPBACK, "::1"})


def name_in_host(header: str) -> str:
    """The name in a header Host, without the port, in lower case."""
    if header.startswith("["):
        return header[1:].partition("]")[0].lower()
    return header.partition(":")[0].lower()
