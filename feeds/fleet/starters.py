"""What starts the parts of a fleet: this machine's processes, Kubernetes by manifests, or Ray."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import threading
import time
from asyncio.subprocess import PIPE, Process
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from itertools import product
from pathlib import Path
from string import Template
from typing import Any

from plotfeed.feeds.console import INTERRUPTED
from plotfeed.feeds.console.process import GARBAGE_OF_SESSION, keep_freed, undisturbed
from plotfeed.feeds.fleet.part_hold import run_part
from plotfeed.feeds.fleet.parts import part_asked
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto.errors import PlotfeedError

log = logging.getLogger(__name__)

# One that has run for less than the latter is started again after the former, others at once.
AGAIN_S, RAN_S = 1.0, 10.0
STOP_S = 15.0  # A process that is told to end is killed after that
FOR_GOOD = (0, 2, INTERRUPTED)  # Exit codes after which nothing else would come of another start
COUNTED = ("looks", "plots", "false_alarms", "messages", "undelivered", "missed_scans")


class LocalParts:
    """Keeps processes running; what they do is between them and their broker."""

    def __init__(self, command: Callable[[int, int], Sequence[str]], parts: int) -> None:
        """`command` is given a part, from 1, and how often it has been started."""
        # Totals of processes that have ended by themselves, or were told to.
        self.counts: Counter[str] = Counter()
        self.starts = [0] * parts
        self._command = command

    async def run(self, stop: asyncio.Event, spares: int) -> int:
        """Run all parts, each by one process more than `spares`, to the end; the exit code."""
        kept = [self._keep(k, stop) for k in range(len(self.starts)) for _ in range(1 + spares)]
        return max(await asyncio.gather(*kept))

    async def _keep(self, k: int, stop: asyncio.Event) -> int:
        while not stop.is_set():
            self.starts[k] += 1
            began_s = asyncio.get_running_loop().time()
            command = self._command(k + 1, self.starts[k])
            process = await asyncio.create_subprocess_exec(*command, stdout=PIPE)
            stopping = asyncio.create_task(_stop_when_told(process, stop))
            told, _ = await process.communicate()
            stopping.cancel()
            with contextlib.suppress(ValueError):
                totals = json.loads(told)
                self.counts.update({name: totals[name] for name in COUNTED})
            code = process.returncode or 0
            if stop.is_set() or code in FOR_GOOD:
                return 0 if stop.is_set() else code
            which = f"part {k + 1}/{len(self.starts)}"
            log.warning("%s: its process has ended (%d), another is started", which, code)
            if asyncio.get_running_loop().time() - began_s < RAN_S:
                await asyncio.sleep(AGAIN_S)
        return 0


async def _stop_when_told(process: Process, stop: asyncio.Event) -> None:
    await stop.wait()
    with contextlib.suppress(ProcessLookupError):
        process.terminate()
        await asyncio.sleep(STOP_S)
        process.kill()


def manifests(
    scene: Path, *, parts: int, spares: int, start: str, broker: str, duration_s: float | None
) -> str:
    """YAML: a StatefulSet of a pod a part, one more for each spare, and who may reach whom.

    Raises `AddressError` where `broker` is none.
    """
    words = ["run", "/scene/scene.toml", "--part", f"$(PART)/{parts}", "--start", start]
    words += ["--broker", broker, "--wait"]
    words += [] if duration_s is None else ["--duration", f"{duration_s:g}"]
    port = BrokerAddress.parse(broker).port
    text = files("plotfeed.feeds.fleet").joinpath("part.yaml").read_text(encoding="utf-8")
    head, policy, stateful_set = text.split("---\n")
    names = ["plotfeed-part", *(f"plotfeed-spare-{n}" for n in range(1, spares + 1))]
    asked = {"parts": parts, "scene": scene, "broker": broker, "port": port}
    asked["arguments"] = json.dumps(words)
    once = [Template(each).substitute(asked) for each in (head, policy)]
    found = [Template(stateful_set).substitute(asked, name=name) for name in names]
    return "---\n".join([*once, *found])


NAMESPACE = "plotfeed"


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
