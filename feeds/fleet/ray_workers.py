"""Workers of a fleet as actors of Ray, which places them and says when one has died."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from plotfeed.feeds.fleet.fleet_parts import Worker, WorkerDiedError
from plotfeed.feeds.fleet.part_server import PartOrder, PartServer, Question
from plotfeed.proto.errors import PlotfeedError

AT_ONCE = 64
"""Calls that a worker answers at a time: some last as long as a part."""


class RayWorker:
    """A `PartServer` in a process of its own."""

    def __init__(self, ray: Any, actor: Any) -> None:
        self.name = ""
        self._ray, self._actor = ray, actor

    async def prepare(self) -> None:
        """Wait until it is there; raises `WorkerDiedError`."""
        self.name = await self._call(self._actor.prepare.remote())

    async def serve(self, order: PartOrder) -> dict[str, Any]:
        """Run a part to its end."""
        ended: dict[str, Any] = await self._call(self._actor.serve.remote(order))
        return ended

    async def asks(self, key: str) -> Question:
        """Return when a lease is to be renewed."""
        question: Question = await self._call(self._actor.asks.remote(key))
        return question

    async def granted(self, key: str, number: int) -> None:
        """Renew it."""
        await self._call(self._actor.granted.remote(key, number))

    async def refused(self, key: str) -> None:
        """Let it send nothing more."""
        await self._call(self._actor.refused.remote(key))

    async def ready(self, key: str) -> int:
        """Return when it has caught up."""
        return int(await self._call(self._actor.ready.remote(key)))

    async def join_at(self, key: str, t_utc_ns: int) -> None:
        """Let it send what ends after that time."""
        await self._call(self._actor.join_at.remote(key, t_utc_ns))

    async def hand_over(self, key: str, at_utc_ns: int) -> int:
        """Let it send nothing that ends after a time, which it says."""
        return int(await self._call(self._actor.hand_over.remote(key, at_utc_ns)))

    async def stop(self, key: str) -> None:
        """End a part."""
        await self._call(self._actor.stop.remote(key))

    def leave(self) -> None:
        """End its process."""
        self._ray.kill(self._actor)

    async def _call(self, answer: Any) -> Any:
        errors = self._ray.exceptions
        try:
            return await answer
        except errors.RayTaskError as error:
            cause = error.cause
            if isinstance(cause, PlotfeedError):
                raise cause from None
            raise
        except (errors.RayActorError, errors.OwnerDiedError) as error:
            raise WorkerDiedError(str(error)) from None


def starter(ray: Any) -> Callable[[], Awaitable[Worker]]:
    """What starts another worker; Ray spreads them over the hosts that it has.

    They ask Ray for no processor: how many share one, whoever starts a fleet says.
    """
    remote = ray.remote(
        num_cpus=0, max_restarts=0, max_concurrency=AT_ONCE, scheduling_strategy="SPREAD"
    )
    actor = remote(PartServer)

    async def start() -> Worker:
        worker = RayWorker(ray, actor.remote())
        await worker.prepare()
        return worker

    return start
