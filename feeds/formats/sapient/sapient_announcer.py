"""What a node of SAPIENT says of itself and does when it is asked to: all but its detections."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from plotfeed.feeds.formats.sapient.sapient_node import CONTENT_TYPE, node_of
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.changes import PFA_FACTOR, ChangeError, changed, in_force
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.mount_keys import LookAt, mount_of
from plotfeed.proto.errors import DecodeError, PlotfeedError
from plotfeed.proto.sapient.decode_sapient import (
    AskedTask,
    TaskStatus,
    decode_task,
    error,
    task_ack,
)
from plotfeed.proto.sapient.encode_sapient import (
    MODE,
    REQUESTS,
    STANDBY,
    THRESHOLDS,
    registration,
    status,
)
from plotfeed.proto.utc import NS, iso_utc

MAX_TASKS_PER_S = 10  # Of a sensor: each may have all of it worked out anew
AT_ONCE_NS = NS  # A task that is to begin by then begins now
MODES = {MODE: True, STANDBY: False}  # Whether the sensor is at work
PFA_FACTORS = dict(zip(THRESHOLDS, (10.0, 1.0, 0.1), strict=True))
# Lets the sensor have those keys, or with None its scene's again; raises `ChangeError`.
Change = Callable[[Mapping[str, Any] | None], object]
Telling = Literal["nothing", "status", "registration"]


class TaskRejectedError(PlotfeedError):
    """A task that the node does not do, and why, in a line."""


@dataclass(frozen=True, slots=True)
class DoneTask:
    """What became of a task that was accepted."""

    goes_on: bool  # It holds until it is stopped, or another takes its place
    tells: Telling = "nothing"  # What the node was asked to say


class SapientTasks:
    """The tasks of one node: one at a time of each command that goes on."""

    def __init__(self, node_id: str) -> None:
        self._node_id = node_id
        # By command: the task, and the keys that take back what it did.
        self._at_work: dict[str, tuple[str, Mapping[str, Any]]] = {}
        self._in_second = (0, 0)

    @property
    def active_task_id(self) -> str:
        """The task that was begun last and goes on; empty for none."""
        return next((task for task, _ in reversed(self._at_work.values())), "")

    def do(self, task: AskedTask, sensor: Sensor, now_utc_ns: int, change: Change) -> DoneTask:
        """Do what is asked of the sensor; raises `TaskRejectedError` or `ChangeError`."""
        if task.destination_id and task.destination_id != self._node_id:
            raise TaskRejectedError(f"for node {task.destination_id[:40]}: this is {self._node_id}")
        self._count(now_utc_ns)
        if task.control == "stop":
            return self._stop(task, change)
        if task.control != "start":
            known = "expected CONTROL_START or CONTROL_STOP"
            raise TaskRejectedError(f"control {task.control or 'is not said'}: {known}")
        if task.limits:
            raise TaskRejectedError(f"{task.limits[0]}: tasks are of the whole cover until stopped")
        if task.start_utc_ns is not None and task.start_utc_ns > now_utc_ns + AT_ONCE_NS:
            raise TaskRejectedError(
                f"task_start_time: {iso_utc(now_utc_ns)} is now; tasks begin at once"
            )
        if task.command == "request":
            return self._request(task.value, change)
        if task.command == "mode_change":
            enabled = _one_of(MODES, task.command, task.value)
            return self._begin(task, {"enabled": enabled}, {"enabled": sensor.enabled}, change)
        if task.command == "detection_threshold":
            factor = _one_of(PFA_FACTORS, task.command, task.value)
            return self._begin(task, {PFA_FACTOR: factor}, {PFA_FACTOR: None}, change)
        if task.command == "look_at":
            return self._begin(task, *_looking(task, sensor), change)
        expected = "expected request, mode_change, detection_threshold or look_at"
        raise TaskRejectedError(f"command {task.command or 'is missing'}: {expected}")

    def _request(self, asked: str, change: Change) -> DoneTask:
        request = _one_of(REQUESTS, "request", asked)
        if request == "registration":
            return DoneTask(goes_on=False, tells="registration")
        if request == "status":
            return DoneTask(goes_on=False, tells="status")
        if request == "reset":
            change(None)
            self._at_work.clear()
        else:
            change({"enabled": request == "start"})
            self._at_work.pop("mode_change", None)
        return DoneTask(goes_on=False)

    def _begin(
        self, task: AskedTask, keys: Mapping[str, Any], back: Mapping[str, Any], change: Change
    ) -> DoneTask:
        """Change the keys, and remember how they were before any task of that command."""
        before = self._at_work.get(task.command)
        change(keys)
        self._at_work.pop(task.command, None)
        self._at_work[task.command] = (task.task_id, back if before is None else before[1])
        return DoneTask(goes_on=True)

    def _stop(self, task: AskedTask, change: Change) -> DoneTask:
        for command, (task_id, back) in self._at_work.items():
            if task_id == task.task_id:
                change(back)
                del self._at_work[command]
                return DoneTask(goes_on=False)
        raise TaskRejectedError(f"task {task.task_id} is not at work")

    def _count(self, now_utc_ns: int) -> None:
        second, number = max(now_utc_ns // NS, self._in_second[0]), 0
        if second == self._in_second[0]:
            number = self._in_second[1]
        if number >= MAX_TASKS_PER_S:
            raise TaskRejectedError(f"more than {MAX_TASKS_PER_S} tasks in a second")
        self._in_second = (second, number + 1)


def _looking(task: AskedTask, sensor: Sensor) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """The keys of a sensor that looks somewhere, and those that take that back."""
    if mount_of(sensor) is None:
        raise TaskRejectedError("look_at: no mount turns this sensor")
    if task.look_at is None:
        raise TaskRejectedError(
            "look_at: expected degrees from true north, or one place by latitude, longitude and "
            "height above the ellipsoid"
        )
    unsaid = {name: field.default for name, field in LookAt.model_fields.items()}
    keys = {**unsaid, **task.look_at}  # what an earlier task said is not to stay
    return {"mount": {"look_at": keys}}, {"mount": {"look_at": None}}


def _one_of(known: Mapping[str, Any], what: str, asked: str) -> Any:
    """What stands for that word, in whatever case; raises `TaskRejectedError`."""
    for word, meant in known.items():
        if word.lower() == asked.lower():
            return meant
    raise TaskRejectedError(f"{what} {asked[:40]!a}: expected one of {', '.join(known)}")


REGISTRATION = ("type", "plotfeed.sapient.registration")
STATUS = ("type", "plotfeed.sapient.status")
GOODBYE = ("type", "plotfeed.sapient.goodbye")
ANSWER = ("type", "plotfeed.sapient.answer")


class SapientAnnouncer:
    """Makes the messages of a node besides its detections, stamped when they are asked for.

    Stamps are by the sensor's clock, as those of its detections are.
    """

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self.sensor = sensor.id
        self.every_ns = round(scene.sapient.status_interval_s * NS)
        self._root = f"{scene.mqtt.prefix}/{sensor.id}"
        self.inbox = f"{self._root}/{REPORT_FORMATS['sapient'].inbox}"
        self._scene = scene
        self._keys = changed(sensor, *in_force(sensor.event, 0))
        self._node = node_of(scene, self._keys)
        self._tasks = SapientTasks(self._node.node_id)
        # When something was said last, and how many of each kind: no two have one name.
        self._ids: tuple[int, Counter[str]] = (0, Counter())

    def opening(self, now_utc_ns: int) -> list[Message]:
        """Registration, for whoever comes later too, and a first status."""
        return [self._registration(now_utc_ns), self._status(now_utc_ns, new=True)]

    def regular(self, now_utc_ns: int) -> list[Message]:
        """News that nothing has changed."""
        return [self._status(now_utc_ns)]

    def closing(self, now_utc_ns: int) -> list[Message]:
        """Goodbye: news, for a status that is unchanged would have to be the last one.

        It stays in the Registration's place: whoever comes later learns that the node is gone.
        """
        farewell = status(
            self._node,
            self._stamp_ns(now_utc_ns),
            system="GOODBYE",
            new=True,
            mode=self._mode(self._keys),
        )
        return [self._message(farewell, now_utc_ns, GOODBYE, retain=True)]

    def changed(self, sensor: Sensor, now_utc_ns: int) -> list[Message]:
        """What there is to say of the sensor's new keys: what is not true any more, anew."""
        before, before_mode = self._node, self._mode(self._keys)
        self._keys, self._node = sensor, node_of(self._scene, sensor)
        if self._node == before and self._mode(sensor) == before_mode:
            return []
        news = [self._status(now_utc_ns, new=True)]
        if registration(self._node, now_utc_ns) != registration(before, now_utc_ns):
            news.insert(0, self._registration(now_utc_ns))
        return news

    def answer(self, payload: bytes, now_utc_ns: int, change: Change) -> tuple[list[Message], bool]:
        """Do a task and acknowledge it, or reject it with the reason; what is none, is an Error."""
        try:
            task = decode_task(payload)
        except DecodeError as wrong:
            said = error(self._node.node_id, self._stamp_ns(now_utc_ns), payload, str(wrong))
            return [self._message(said, now_utc_ns, ANSWER)], False
        try:
            done = self._tasks.do(task, self._keys, self._stamp_ns(now_utc_ns), change)
        except (TaskRejectedError, ChangeError) as wrong:
            return [self._ack(task.task_id, now_utc_ns, "REJECTED", str(wrong))], False
        messages = [self._ack(task.task_id, now_utc_ns, "ACCEPTED")]
        if done.tells == "registration":
            messages += self.opening(now_utc_ns)
        elif done.tells == "status" or done.goes_on:
            messages.append(self._status(now_utc_ns, new=True))
        if not done.goes_on:
            messages.append(self._ack(task.task_id, now_utc_ns, "COMPLETED"))
        return messages, True

    def _ack(self, task_id: str, now_utc_ns: int, what: TaskStatus, reason: str = "") -> Message:
        payload = task_ack(self._node.node_id, self._stamp_ns(now_utc_ns), task_id, what, reason)
        return self._message(payload, now_utc_ns, ANSWER)

    def _stamp_ns(self, now_utc_ns: int) -> int:
        return now_utc_ns + self._keys.clock_ahead_ns

    @staticmethod
    def _mode(sensor: Sensor) -> str:
        return MODE if sensor.enabled else STANDBY

    def _registration(self, now_utc_ns: int) -> Message:
        payload = registration(self._node, self._stamp_ns(now_utc_ns))
        return self._message(payload, now_utc_ns, REGISTRATION, retain=True)

    def _status(self, now_utc_ns: int, *, new: bool = False) -> Message:
        payload = status(
            self._node,
            self._stamp_ns(now_utc_ns),
            new=new,
            mode=self._mode(self._keys),
            active_task_id=self._tasks.active_task_id,
        )
        return self._message(payload, now_utc_ns, STATUS)

    def _message(
        self, payload: bytes, now_utc_ns: int, kind: tuple[str, str], *, retain: bool = False
    ) -> Message:
        if self._ids[0] != now_utc_ns:
            self._ids = (now_utc_ns, Counter())
        name = f"{kind[1].rpartition('.')[2]}-{now_utc_ns}"
        again = self._ids[1][name]
        self._ids[1][name] += 1
        return Message(
            topic=f"{self._root}/sapient",
            payload=payload,
            content_type=CONTENT_TYPE,
            due_utc_ns=now_utc_ns,
            qos=1,
            retain=retain,
            properties=(
                ("specversion", "1.0"),
                ("id", f"{name}-{again}" if again else name),
                ("source", self._root),
                kind,
                ("time", iso_utc(self._stamp_ns(now_utc_ns))),
                ("sensor", self.sensor),
            ),
        )


def is_registration(message: Message) -> bool:
    """Whether a message is the first that a node sends."""
    return REGISTRATION in message.properties


def is_answer(message: Message) -> bool:
    """Whether a message answers what somebody said, a task above all."""
    return ANSWER in message.properties
