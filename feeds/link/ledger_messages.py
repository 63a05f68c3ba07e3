"""The ledger of sectors: what they truly were, and what became of their messages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain, groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import HELD_NS, Message
from plotfeed.models.state import Ints
from plotfeed.proto.content_types import LEDGER_BATCH, protobuf_content_type
from plotfeed.proto.ledger import Written, ledger_octets, places_of, truth_columns
from plotfeed.proto.utc import iso_utc

CONTENT_TYPE = protobuf_content_type(LEDGER_BATCH)
# Of a message: some brokers take no more than a megabyte.
MOST_OCTETS = 900_000

# A sector by its batch and row, of whose messages it is known what became of them.
Kept = tuple[Batch, int]


def ledger_messages(prefix: str, kept: Sequence[Kept]) -> list[Message]:
    """Messages for {prefix}/truth of the sectors, in that order, as few as brokers take."""
    # Where drones have been forgotten meanwhile, the others have other places in another list.
    same = groupby(kept, key=lambda each: (id(each[0].names), id(each[0].sensors)))
    return [message for _, some in same for message in _messages(prefix, [*some])]


def _messages(prefix: str, kept: Sequence[Kept]) -> list[Message]:
    batch, row = kept[0]
    payload, end_utc_ns = _octets(kept)
    if len(payload) > MOST_OCTETS and len(kept) > 1:
        # Sectors are not equally large: as many as would make messages a fifth smaller.
        n = len(kept) * MOST_OCTETS * 4 // (len(payload) * 5) or 1
        parts = [kept[i : i + n] for i in range(0, len(kept), n)]
        return [message for part in parts for message in _messages(prefix, part)]
    of, sensor = batch.sectors, batch.sensors[batch.sectors.sensor[row]]
    properties = (
        ("specversion", "1.0"),
        ("id", f"truth-{sensor}-{of.scan[row]}-{of.index[row]}"),
        ("source", prefix),
        ("type", "plotfeed.truth"),
        ("time", iso_utc(end_utc_ns)),
    )
    return [
        Message(
            topic=f"{prefix}/truth",
            payload=payload,
            content_type=CONTENT_TYPE,
            due_utc_ns=end_utc_ns,
            properties=properties,
        )
    ]


def _octets(kept: Sequence[Kept]) -> tuple[bytes, int]:
    """A message of sectors whose batches have the same names, and when the last one ended, UTC."""
    number, rows = _ints([id(batch) for batch, _ in kept]), _ints([row for _, row in kept])
    batches = {id(batch): batch for batch, _ in kept}
    places = [np.flatnonzero(number == key) for key in batches]
    told = Batch.joined(
        [batch.rows(rows[own]) for batch, own in zip(batches.values(), places, strict=True)],
        np.argsort(np.concatenate(places)),  # batches may have taken turns
    )
    of = told.sectors
    targets, parts = truth_columns(told.looks, told.plots, told.names)
    told_sensors, sensor_at = places_of(told.sensors, of.sensor)
    claims = [batch.claims or () for batch, _ in kept]
    said = [*chain.from_iterable(claims)]
    sent = [batch.messages[row] for batch, row in kept]
    parts["messages"], topics, destinations = _message_columns(sent)
    links, link = _placed([batch.links[row] for batch, row in kept])
    parts["sectors"] = {
        "sensor": sensor_at[of.sensor],
        "scan": of.scan,
        "sector": of.index,
        "end_utc_ns": of.end_ns,
        "link": link,
        "looks_end": told.looks_by[1:],
        "plots_end": told.plots_by[1:],
        "messages_end": np.cumsum([*map(len, sent)]),
        "claims_end": np.cumsum([*map(len, claims)]) if said else None,
    }
    texts = {
        "sensors": told_sensors,
        "targets": targets,
        "topics": topics,
        "links": links,
        "destinations": destinations,
    }
    return ledger_octets(texts, parts, said), int(of.end_ns.max())


def _message_columns(
    sent: Sequence[Sequence[Message]],
) -> tuple[Written, Iterable[str], Iterable[str]]:
    """What became of messages of sectors; their topics and the destinations that missed some."""
    rows = [*chain.from_iterable(sent)]
    of_sector = np.repeat(np.arange(len(sent)), [*map(len, sent)])
    number = _ints([one.number for one in rows])
    if not ((np.diff(number) > 0) | (np.diff(of_sector) > 0)).all():
        # They left in another order than they were handed over.
        order = np.lexsort((_ints([one.copy for one in rows]), number, of_sector))
        rows, number = [rows[i] for i in order.tolist()], number[order]
    topics, topic = _placed([one.topic for one in rows])
    due, link_due = [one.due_utc_ns for one in rows], [one.leaves_utc_ns for one in rows]
    copies, bits = [one.copy for one in rows], [one.flipped_bit for one in rows]
    not_to = [one.not_to for one in rows]
    missed = [to for some in not_to for to in some] if any(not_to) else []
    destinations, destination = _placed(missed)
    columns: dict[str, NDArray[Any] | None] = {
        "topic": topic,
        "due_utc_ns": _ints(due),
        "sent_utc_ns": _ints([one.sent_utc_ns for one in rows]),
        "octets": _ints([len(one.payload) for one in rows]),
        "fate": np.frombuffer(bytes([one.fate for one in rows]), np.uint8),
        "link_due_utc_ns": None,
        "number": number,
        "copy": _ints(copies) if any(copies) else None,
        "missed_message": np.repeat(np.arange(len(rows)), [*map(len, not_to)]) if missed else None,
        "missed_destination": destination,
    }
    if link_due != due:
        held = [a if b == HELD_NS else b for a, b in zip(due, link_due, strict=True)]
        columns["link_due_utc_ns"] = _ints(held)
    if bits.count(None) < len(bits):
        columns["flipped_bit"] = _ints([-1 if bit is None else bit for bit in bits])
    return columns, topics, destinations


def _placed(texts: Sequence[str]) -> tuple[Iterable[str], Ints]:
    """The texts, each once, and at which place each stands among these, (n,)."""
    place = {text: i for i, text in enumerate(dict.fromkeys(texts))}
    return place, _ints([place[text] for text in texts])


def _ints(values: Sequence[int]) -> Ints:
    return np.array(values, np.int64)
