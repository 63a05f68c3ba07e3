"""Ledgers for tests: of messages that a link has passed on, and of whole sessions, as files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from support.links import OCTETS, due_times, passed
from support.recordings import MS, mcap_of, message

from plotfeed.feeds.lab.gathering import FeedReport
from plotfeed.feeds.link.impairment import Outcome
from plotfeed.feeds.recording.recorder import attachments_of
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.scene import Scene
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Attachment, Recorded, Stage
from plotfeed.testing import START_NS, fly

LEDGER = "application/x-protobuf; messageType=plotfeed.v1.Ledger"


def json_of(link: LinkSettings) -> str:
    """As the ledger has it."""
    return link.model_dump_json(exclude_defaults=True)


def entries(
    link: LinkSettings,
    count: int,
    *,
    seed: int = 1,
    late_ns: int = 0,
    says: LinkSettings | None = None,
    in_each: int = 4,
) -> list[pb.Ledger]:
    """Of so many messages, which a link passed on, and which the engine then sent late.

    The ledger says that the link was `says`, where that is another.
    """
    dues = due_times(count, 100.0, START_NS)
    outcomes = passed(link, dues, seed=seed)
    told = [
        list(_sent(number, due, outcome, late_ns))
        for number, (due, outcome) in enumerate(zip(dues, outcomes, strict=True))
    ]
    return [
        pb.Ledger(
            sensor="radar",
            scan=first,
            messages=[sent for each in told[first : first + in_each] for sent in each],
            link=json_of(says or link),
        )
        for first in range(0, count, in_each)
    ]


def _sent(number: int, due_ns: int, outcome: Outcome, late_ns: int) -> Iterator[pb.Sent]:
    if not outcome.copies:
        yield pb.Sent(number=number, due_utc_ns=due_ns, fate=outcome.fate, octets=OCTETS)
    for copy, sent in enumerate(outcome.copies):
        yield pb.Sent(
            number=number,
            copy=copy,
            due_utc_ns=due_ns,
            link_due_utc_ns=sent.due_utc_ns,
            sent_utc_ns=sent.due_utc_ns + late_ns,
            flipped_bit=sent.flipped_bit,
            octets=OCTETS,
            delivered=True,
            fate=pb.SENT,
        )


def recorded(
    ledgers: Iterable[pb.Ledger | bytes], *, topic: str = "plotfeed/truth"
) -> list[Recorded]:
    """As they come by MQTT, a millisecond apart."""
    payloads = (x if isinstance(x, bytes) else x.SerializeToString() for x in ledgers)
    return [
        message(payload, START_NS + n * MS, topic=topic, content_type=LEDGER)
        for n, payload in enumerate(payloads)
    ]


def written(
    path: Path, messages: Iterable[Recorded], attachments: Sequence[Attachment] = ()
) -> Path:
    """A file of those."""
    path.write_bytes(mcap_of(messages, attachments=attachments))
    return path


def changed(
    path: Path,
    other: Path,
    change: Callable[[Iterable[Recorded]], Iterable[Recorded]] = list,
    attachments: Sequence[Attachment] | None = None,
) -> Path:
    """Another record with what the change makes of the messages, and the same attachments."""
    with McapReader(path) as log:
        if attachments is None:
            found = map(log.attachment, [entry.name for entry in log.attachments()])
            attachments = [each for each in found if each is not None]
        return written(other, change(log.messages()), attachments)


def told(path: Path) -> FeedReport:
    """What is reported of a file."""
    return FeedReport(path, "asked")


def told_of(folder: Path, ledgers: Sequence[pb.Ledger | bytes]) -> FeedReport:
    """What is reported of those."""
    return told(written(folder / "ledger.mcap", recorded(ledgers)))


def record_session(
    scene: Scene, path: Path, duration_s: float, *, says: Scene | None = None
) -> Path:
    """The record of a session in simulated time.

    It says that the session was one of the scene `says`, if that is given.
    """
    fly(scene, duration_s, record=path)
    if says is None:
        return path
    attachments = attachments_of(says, START_NS)
    return changed(path, path.with_name(f"{path.stem}-says{path.suffix}"), attachments=attachments)


def as_received(messages: Iterable[Recorded]) -> Iterator[Recorded]:
    """What a recording of the broker would have had of a session's."""
    return (each._replace(stage=Stage.RECEIVED) for each in messages if each.stage is Stage.AFTER)
