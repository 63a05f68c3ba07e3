"""Ray as plotfeed uses it: joined, or started on this machine's loopback, and left again."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
from collections.abc import Iterator
from typing import Any

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.transport.local_hosts import LOOPBACK
from plotfeed.proto.errors import PlotfeedError

OBJECT_STORE_OCTETS = 128 << 20
"""Of shared memory: jobs and what comes of them are small."""
QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    "RAY_DEDUP_LOGS": "0",
    "RAY_worker_niceness": "0",
}
"""Of the environment, unless somebody has set it: Ray tells nobody of its use, asks for no graphics
processors, and its workers, which have deadlines, stand behind nobody else."""
ALONE = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}
"""For a machine alone: else Ray takes loopback for the machine's own address, and listens there."""
CONNECT_S = 5.0
ATTEMPTS = 3
"""Ray gives its processes half a minute to start, which a busy machine may not have."""


class EngineError(PlotfeedError):
    """Ray that cannot be started, or joined."""

    exit_code = 1


@contextlib.contextmanager
def connected(address: str | None, processors: int | None) -> Iterator[Any]:
    """Ray's module, connected meanwhile to a cluster, or to one of this machine alone.

    ADDRESS is HOST:PORT of a cluster's head; without it Ray is started on loopback, for so many
    processors or all that there are, and ends with this. Raises `PlotfeedError`.
    """
    need_extra("ray", "work spread over processes and hosts", "fleet", load=False)
    if address is not None:
        _check_there(address)
    for name, value in (QUIET | ({} if address else ALONE)).items():
        os.environ.setdefault(name, value)
    import ray  # an extra, and a second to load

    how: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
    if address is None:
        how |= {
            "address": "local",
            "num_cpus": processors,
            "include_dashboard": False,
            "object_store_memory": OBJECT_STORE_OCTETS,
            "_node_ip_address": LOOPBACK,
        }
    else:
        how["address"] = address
    for attempt in range(ATTEMPTS):
        try:
            ray.init(**how)
            break
        except Exception as error:  # noqa: BLE001 - a machine that was too slow is told by no other
            ray.shutdown()
            if attempt + 1 < ATTEMPTS and type(error) is Exception:
                continue
            where = "cannot be started" if address is None else f"at {address} does not answer"
            said = next((line for line in str(error).splitlines() if line.strip()), "")
            raise EngineError(f"Ray {where}: {said or type(error).__name__}") from None
    try:
        yield ray
    finally:
        ray.shutdown()


def _check_there(address: str) -> None:
    """Raise `EngineError` where nobody listens: Ray itself would wait for minutes."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_S).close()
    except ValueError:
        raise EngineError(f"Ray: expected HOST:PORT, not {address!r}") from None
    except OSError as error:
        raise EngineError(f"Ray at {address} does not answer: {error.strerror or error}") from None
