"""Settings of sensors as the page shows them: what is in force, and what links are to make."""

from __future__ import annotations

import numpy as np

from plotfeed.feeds.link.delays import DelayLaw
from plotfeed.feeds.link.losses import chain_of
from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.sensors import Sensor

PROBABILITIES = np.linspace(0, 1, 1001)


def tell_settings(view: View, sensor: Sensor, since_utc_ns: int, *, new_model: bool) -> None:
    """Show a sensor as it is since then, and the delays that its link is to make."""
    link = sensor.link or LinkSettings()
    law = DelayLaw.of(link)
    view.cover(sensor)
    view.settings(
        sensor.id,
        sensor.model_dump(mode="json", exclude_unset=True, exclude={"event", "scan"}),
        asked_latency_ms=law.quantile_ms(PROBABILITIES),
        asked_loss=None if link.on_loss == "stall" else chain_of(link.loss),
        since_utc_ns=since_utc_ns,
        new_model=new_model,
    )


def model_differs(before: Sensor, now: Sensor) -> bool:
    """Tell whether anything but the link is different."""
    link = {"link", "event"}
    return before.model_dump(exclude=link) != now.model_dump(exclude=link)
