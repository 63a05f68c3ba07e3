"""Changes what is well-formed by what it is: trees of JSON, elements, lines, or octets."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from random import Random
from typing import Any

# What has broken readers before, or is about to: numbers without end, times without a zone.
VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 10**400, -(10**30), 1 << 63, 1e308, -1e308, 5e-324, float("nan")),
    *("", "2026-01-01Z", "0001-01-01T00:00:00Z", "9999-12-31T23:59:60+99:99", "1e400", "\ud800"),
    *("\x00", "\u202e", "A" * 5000, [], {}, [[]] * 500, {"a": {"a": {"a": {}}}}),
)
NUMBERS = (b"0", b"-1", b"1e400", b"1" * 400, b"nan", b"", b"2026-01-01Z", b"99:99:99", b"A" * 3000)
DEEP = 3000


def _json(data: bytes, rng: Random) -> bytes:
    """A node of a tree is another value, is there many times, or is deep in lists."""
    start = min((at for at in (data.find(b"{"), data.find(b"[")) if at >= 0), default=0)
    tree = [json.loads(data[start:])]
    holder: Any = tree
    key: Any = 0
    while isinstance(holder[key], dict | list) and holder[key] and rng.random() < 0.8:
        holder = holder[key]
        key = rng.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
    if isinstance(holder, list) and holder is not tree and rng.random() < 0.2:
        holder[key:key] = [holder[key]] * rng.randrange(200)
    else:
        holder[key] = rng.choice(VALUES)
    text = json.dumps(tree[0])
    if rng.random() < 0.05:
        text = text.replace(json.dumps(holder[key]), "[" * DEEP + "]" * DEEP, 1)
    return data[:start] + text.encode()


def _elements(data: bytes, rng: Random) -> bytes:
    """An element is there many times, is in itself, or holds another text."""
    found = rng.choice(list(re.finditer(rb"<(\w[\w:]*)([^>]*)>([^<]*)", data)))
    name = found[1]
    if rng.random() < 0.3:
        return data[: found.start()] + found[0] * rng.randrange(200) + data[found.end() :]
    if rng.random() < 0.5:
        times = rng.randrange(100)
        nested = b"<%s>" % name * times + b"</%s>" % name * times
        return data[: found.start()] + nested + data[found.start() :]
    return data[: found.start(3)] + rng.choice(NUMBERS) + data[found.end(3) :]


def _lines(data: bytes, rng: Random) -> bytes:
    """A line is there many times or not at all, or one of its cells is something else."""
    lines = data.split(b"\n")
    at = rng.randrange(len(lines))
    if rng.random() < 0.3:
        lines[at : at + 1] = [lines[at]] * rng.randrange(100)
    else:
        cells = re.split(rb"([,;\t: ])", lines[at])
        cells[rng.randrange(len(cells))] = rng.choice(NUMBERS)
        lines[at] = b"".join(cells)
    return b"\n".join(lines)


def _octets(data: bytes, rng: Random) -> bytes:
    """A length is the least or the greatest, or some octets are others, or more, or none."""
    at = rng.randrange(len(data) + 1)
    end = min(len(data), at + rng.randrange(64))
    octets = rng.choice((1, 2, 4, 8))
    number = rng.choice((0, 1, 256**octets // 2 - 1, 256**octets - 1, rng.randrange(256**octets)))
    ways = (
        (number.to_bytes(octets, rng.choice(("little", "big"))), at + octets),
        (data[at:end] * rng.randrange(200), end),
        (rng.randbytes(rng.randrange(8)), end),
        (b"", end),
    )
    put, behind = rng.choice(ways)
    return data[:at] + put + data[behind:]


def mutated(data: bytes, rng: Random) -> bytes:
    """Some octets with one to three changes."""
    for _ in range(rng.randint(1, 3)):
        ways: list[Callable[[bytes, Random], bytes]] = [_octets]
        ways += (
            [_json] * 3 * (b"{" in data)
            + [_elements] * 3 * (b"<" in data)
            + [_lines] * (b"\n" in data)
        )
        try:
            data = rng.choice(ways)(data, rng)
        except (ValueError, IndexError, RecursionError):  # it is not what it looks like
            data = _octets(data, rng)
    return data
