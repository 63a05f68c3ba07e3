"""User properties of messages, as pairs and as MQTT 5 packs them, made when somebody asks.

Those of thousands of messages a second are mostly the same ones again: what all messages of a
sensor and kind say is in their `Address`, what all of a sector say in its `SectorStamp`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import overload

from plotfeed.proto.utc import iso_utc

USER_PROPERTY = b"\x26"
"""What announces one in a packet; MQTT 5.0, section 2.2.2."""

Pair = tuple[str, str]


def dashed(kind: str) -> str:
    """A kind of messages, such as `asterix/048`, as ids begin."""
    return kind.replace("/", "-")


def type_of(kind: str) -> str:
    """A kind of messages as the type of their events."""
    return f"plotfeed.{kind.replace('/', '.')}"


@lru_cache(maxsize=4096)
def packed_pair(name: str, value: str) -> bytes:
    """One user property as packets have it."""
    return USER_PROPERTY + packed_text(name) + packed_text(value)


@lru_cache(maxsize=4096)
def packed_text(text: str) -> bytes:
    """A text as packets have it, behind the number of its octets."""
    octets = text.encode()
    return len(octets).to_bytes(2, "big") + octets


class SectorStamp:
    """A sector as its messages tell of it: the numbers of scan and sector, and its end, UTC."""

    __slots__ = ("_octets", "end_ns", "index", "scan")

    def __init__(self, scan: int, index: int, end_ns: int) -> None:
        self.scan, self.index, self.end_ns = scan, index, end_ns
        self._octets: tuple[bytes, bytes, bytes] | None = None

    def octets(self, sensor: bytes) -> tuple[bytes, bytes]:
        """Part of an id, and the properties of its sensor and its own, worked out once."""
        if self._octets is None or self._octets[0] is not sensor:
            scan, index, time = str(self.scan), str(self.index), iso_utc(self.end_ns).encode()
            length = len(time).to_bytes(2, "big")
            place = packed_pair("scan", scan), packed_pair("sector", index)
            of_sector = b"".join((_TIME, length, time, sensor, *place))
            self._octets = (sensor, f"{scan}-{index}-".encode(), of_sector)
        return self._octets[1:]


_TIME, _ID = (USER_PROPERTY + packed_text(name) for name in ("time", "id"))


class Address:
    """Where messages of one sensor and kind go, and what all of them say of themselves."""

    __slots__ = (
        "_behind_id",
        "_id",
        "_sensor",
        "content_type",
        "event",
        "kind",
        "qos",
        "sensor",
        "topic",
    )

    def __init__(self, source: str, sensor: str, kind: str, content_type: str, qos: int) -> None:
        """`source` is what comes before the kind in the topic."""
        self.topic = f"{source}/{kind}"
        self.content_type = content_type
        self.qos = qos
        self.kind = dashed(kind)
        self.sensor = ("sensor", sensor)
        self.event = (("type", type_of(kind)), ("specversion", "1.0"), ("source", source))
        self._id = f"{self.kind}-".encode()
        self._behind_id = b"".join(packed_pair(*pair) for pair in self.event)
        self._sensor = packed_pair(*self.sensor)

    def octets(self, stamp: SectorStamp, number: int) -> tuple[bytes, bytes, bytes]:
        """The properties of a message of a sector as packets have them, in pieces."""
        sector, of_sector = stamp.octets(self._sensor)
        name = b"%b%b%d" % (self._id, sector, number)
        return _ID + len(name).to_bytes(2, "big") + name, self._behind_id, of_sector


class SectorProperties(Sequence[Pair]):
    """The properties of a message of a sector, as CloudEvents attributes, in their order.

    `number` tells those of one kind and sector apart.
    """

    __slots__ = ("address", "number", "stamp")

    def __init__(self, address: Address, stamp: SectorStamp, number: int) -> None:
        self.address, self.stamp, self.number = address, stamp, number

    def pairs(self) -> tuple[Pair, ...]:
        """All of them."""
        address, stamp = self.address, self.stamp
        return (
            ("id", f"{address.kind}-{stamp.scan}-{stamp.index}-{self.number}"),
            *address.event,
            ("time", iso_utc(stamp.end_ns)),
            address.sensor,
            ("scan", str(stamp.scan)),
            ("sector", str(stamp.index)),
        )

    def octets(self) -> tuple[bytes, bytes, bytes]:
        """All of them as packets have them, in pieces."""
        return self.address.octets(self.stamp, self.number)

    def __len__(self) -> int:
        """How many there are."""
        return 8

    @overload
    def __getitem__(self, place: int) -> Pair: ...

    @overload
    def __getitem__(self, place: slice) -> tuple[Pair, ...]: ...

    def __getitem__(self, place: int | slice) -> Pair | tuple[Pair, ...]:
        """Pairs at a place."""
        return self.pairs()[place]

    def __iter__(self) -> Iterator[Pair]:
        """One after the other."""
        return iter(self.pairs())

    def __eq__(self, other: object) -> bool:
        """Whether the other has the same pairs, whatever holds them."""
        if isinstance(other, SectorProperties | tuple):
            return self.pairs() == tuple(other)
        return NotImplemented

    def __hash__(self) -> int:
        return hash(self.pairs())

    def __repr__(self) -> str:
        return repr(self.pairs())


def packed(properties: Sequence[Pair]) -> bytes:
    """Properties as packets have them."""
    return b"".join(pieces_of(properties))


def pieces_of(properties: Sequence[Pair]) -> Sequence[bytes]:
    """Properties as packets have them, in pieces that are to be joined."""
    if isinstance(properties, SectorProperties):
        return properties.octets()
    return [packed_pair(name, value) for name, value in properties]
