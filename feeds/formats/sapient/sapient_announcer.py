"""What a node of SAPIENT says of itself, and to tasks; all but its detections."""

from __future__ import annotations

from collections import Counter

from plotfeed.feeds.formats.message_format import AnnouncerReply
from plotfeed.feeds.formats.sapient.sapient_node import CONTENT_TYPE, node_of
from plotfeed.feeds.formats.sapient.sapient_tasks import Change, SapientTasks, TaskRejectedError
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.changes import ChangeError, changed, in_force
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.sapient.encode_node import MODE, STANDBY, registration, status
from plotfeed.proto.sapient.tasks import TaskStatus, decode_task, error, task_ack
from plotfeed.proto.utc import NS, iso_utc

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
        self._ids: tuple[int, Counter[str]] = (0, Counter())
        """When something was said last, and how many of each kind: no two have one name."""

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

    def answer(self, payload: bytes, now_utc_ns: int, change: Change) -> AnnouncerReply:
        """Do a task and acknowledge it, or reject it with the reason; what is none, is an Error."""
        try:
            task = decode_task(payload)
        except DecodeError as wrong:
            said = error(self._node.node_id, self._stamp_ns(now_utc_ns), payload, str(wrong))
            return AnnouncerReply([self._message(said, now_utc_ns, ANSWER)], accepted=False)
        try:
            done = self._tasks.do(task, self._keys, self._stamp_ns(now_utc_ns), change)
        except (TaskRejectedError, ChangeError) as wrong:
            rejected = self._ack(task.task_id, now_utc_ns, "REJECTED", str(wrong))
            return AnnouncerReply([rejected], accepted=False)
        messages = [self._ack(task.task_id, now_utc_ns, "ACCEPTED")]
        if done.tells == "registration":
            messages += self.opening(now_utc_ns)
        elif done.tells == "status" or done.goes_on:
            messages.append(self._status(now_utc_ns, new=True))
        if not done.goes_on:
            messages.append(self._ack(task.task_id, now_utc_ns, "COMPLETED"))
        return AnnouncerReply(messages, accepted=True)

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
