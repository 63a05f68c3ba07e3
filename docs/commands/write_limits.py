"""Writes into `SECURITY.md` what files and peers may use up at most, from the tables of that."""

from __future__ import annotations

import math
from pathlib import Path

from pages import between, table

from plotfeed.feeds.telemetry.fair_queue import MAX_OF_TOPIC
from plotfeed.feeds.telemetry.foreign_files import FILE_LIMITS, MIB
from plotfeed.feeds.transport.peers import AT_ONCE_S, PAUSES, PEER_LIMITS, SLICE_OCTETS
from plotfeed.replay.files import MAX_LINE_OCTETS
from plotfeed.replay.mcap import MAX_HELD_OCTETS, MAX_MESSAGES, MAX_RECORD_OCTETS
from plotfeed.replay.pcap import MAX_PACKET_OCTETS

PAGE = Path(__file__).parents[2] / "SECURITY.md"


def text() -> str:
    """Both tables, and what holds for all peers."""
    files, peers = [], []
    for kind, limits in FILE_LIMITS.items():
        apart = f"{limits.memory_mib} MiB, {limits.seconds} s" if limits.seconds else ""
        octets = f"{limits.octets / MIB:.0f} MiB" if limits.octets else ""
        count = f"{limits.count:,}" if limits.count else ""
        files.append((kind, octets, count, limits.depth or "", apart))
    for part, most, count in (
        ("recording, MCAP: a record", MAX_RECORD_OCTETS, ""),
        ("recording, MCAP: held to put them in order", MAX_HELD_OCTETS, f"{MAX_MESSAGES:,}"),
        ("recording, capture: a packet", MAX_PACKET_OCTETS, ""),
        ("recording, JSON lines: a line", MAX_LINE_OCTETS, ""),
    ):
        files.append((part, f"{most / MIB:g} MiB", count, "", ""))
    for door, granted in PEER_LIMITS.items():
        patience = f"{granted.patience_s:g} s" if granted.patience_s < math.inf else ""
        peers.append((door, granted.peers, f"{granted.octets:,}", patience))
    share = 1 / (1 + PAUSES)
    return "\n".join(
        [
            *table(
                ("file", ">octets", ">samples, points, records or messages", ">depth", "apart"),
                files,
            ),
            "",
            *table(("door", ">peers at a time", ">octets at once", "patience"), peers),
            "",
            f"Live sources have {share:.0%} of the time, {1000 * AT_ONCE_S:g} ms at once;",
            f"{MAX_OF_TOPIC} datagrams of a peer, or {MAX_OF_TOPIC} times {SLICE_OCTETS} octets of "
            "a stream, wait for their turn.",
        ]
    )


if __name__ == "__main__":
    between(PAGE, "limits", text())
