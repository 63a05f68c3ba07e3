"""All that a ledger says of one sensor."""

from __future__ import annotations

from plotfeed.feeds.ledger_report.alarms import AlarmsTally, AskedAlarms
from plotfeed.feeds.ledger_report.errors_tally import ErrorsTally
from plotfeed.feeds.ledger_report.in_turn import Turn
from plotfeed.feeds.ledger_report.link_tally import LinkTally, Setting
from plotfeed.feeds.ledger_report.looks_tally import LooksTally
from plotfeed.feeds.ledger_report.passage import Passage
from plotfeed.proto import plotfeed_pb2 as pb

MAX_LINKS = 100
"""Settings of one sensor's link; what is under further ones is not told."""


class SensorTally:
    """Takes its entries one after the other."""

    def __init__(self, prefix: str, sensor: str, asked_alarms: AskedAlarms | None) -> None:
        self.prefix = prefix
        self.sensor = sensor
        self.entries = 0
        self.plots = 0
        """Of drones, by the ledger."""
        self.links: dict[str, LinkTally] = {}
        """By the JSON of their keys, in the order in which they came into force."""
        self.left_out = 0
        """Entries under settings that were too many."""
        self.passage = Passage()
        self.looks = LooksTally()
        self.errors = ErrorsTally()
        self.alarms = AlarmsTally(asked_alarms)
        self._numbers: dict[str, int] = {}

    def add(self, entry: pb.Ledger) -> None:
        """Take a sector."""
        self.entries += 1
        self.looks.add(entry.looks)
        drones = sum(bool(plot.drone) for plot in entry.plots)
        self.plots += drones
        self.alarms.add(len(entry.plots) - drones, entry.scan, entry.sector)
        link = self._link(entry.link)
        if link is None:
            self.left_out += 1
        else:
            self._take_messages(entry, link)

    def end(self) -> None:
        """There are no more."""
        self.passage.end()
        self.looks.count()
        self.errors.count()
        for link in self.links.values():
            link.count()

    def _link(self, text: str) -> LinkTally | None:
        link = self.links.get(text)
        if link is None and len(self.links) < MAX_LINKS:
            self._numbers[text] = len(self.links)
            link = self.links[text] = LinkTally(Setting.of(text))
        return link

    def _take_messages(self, entry: pb.Ledger, link: LinkTally) -> None:
        row = self._numbers[entry.link]
        for sent in entry.messages:
            fate = sent.fate or (pb.SENT if sent.delivered else pb.FATE_UNSPECIFIED)
            link.add(sent, fate)
            if not sent.copy:
                self.passage.add(Turn(sent.number, sent.due_utc_ns, sent.sent_utc_ns, fate, row))
