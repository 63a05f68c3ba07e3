"""A link of a replay: it draws as at the recorded times, whenever they come again."""

from __future__ import annotations

from plotfeed.feeds.impairment.settings import Link
from plotfeed.feeds.impairment.stage import Copy, Impairment, Outcome


class ReplayImpairment(Impairment):
    """The impairment of a session, `later_ns` later, so that chance is the same in each replay."""

    def __init__(self, link: Link, seed: int, name: str, *, later_ns: int) -> None:
        super().__init__(link, seed, name)
        self._later_ns = later_ns

    def pass_on(self, due_utc_ns: int, octets: int) -> Outcome:
        """What becomes of a message that is due then."""
        outcome = super().pass_on(due_utc_ns - self._later_ns, octets)
        copies = (Copy(c.due_utc_ns + self._later_ns, c.flipped_bit) for c in outcome.copies)
        return Outcome(outcome.fate, tuple(copies))
