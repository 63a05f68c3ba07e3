"""Every recording, value by value, as libasterix and tshark read it.

As asterix-decoder reads it is in `test_asterix_oracle.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.given_recordings import EVERY_RECORDING
from support.recordings import message, written
from support.tshark import tshark_layers

from plotfeed.feeds.recording.foreign_recordings import open_recording
from plotfeed.proto.asterix.codec.decode import Record, Value, blocks, records_in
from plotfeed.replay.pcap import PcapWriter

# Of flight levels in 14 bits of a quarter each: tshark takes one below 0 for one above.
LEVELS = 1 << 12


def payloads_of(path: Path) -> list[bytes]:
    with open_recording(path) as recording:
        found = [each.payload for each in recording.reader.messages()]
    assert found
    return found


def values(value: Value) -> Iterator[Any]:
    """From left to right."""
    if isinstance(value, dict):
        for each in value.values():
            yield from values(each)
    elif isinstance(value, list):
        for each in value:
            yield from values(each)
    else:
        yield value


@EVERY_RECORDING
def test_libasterix_reads_the_same_values(recording: Path) -> None:
    from support.standard_records import newest, same, values_of_item

    count = 0
    for payload in payloads_of(recording):
        for block in blocks(payload):
            for mine, theirs in zip(records_in(block), newest(block), strict=True):
                for name, value in mine.items.items():
                    if isinstance(value, bytes):  # of SP and RE: no values
                        continue
                    ours, others = list(values(value)), values_of_item(theirs, name)
                    assert len(ours) == len(others), name
                    assert all(map(same, ours, others)), (name, ours, others)
                    count += len(ours)
    assert count >= 15


def of_tshark(layer: Any) -> Iterator[tuple[str, list[Any]]]:
    """Each item of a record by our name, with its values from left to right."""
    for key, content in layer:
        name = key.removeprefix("asterix.").replace("_", "/")
        if name != "fspec":
            yield f"I{name}", list(_leaves(content))


def _leaves(content: Any) -> Iterator[Any]:
    for key, value in content:
        if isinstance(value, list):
            yield from _leaves(value)
        elif key not in ("asterix.FX", "asterix.counter", "asterix.fspec") and "spare" not in key:
            yield value


def is_that(mine: Any, theirs: str) -> bool:
    """Whether both are one value."""
    if isinstance(mine, str):
        return mine.replace("?", " ") == theirs or mine.isdigit()  # codes of Mode A are integers
    number = int(theirs, 16) if theirs.startswith("0x") else float(theirs)
    return bool(mine == pytest.approx(number, rel=1e-9, abs=1e-12))


@EVERY_RECORDING
def test_tshark_reads_the_same_values(recording: Path, tmp_path: Path) -> None:
    payloads = payloads_of(recording)
    path = tmp_path / "again.pcap"
    sent = [message(each, content_type="application/x-asterix") for each in payloads]
    path.write_bytes(written(PcapWriter, sent))
    records: list[Record] = [r for p in payloads for b in blocks(p) for r in records_in(b)]
    layers = [layer for name, layer in tshark_layers(path) if name == "asterix"]
    found = [value for layer in layers for key, value in layer if key == "asterix.message"]
    count = 0
    for record, theirs in zip(records, found, strict=True):
        items = dict(of_tshark(theirs))
        assert set(items) == set(record.items)
        for name, value in record.items.items():
            if isinstance(value, bytes):
                continue
            ours = list(values(value))
            if name == "I048/090" and ours[-1] < 0:
                ours[-1] += LEVELS
            assert len(ours) == len(items[name]), (name, ours, items[name])
            assert all(map(is_that, ours, items[name])), (name, ours, items[name])
            count += len(ours)
    assert count >= 15
