"""Who owns which sensor of a fleet: parts to workers, leases and take-overs."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Awaitable, Callable
from typing import Any
from uuid import uuid4

from plotfeed.feeds.fleet.fleet_parts import (
    COUNTED,
    FleetSettings,
    Gaps,
    PartHeld,
    Worker,
    WorkerDiedError,
    is_fenced_by_broker,
    or_not,
)
from plotfeed.feeds.fleet.lease import PATIENCE_S, LeaseBook
from plotfeed.feeds.fleet.part_server import BEGINNING, TAKING_OVER, PartOrder
from plotfeed.feeds.fleet.partition import partition
from plotfeed.feeds.scene.scene import Scene
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS, whole_second_ns

log = logging.getLogger(__name__)

LEAD_NS = 2 * NS
"""From the order to begin until the scene begins."""
AGAIN_S = 1.0


class Coordinator:
    """Looks after the workers of one scene until it ends or is stopped."""

    def __init__(
        self,
        scene: Scene,
        settings: FleetSettings,
        start_worker: Callable[[], Awaitable[Worker]],
    ) -> None:
        self.scene, self.settings = scene, settings
        self.id = f"plotfeed-{uuid4().hex[:8]}"
        self.parts: list[PartHeld] = []
        self.gaps = Gaps()
        self.takeovers = 0
        self.began_utc_ns = 0
        self.counts: dict[str, int] = {}
        """Of parts that have ended."""
        self.on_change: Callable[[], object] = lambda: None
        self._began_world_ns = 0
        self._start_worker = start_worker
        self._book = LeaseBook(settings.lease_s)
        self._idle: list[Worker] = []
        self._keepers: dict[str, asyncio.Task[None]] = {}
        self._aside: set[asyncio.Task[None]] = set()

    @property
    def now_utc_ns(self) -> int:
        """The time of the scene."""
        return self.began_utc_ns + time.time_ns() - self._began_world_ns

    async def run(self, stop: asyncio.Event) -> None:
        """Run the scene over all workers; raises `PlotfeedError`."""
        settings = self.settings
        found = partition(self.scene, settings.workers)
        spares = 0 if settings.is_simulated else settings.spares
        starting = [self._new_worker() for _ in range(len(found) + spares)]
        self._idle = [*await asyncio.gather(*starting)]
        self._began_world_ns = whole_second_ns(time.time_ns() + LEAD_NS)
        self.began_utc_ns = self.scene.scene.start_utc_ns or self._began_world_ns
        ramp_ns = round(settings.ramp_up_s * NS / len(found))
        self.parts = [
            PartHeld(str(i), sensors, i == 0, BEGINNING, self.began_utc_ns + i * ramp_ns)
            for i, sensors in enumerate(found)
        ]
        for part in self.parts:
            self._keepers[part.name] = asyncio.create_task(self._keep(part), name=part.name)
        stopping = asyncio.create_task(stop.wait())
        try:
            while self._keepers:
                keepers = self._keepers.values()
                await asyncio.wait({stopping, *keepers}, return_when=asyncio.FIRST_COMPLETED)
                for name in [n for n, task in self._keepers.items() if task.done()]:
                    self._keepers.pop(name).result()
                if stop.is_set():
                    await self._stop_all()
        finally:
            rest = [stopping, *self._keepers.values(), *self._aside]
            for task in rest:
                task.cancel()
            await asyncio.gather(*rest, return_exceptions=True)

    async def _stop_all(self) -> None:
        """End every part; one of a worker that does not answer ends without."""
        ending = dict(self._keepers)
        for part in self.parts:
            part.leaving = True
        stops = [p.worker.stop(p.key) for p in self.parts if p.worker is not None]
        await asyncio.gather(*(or_not(stop, self.settings.lease_s) for stop in stops))
        await asyncio.wait(ending.values(), timeout=self.settings.lease_s + 5.0)
        for name in ending:
            self._keepers.pop(name).cancel()

    async def _keep(self, part: PartHeld) -> None:
        """Have a part run to its end, by one worker after the other where they fail."""
        while True:
            worker = part.worker or await self._a_worker()
            part.epoch = self._book.begin(part.name)
            order = self._order(part)
            part.worker, part.key, part.joined_utc_ns = worker, order.key, 0
            serving = asyncio.create_task(worker.serve(order))
            works = [self._renew(part, worker, order), self._book.ended(part.name)]
            beside = [asyncio.create_task(each) for each in works]
            try:
                watched = {serving} if order.is_simulated else {serving, *beside}
                await asyncio.wait(watched, return_when=asyncio.FIRST_COMPLETED)
            except asyncio.CancelledError:
                serving.cancel()
                raise
            finally:
                for task in beside:
                    task.cancel()
            why = self._why_it_ended(part, worker, serving)
            if not why or part.leaving:
                return
            await self._take_over_from(part, worker, order, serving, why)

    def _why_it_ended(
        self, part: PartHeld, worker: Worker, serving: asyncio.Task[dict[str, Any]]
    ) -> str:
        """Why another must take over; empty where the part has come to its end."""
        if not serving.done():
            return "has not been heard of in time"
        error = serving.exception()
        if error is None:
            ended = serving.result()
            if not ended["lost"]:
                self.gaps.leave_out(part, worker.name, ended["not_sent"])
            for name in COUNTED:
                self.counts[name] = self.counts.get(name, 0) + ended[name]
            if worker not in self._idle:
                self._idle.append(worker)
            return "lost its lease" if ended["lost"] else ""
        if isinstance(error, WorkerDiedError):
            return "died"
        if part.epoch == 1 or not isinstance(error, PlotfeedError):
            raise error
        return f"failed ({error})"

    async def _take_over_from(
        self,
        part: PartHeld,
        worker: Worker,
        order: PartOrder,
        serving: asyncio.Task[dict[str, Any]],
        why: str,
    ) -> None:
        """Let go of a worker, and note what nobody sends until another does."""
        self.takeovers += 1
        log.warning("part %s: worker %s %s: another takes over", part.name, worker.name, why)
        if not order.is_simulated:
            self.gaps.begin(part, f"{worker.name} {why}")
        if not serving.done():
            self._do_aside(self._refuse_when_awake(worker, order.key, serving))
        if not is_fenced_by_broker(self.scene):
            await asyncio.sleep(max(self._book.left_s(part.name), 0.0))
        if not part.joined_utc_ns:  # a machine that is too slow for one is no faster for the next
            await asyncio.sleep(AGAIN_S)
        part.worker = None
        if not order.is_simulated:
            part.joins = TAKING_OVER
        self.on_change()

    async def _renew(self, part: PartHeld, worker: Worker, order: PartOrder) -> None:
        """Grant a lease as often as a worker asks for it."""
        with contextlib.suppress(WorkerDiedError):
            while True:
                question = await worker.asks(order.key)
                if not self._book.renew(part.name, order.epoch):
                    return
                await worker.granted(order.key, question.number)
                if question.joined_utc_ns:
                    self.gaps.leave_out(part, worker.name, question.not_sent)
                    sent_until_ns = question.sent_until_utc_ns
                    part.sent_until_utc_ns = max(part.sent_until_utc_ns, sent_until_ns)
                    self._note_joined(part, question.joined_utc_ns)
        await asyncio.sleep(PATIENCE_S)  # whoever waits for it to end a part is told of it

    def _note_joined(self, part: PartHeld, joined_utc_ns: int) -> None:
        if part.joined_utc_ns:
            return
        part.joined_utc_ns = joined_utc_ns
        self.gaps.end(part)
        self.on_change()

    async def _refuse_when_awake(
        self, worker: Worker, key: str, serving: asyncio.Task[dict[str, Any]]
    ) -> None:
        """Tell a worker that has lost a part, and have it back when it has understood."""
        try:
            await worker.refused(key)
            await serving
        except (WorkerDiedError, PlotfeedError):
            return
        log.warning("worker %s is back, and waits for another part", worker.name)
        self._idle.append(worker)
        self._let_go()

    async def _a_worker(self) -> Worker:
        """One that waits, or a new one; another is started in its place."""
        if not self._idle:
            return await self._new_worker()
        worker = self._idle.pop(0)
        if not self.settings.is_simulated and len(self._idle) < self.settings.spares:
            self._do_aside(self._have_a_spare())
        return worker

    async def _have_a_spare(self) -> None:
        self._idle.append(await self._new_worker())
        self._let_go()

    async def _new_worker(self) -> Worker:
        while True:
            try:
                return await self._start_worker()
            except WorkerDiedError:
                await asyncio.sleep(AGAIN_S)

    def _let_go(self) -> None:
        """End workers that wait beyond those that should."""
        while len(self._idle) > self.settings.spares:
            self._idle.pop().leave()

    def _do_aside(self, work: Any) -> None:
        task = asyncio.create_task(work)
        self._aside.add(task)
        task.add_done_callback(self._aside.discard)

    def _order(self, part: PartHeld) -> PartOrder:
        settings = self.settings
        record = settings.record and settings.record / f"{part.name}.{part.epoch}.mcap"
        return PartOrder(
            scene=self.scene,
            name=part.name,
            epoch=part.epoch,
            sensors=part.sensors,
            leads=part.leads,
            fleet=self.id,
            began_utc_ns=self.began_utc_ns,
            began_world_ns=self._began_world_ns,
            joins=part.joins,
            joins_utc_ns=part.joins_utc_ns,
            lease_s=settings.lease_s,
            broker=settings.broker,
            duration_s=settings.duration_s,
            is_simulated=settings.is_simulated,
            record=record,
        )
