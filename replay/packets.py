"""Captured packets as messages: what pcap and pcapng have in common."""

from __future__ import annotations

from functools import lru_cache

from plotfeed.proto.errors import DecodeError
from plotfeed.replay.asterix_payload import content_type
from plotfeed.replay.damages import Damages
from plotfeed.replay.kept_packet import properties_of
from plotfeed.replay.link_layers import LINK_TYPES, datagram_in
from plotfeed.replay.pcap_header import PcapHeader
from plotfeed.replay.recorded import Recorded
from plotfeed.replay.times import LATEST_NS

UDP_TOPIC = "udp/"
SOURCE = "udp-source"
"""The property that says who sent a datagram: ADDRESS/PORT."""


class Packets:
    """Makes messages of packets; notes those that are broken and counts those that are not UDP."""

    def __init__(self) -> None:
        self.damage = Damages()
        self.skipped = 0
        """Packets that hold no UDP."""

    def check_link_type(self, link_type: int, at: int) -> None:
        """Note at that offset that none of its packets can be read."""
        if link_type not in LINK_TYPES:
            expected = ", ".join(map(str, LINK_TYPES))
            self.damage.add(at, f"packets of link type {link_type}; expected one of {expected}")

    def message(
        self, header: PcapHeader, packet: bytes, length: int, t_utc_ns: int, at: int
    ) -> Recorded | None:
        """The message in a packet that was captured at that time; None if it has none.

        `header` is of a pcap that holds it, `length` its octets before it was cut.
        """
        try:
            found = datagram_in(header.link_type, packet)
        except DecodeError as error:
            self.damage.add(at, str(error))
            return None
        if found is None:
            self.skipped += 1
            return None
        if not 0 <= t_utc_ns <= LATEST_NS:
            self.damage.add(at, f"a packet of {t_utc_ns} ns since 1970; expected 1970 to 2554")
            return None
        return Recorded(
            topic=_topic(found.destination, found.port),
            payload=found.payload,
            log_time_ns=t_utc_ns,
            publish_time_ns=t_utc_ns,
            content_type=content_type(found.payload),
            properties=(
                *_properties(found.source, found.source_port),
                *properties_of(header, packet, length, found),
            ),
        )


@lru_cache(maxsize=4096)
def _topic(address: str, port: int) -> str:
    return f"{UDP_TOPIC}{address}/{port}"


@lru_cache(maxsize=4096)
def _properties(address: str, port: int) -> tuple[tuple[str, str], ...]:
    return ((SOURCE, f"{address}/{port}"),)
