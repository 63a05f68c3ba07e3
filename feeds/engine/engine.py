"""`Engine`: a scene as a function, telemetry, commands and time in, batches of messages out."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plotfeed.feeds.engine.change_control import ChangeControl
from plotfeed.feeds.engine.emulated_sensors import EmulatedSensors
from plotfeed.feeds.engine.scene_drones import launch, trajectories_of
from plotfeed.feeds.formats import inboxes_of
from plotfeed.feeds.formats.sapient import in_time
from plotfeed.feeds.link.uplink import Uplink
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.changes import (
    ChangeError,
    ClockCommand,
    Command,
    ControlError,
    check_octets,
    instants_ns,
    joined,
    parsed,
)
from plotfeed.feeds.scene.claim_keys import COOPERATIVE
from plotfeed.feeds.scene.report_formats import CUE_TOPIC
from plotfeed.feeds.scene.scene import Scene, example, load
from plotfeed.feeds.scene.sensors.mount_keys import CueError, cue_of, mount_of
from plotfeed.feeds.telemetry.position_report import Reason, Refused
from plotfeed.feeds.telemetry.receiver import TelemetryReceiver
from plotfeed.models.beam import Sector

if TYPE_CHECKING:
    from plotfeed.feeds.engine.cooperative_drones import CooperativeDrones


class Engine:
    """A scene's drones and sensors at work; it neither waits, listens nor sends.

    Give it what comes in with `receive`, and take with `until` what its sensors report. Both may be
    called in any order in which time does not go back, by one thread at a time. The same scene,
    seed, start and input give the same octets, at whatever pace `until` is called.

    Batches hold messages with when their links let them leave, or that these lose them. What a link
    holds while it is down is let go when it is up again; `take_let_go` tells of that.
    """

    def __init__(
        self,
        scene: Scene | str | Path,
        start_utc_ns: int,
        *,
        sensors: Collection[str] | None = None,
        claims: bool = True,
    ) -> None:
        """Launch the scene's drones, and begin each sensor with its first whole sector after that.

        The scene is a loaded one, the name of one that comes with plotfeed, or the path of a file.
        `sensors` are the ids of those that this engine works out, all by default: several engines
        may share a scene. Without `claims`, cooperative drones say nothing. Raises `PlotfeedError`
        where the scene cannot run.
        """
        scene = scene_of(scene)
        own = [each for each in scene.sensor if sensors is None or each.id in sensors]
        self.scene = scene
        self.start_utc_ns = start_utc_ns
        self.trajectories = trajectories_of(scene)
        self.drones = launch(scene, self.trajectories, start_utc_ns)
        self.cooperative: CooperativeDrones | None = None
        if claims and scene.cooperative is not None:
            keys = scene.cooperative
            from plotfeed.feeds.engine.cooperative_drones import CooperativeDrones

            self.cooperative = CooperativeDrones(scene, keys, self.trajectories, self.drones)
        self.telemetry = TelemetryReceiver(scene, self.trajectories)
        self.sensors = EmulatedSensors(scene, self.trajectories, own)
        part = scene.model_copy(update={"sensor": tuple(own)})
        self.changes = ChangeControl(
            part, self.sensors, self.drones, self.cooperative, self._follow_link
        )
        self._ids = [*(sensor.id for sensor in own), COOPERATIVE]
        self._index = {name: i for i, name in enumerate(self._ids)}
        late = in_time(scene)
        links = [*(sensor.link for sensor in own)]
        if scene.cooperative is not None:
            links.append(scene.cooperative.link)
        # Links of the sensors, and then that of the cooperative drones, if there are any.
        self.uplinks = [
            Uplink(link, scene.scene.seed, name, late)
            for link, name in zip(links, self._ids, strict=False)
        ]
        # When scripts may change a sensor's link next, UTC, by index.
        self._link_script: dict[int, deque[int]] = {}
        self._let_go: list[tuple[int, int, Message]] = []
        self.control_topic = f"{scene.mqtt.prefix}/control"
        cued = [sensor.id for sensor in own if mount_of(sensor) is not None]
        self._cues = {f"{scene.mqtt.prefix}/{name}/{CUE_TOPIC}": name for name in cued}
        self._inboxes = inboxes_of(part)
        after = len(scene.mqtt.prefix) + 1
        ends = {topic[after:].partition("/")[2] for topic in (*self._cues, *self._inboxes)}
        # Of topics on which sensors are asked something, behind the sensor.
        self._ends = tuple(f"/{end}" for end in sorted(ends))
        # Told what commands ask of the clock, which whoever drives the engine has.
        self.control_clock: Callable[[ClockCommand], dict[str, Any]] = _not_ours
        # Told what sensors are asked in the words of a format, whose, and when: no plots are.
        self.answer: Callable[[str, bytes, int], object] = _not_answered
        self._claim = 0  # Number of the period at whose end cooperative drones speak next
        self.start(start_utc_ns)

    def start(self, start_utc_ns: int) -> None:
        """Let it all begin then, in place of the start given; nothing was asked for yet."""
        if start_utc_ns != self.start_utc_ns:
            self.drones.put_off(start_utc_ns - self.start_utc_ns)
        self.start_utc_ns = start_utc_ns
        self.sensors.start(start_utc_ns)
        self._link_script = {
            i: deque(start_utc_ns + after_ns for after_ns in instants_ns(sensor.event))
            for i, sensor in enumerate(self.sensors.sensors)
            if sensor.event
        }
        if self.cooperative is not None:
            self.cooperative.start(start_utc_ns)
            self._claim = start_utc_ns // self.cooperative.period_ns + 1

    def foreseen(self, duration_s: float | None) -> tuple[dict[str, str], list[str]]:
        """Drones that no sensor will see until then, and why; and what looks wrong of heights."""
        from plotfeed.feeds.engine.visibility import Outlook

        outlook = Outlook(self.scene, self.sensors, self.trajectories, self.start_utc_ns)
        return outlook.foreseen(duration_s)

    def skip_claims(self, by_utc_ns: int) -> None:
        """Have cooperative drones not say what was due by then."""
        if self.cooperative is not None:
            self._claim = max(self._claim, by_utc_ns // self.cooperative.period_ns + 1)

    def receive(
        self, topic: str, payload: bytes, t_utc_ns: int, content_type: str | None = None
    ) -> Refused | None:
        """Take in telemetry or a command as of that time: why it is refused, or None if it is not.

        Commands come on {prefix}/control and, for mounts, on {prefix}/{sensor}/cue; the clock is
        whose the engine is. Anything else is telemetry, on {prefix}/telemetry/{drone}.
        """
        if not self.is_command(topic):
            why: list[Refused] = []
            self.telemetry.take_together([(topic, [(payload, content_type)])], t_utc_ns, why)
            return why[0] if why else None
        try:
            self.command(topic, payload, t_utc_ns)
        except (ControlError, ChangeError, CueError) as error:
            return Refused(Reason.CONTROL, str(error))
        return None

    @property
    def topics(self) -> list[str]:
        """Filters of the topics that `receive` understands."""
        prefix = self.scene.mqtt.prefix
        return [self.telemetry.topic, self.control_topic, *(f"{prefix}/+{e}" for e in self._ends)]

    def is_command(self, topic: str) -> bool:
        """Whether a topic is for commands; all others are for telemetry."""
        return topic == self.control_topic or topic.endswith(self._ends)

    def asked_of(self, topic: str, payload: bytes) -> str:
        """The sensor that a command is for, empty where it is for none; raises `ControlError`."""
        if topic == self.control_topic:
            return parsed(payload).sensor or ""
        return topic.removeprefix(f"{self.scene.mqtt.prefix}/").partition("/")[0]

    def command(self, topic: str, payload: bytes, t_utc_ns: int) -> Command | None:
        """Do what a command asks; what it was, where it came on the control topic.

        Raises `ControlError`, `ChangeError` or `CueError`, and nothing has changed.
        """
        if topic == self.control_topic:
            command = parsed(payload)
            self.obey(command, t_utc_ns)
            return command
        is_cue = topic.endswith(f"/{CUE_TOPIC}")
        takers = self._cues if is_cue else self._inboxes
        if topic not in takers:
            what = "that a mount turns" if is_cue else "that takes this"
            known = ", ".join(takers.values())
            raise ControlError(f"there is no sensor {what}; expected one of {known}")
        check_octets(payload)
        if not is_cue:
            self.answer(takers[topic], payload, t_utc_ns)
            return None
        if self.sensors.cueing is not None:
            i = self._index[takers[topic]]
            place_enu_m = self.sensors.sensors[i].position_enu_m
            self.sensors.cueing.cue(i, cue_of(payload), place_enu_m, t_utc_ns)
        return None

    def obey(self, command: Command, t_utc_ns: int) -> dict[str, Any]:
        """Do what a command asks from then on, and say what is in force; raises `PlotfeedError`."""
        if command.clock is not None:
            return self.control_clock(command.clock)
        return self.changes.obey(command, t_utc_ns)

    def until(self, t_utc_ns: int, *, messages: bool = True) -> Iterator[Batch]:
        """Batches of all sectors that end by then and were not given before.

        Batches hold sectors by sensor and then by time; what cooperative drones say comes last, as
        batches of the sensor "cooperative". Without `messages`, none are encoded.
        """
        if not messages:
            yield from self.sensors.seen(t_utc_ns + 1)
            return
        for batch in self.sensors.seen(t_utc_ns + 1):
            yield self._over_links(batch, self.sensors.messages(batch))
        cooperative = self.cooperative
        while cooperative is not None and self._claim_due_ns <= t_utc_ns:
            due_ns, period_ns = self._claim_due_ns, cooperative.period_ns
            said, truths = cooperative.said(self._claim)
            sector = Sector(self._claim, 0, due_ns - period_ns, due_ns, 0.0, 360.0)
            self._claim += 1
            i = len(self._ids) - 1
            batch = Batch.of_one(sector, sensor=i, sensors=self._ids, claims=truths)
            yield self._over_links(batch, [said])
        for i in self._link_script:
            self._follow_link_script(i, t_utc_ns)

    def take_let_go(self) -> list[tuple[int, int, Message]]:
        """What links held and have let go since this was asked last: sensor, when, and what.

        The sensor is an index of `uplinks`, the time UTC. Some of it is lost all the same, as its
        `fate` says.
        """
        found, self._let_go = self._let_go, []
        return found

    def _over_links(self, batch: Batch, messages: Sequence[Sequence[Message]]) -> Batch:
        """The batch with the messages of its sectors, each after its link."""
        outgoing, links = [], []
        of = batch.sectors.sensor.tolist()
        for i, end_ns, some in zip(of, batch.sectors.end_ns.tolist(), messages, strict=True):
            if i in self._link_script:
                self._follow_link_script(i, end_ns)
            uplink = self.uplinks[i]
            outgoing.append(uplink.passed(some))
            links.append(uplink.json)
        return replace(batch, messages=outgoing, links=links)

    def _follow_link_script(self, i: int, t_utc_ns: int) -> None:
        """Have a sensor's link be as its script has it by then."""
        script = self._link_script[i]
        while script and script[0] <= t_utc_ns:
            self._follow_link(i, script.popleft())

    def _follow_link(self, i: int, at_utc_ns: int) -> None:
        """Have a sensor's link be as script and control have it then."""
        layers = joined(self.changes.layers[self._ids[i]])
        link = self.sensors.as_of(i, layers, at_utc_ns).link
        if link != self.uplinks[i].link:
            let_go = self.uplinks[i].change(link, at_utc_ns)
            self._let_go += [(i, at_utc_ns, one) for one in let_go]

    @property
    def next_end_ns(self) -> int | None:
        """When the next sector ends, or cooperative drones speak next; None for never."""
        ends_ns = [] if self.cooperative is None else [self._claim_due_ns]
        if (end_ns := self.sensors.next_end_ns) is not None:
            ends_ns.append(end_ns)
        return min(ends_ns, default=None)

    @property
    def _claim_due_ns(self) -> int:
        return self._claim * self.cooperative.period_ns if self.cooperative is not None else 0


def scene_of(scene: Scene | str | Path) -> Scene:
    """A scene that is loaded, has that name among those of plotfeed, or is in that file.

    Raises `PlotfeedError`.
    """
    if isinstance(scene, Scene):
        return scene
    is_name = isinstance(scene, str) and re.fullmatch(r"[\w-]+", scene)
    return example(str(scene)) if is_name else load(scene)


def _not_ours(_command: ClockCommand) -> dict[str, Any]:
    raise ControlError("clock: whoever drives the engine gives it time")


def _not_answered(sensor: str, _payload: bytes, _t_utc_ns: int) -> None:
    raise ControlError(f"{sensor}: whoever drives the engine answers what sensors are asked")
