"""The parts of a fleet as detached actors of Ray, which places them and starts them again."""

from __future__ import annotations

import asyncio
import logging
import os
import threading
import time
from collections.abc import Mapping
from itertools import product
from typing import Any

from plotfeed.feeds.console.process import GARBAGE_OF_SESSION, keep_freed, undisturbed
from plotfeed.feeds.fleet.part_asked import part_asked
from plotfeed.feeds.fleet.part_hold import run_part
from plotfeed.feeds.scene.scene import Scene
from plotfeed.proto.errors import PlotfeedError

log = logging.getLogger(__name__)

NAMESPACE = "plotfeed"
AGAIN_S = 1.0
STOP_S = 15.0


class PartActor:
    """A process of one part: it runs it in a thread, and ends where that fails."""

    def __init__(self, name: str, scene: Scene, part: str, **asked: Any) -> None:
        self._name, self._loop, self._stop = name, asyncio.new_event_loop(), asyncio.Event()
        self._thread = threading.Thread(target=self._run, args=(scene, part, asked), daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the part, and say so."""
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(STOP_S)

    def _run(self, scene: Scene, text: str, asked: Mapping[str, Any]) -> None:
        import ray

        keep_freed()
        try:
            broker = asked["broker"]
            part, clock = part_asked(scene, text, start=asked["start"], broker=broker, speed="1")
            session = run_part(
                part,
                scene=scene,
                clock=clock,
                broker=broker,
                duration_s=asked["duration_s"],
                stop=self._stop,
            )
            with undisturbed(GARBAGE_OF_SESSION):
                self._loop.run_until_complete(session)
        except (PlotfeedError, OSError) as error:
            log.warning("part %s: %s", text, error)
            time.sleep(AGAIN_S)
            os._exit(1)  # Ray starts another in its place
        if not self._stop.is_set():  # the scene is over: nobody is to start it again
            ray.kill(ray.get_actor(self._name, namespace=NAMESPACE))


def start_parts(ray: Any, scene: Scene, *, parts: int, spares: int, **asked: Any) -> list[Any]:
    """Actors for all parts, each of one processor; raises `PlotfeedError` where they are there."""
    actor = ray.remote(num_cpus=1, max_restarts=-1, scheduling_strategy="SPREAD")(PartActor)
    found = []
    for n, k in product(range(1 + spares), range(1, parts + 1)):
        name = f"{scene.mqtt.prefix}-part-{k}" + (f"-spare-{n}" if n else "")
        how = actor.options(name=name, namespace=NAMESPACE, lifetime="detached")
        try:
            found.append(how.remote(name, scene, f"{k}/{parts}", **asked))
        except ValueError:
            raise PlotfeedError(
                f"Ray has {name} already: end that fleet first, by plotfeed fleet stop"
            ) from None
    return found


def stop_parts(ray: Any, scene: Scene) -> int:
    """End all parts that run on the scene's prefix; how many there were."""
    mine = f"{scene.mqtt.prefix}-part-"
    named = ray.util.list_named_actors(all_namespaces=True)
    names = [
        each["name"]
        for each in named
        if each["namespace"] == NAMESPACE and each["name"].startswith(mine)
    ]
    actors = [ray.get_actor(name, namespace=NAMESPACE) for name in names]
    ray.wait(
        [actor.stop.remote() for actor in actors], num_returns=len(actors) or 1, timeout=STOP_S
    )
    for actor in actors:
        ray.kill(actor)
    return len(actors)
