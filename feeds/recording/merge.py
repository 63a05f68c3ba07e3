"""Several recordings of one session made one: by time, what two of them hold once."""

from __future__ import annotations

import contextlib
import heapq
import json
from collections import Counter, OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from hashlib import blake2b
from itertools import repeat
from operator import attrgetter
from pathlib import Path

from plotfeed.feeds.console.printed import say, say_damage
from plotfeed.feeds.console.process import made_of
from plotfeed.feeds.console.status_line import with_progress
from plotfeed.feeds.recording.recorder import SCENE_NAME, SUFFIX
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.files import FileFormat, writer_to
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import Attachment, Recorded

# Messages that are looked for in other files; the oldest are then forgotten.
MAX_REMEMBERED = 1_000_000
_log_time = attrgetter("log_time_ns")


@dataclass(slots=True)
class MergeCounts:
    """What became of the messages."""

    messages: int = 0  # That are in the new file
    octets: int = 0  # Of their payload
    of: dict[str, int] = field(default_factory=dict)  # Read, by file
    twice: int = 0  # Left out, as another file had them
    # That no such file can hold, by the reason why.
    refused: Counter[str] = field(default_factory=Counter)
    first_ns: int | None = None
    last_ns: int | None = None


def merge_recordings(
    sources: Sequence[Path], target: Path, *, force: bool = False, as_json: bool = False
) -> int:
    """Write `target` with what is in all `sources`, MCAP of one session; the exit code.

    Raises `PlotfeedError` where they are of different scenes, and `OSError`.
    """
    if len(sources) < 2:
        raise PlotfeedError("expected two recordings or more, and the file to be written")
    if len({path.resolve() for path in sources}) < len(sources):
        raise PlotfeedError("a recording is there twice")
    if target.suffix != SUFFIX:
        raise PlotfeedError(f"{target}: expected a name that ends in {SUFFIX}")
    counts = MergeCounts()
    with contextlib.ExitStack() as files:
        logs = [files.enter_context(_opened(path)) for path in sources]
        attachments = _attachments(sources, logs)
        file, keep = files.enter_context(made_of(sources, target, force=force))
        writer = writer_to(file, FileFormat.MCAP)
        for attachment in attachments:
            writer.attach(attachment)
        every = with_progress(
            _merged(sources, logs, counts),
            target.name,
            lambda: sum(log.at for log in logs),
            sum(path.stat().st_size for path in sources),
        )
        for message in every:
            why = writer.write(message)
            if why is not None:
                counts.refused[why] += 1
                continue
            counts.messages += 1
            counts.octets += len(message.payload)
            counts.last_ns = message.log_time_ns
            counts.first_ns = counts.last_ns if counts.first_ns is None else counts.first_ns
        writer.close()
        keep(True)
        for path, log in zip(sources, logs, strict=True):
            say_damage(path, log.damage, all_in="; --json has all")
        if as_json:
            _print_json(sources, logs, target, counts)
        else:
            _print(sources, target, counts)
    return 0


def _opened(path: Path) -> McapReader:
    try:
        return McapReader(path)
    except PlotfeedError as error:
        raise PlotfeedError(f"{path}: {error}") from None


def _attachments(sources: Sequence[Path], logs: Sequence[McapReader]) -> list[Attachment]:
    """What all have with them, the scene first, each once; raises `PlotfeedError`."""
    found: dict[str, tuple[Path, Attachment]] = {}
    for path, log in zip(sources, logs, strict=True):
        if log.attachment(SCENE_NAME) is None:
            raise PlotfeedError(f"{path}: holds no scene: expected the record of a session")
        for name in dict.fromkeys([SCENE_NAME, *(entry.name for entry in log.attachments())]):
            attachment = log.attachment(name)
            if attachment is None:
                continue
            first, known = found.setdefault(name, (path, attachment))
            if known.data != attachment.data:
                what = "scene" if name == SCENE_NAME else ascii(name)
                raise PlotfeedError(f"{path}: holds another {what} than {first}: not one session")
    return [attachment for _, attachment in found.values()]


def _merged(
    sources: Sequence[Path], logs: Iterable[McapReader], counts: MergeCounts
) -> Iterator[Recorded]:
    """Messages of all by log time, and where times are the same by file.

    A message that two files hold comes once, at the earlier time. One that a file holds twice, as
    of a link that doubles, comes twice, however many other files hold it so.
    """
    numbered = (zip(log.messages(), repeat(n)) for n, log in enumerate(logs))
    seen: OrderedDict[bytes, tuple[int, dict[int, int]]] = OrderedDict()
    for path in sources:
        counts.of[str(path)] = 0
    for message, n in heapq.merge(*numbered, key=lambda each: _log_time(each[0])):
        counts.of[str(sources[n])] += 1
        # What makes messages the same, whenever they were recorded.
        said = (message.topic, str(message.stage), message.content_type, *message.properties)
        octets = repr(said).encode() + b"\n" + message.payload
        key = blake2b(octets, digest_size=16).digest()
        written, of_file = seen.get(key, (0, {}))
        of_file[n] = of_file.get(n, 0) + 1
        if of_file[n] <= written:
            counts.twice += 1
        else:
            written += 1
            yield message
        seen[key] = written, of_file
        seen.move_to_end(key)
        if len(seen) > MAX_REMEMBERED:
            seen.popitem(last=False)


def _print(sources: Sequence[Path], target: Path, counts: MergeCounts) -> None:
    say(
        f"{target}: {counts.messages} messages of {len(sources)} recordings, {counts.octets} octets"
    )
    for path, number in counts.of.items():
        say(f"  {number} of {path}")
    if counts.twice:
        say(f"  left out {counts.twice} messages that another recording has")
    for why, number in counts.refused.items():
        say(f"  left out {number} messages: {why}")


def _print_json(
    sources: Sequence[Path], logs: Sequence[McapReader], target: Path, counts: MergeCounts
) -> None:
    found = {
        "target": str(target),
        "messages": counts.messages,
        "octets": counts.octets,
        "of": counts.of,
        "twice": counts.twice,
        "left_out": dict(counts.refused),
        "first_utc": None if counts.first_ns is None else iso_utc(counts.first_ns),
        "last_utc": None if counts.last_ns is None else iso_utc(counts.last_ns),
        "damage": {
            str(path): [asdict(each) for each in log.damage]
            for path, log in zip(sources, logs, strict=True)
        },
    }
    say(json.dumps(found))
