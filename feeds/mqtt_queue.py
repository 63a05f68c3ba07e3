"""The scene's settings of what waits for a broker that is away or busy."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from plotfeed.feeds.parts import Part, Positive

USUAL_MESSAGES = (0, 10_000)
"""Of QoS 0, of which a late one is worth nothing, and of QoS 1."""


class MqttQueue(Part):
    """What waits for a broker that is away, stalled, or slow to acknowledge; for each sensor."""

    policy: Literal["drop-oldest", "drop-newest", "wait"] = "drop-oldest"
    """What gives way when as much waits as may: the oldest, what comes, or the session, which
    stands still until there is room."""
    messages: Annotated[int, Field(ge=0, le=1_000_000)] | None = None
    """How many may wait, of each QoS; without it, 10,000 of QoS 1 and none of QoS 0, since a late
    plot is worth nothing."""
    max_age_s: Positive | None = None
    """What has waited longer is dropped; without it, nothing is for its age."""

    def limit(self, qos: int) -> int:
        """How many messages of a QoS may wait."""
        return USUAL_MESSAGES[qos] if self.messages is None else self.messages
