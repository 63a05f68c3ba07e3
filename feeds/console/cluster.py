"""A cluster of Ray that somebody runs: its module, connected to it."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
from collections.abc import Iterator
from typing import Any

from plotfeed.feeds.console.extras import need_extra
from plotfeed.proto.errors import PlotfeedError

# Of the environment, unless somebody has set it: Ray tells nobody of its use, asks for no graphics
# processors, and its workers, which have deadlines, stand behind nobody else.
QUIET = {
    "RAY_AUTH_MODE": "token",  # whoever reaches a cluster without one runs code there
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    "RAY_DEDUP_LOGS": "0",
    "RAY_worker_niceness": "0",
}
CONNECT_S = 5.0


class EngineError(PlotfeedError):
    """Processes that die of their work, or Ray that cannot be joined."""

    exit_code = 1


@contextlib.contextmanager
def connected(address: str) -> Iterator[Any]:
    """Ray's module, connected meanwhile to the cluster whose head is at HOST:PORT.

    Raises `PlotfeedError`.
    """
    need_extra("ray", "work spread over hosts", "fleet", load=False)
    host, _, port = address.rpartition(":")
    try:  # Ray itself would wait for minutes where nobody listens
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_S).close()
    except ValueError:
        raise EngineError(f"Ray: expected HOST:PORT, not {address!r}") from None
    except OSError as error:
        raise EngineError(f"Ray at {address} does not answer: {error.strerror or error}") from None
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    import ray  # an extra, and a second to load

    try:
        ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False)
    except Exception as error:  # noqa: BLE001 - a machine that was too slow is told by no other
        ray.shutdown()
        said = next((line for line in str(error).splitlines() if line.strip()), "")
        what = said or type(error).__name__
        raise EngineError(f"Ray at {address} does not answer: {what}") from None
    try:
        yield ray
    finally:
        ray.shutdown()
