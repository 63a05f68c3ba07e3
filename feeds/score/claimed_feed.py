"""A sensor's feed as a tracker sees it, beside the truth and what the sensor claims.

Claims are what the sensor takes itself to do: standing right, with its clock right, undegraded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from plotfeed.feeds.report.asked_sensors import AskedSensor
from plotfeed.models.sensors.sensor_model import SensorModel
from plotfeed.models.state import Bools, Columns, Floats, Ints
from plotfeed.proto.measured_plots import MeasuredPlots


class BelievedSensor(AskedSensor):
    """A sensor as it takes itself to be."""

    @classmethod
    def by(cls, asked: AskedSensor) -> BelievedSensor:
        """What a sensor that was asked for takes itself to be."""
        right = asked.keys.model_copy(update={"bias": None, "drift": None, "degradation": None})
        return cls(right, asked.site, asked.chance, asked.sea_level)


def left_of_pd(asked: AskedSensor | None) -> float:
    """What of its claimed Pd a sensor has."""
    if asked is None or asked.keys.degradation is None:
        return 1.0
    return asked.keys.degradation.pd_factor


@dataclass(frozen=True, kw_only=True)
class ClaimedLooks(Columns):
    """Looks at targets, (n,): where they truly were, by the sensor, and the Pd that is claimed.

    `sector` and `target` are numbers; a look counts for Pd if it `counts`.
    """

    sector: Ints
    channel: Ints
    target: Ints
    t_utc_ns: Ints
    range_m: Floats
    azimuth_deg: Floats
    elevation_deg: Floats
    pd: Floats
    counts: Bools


class SensorFeed(NamedTuple):
    """What came of a sensor, by sectors with numbers from 0, and what it claims."""

    looks: ClaimedLooks
    """In the order of sectors."""
    plots: MeasuredPlots
    plot_sector: Ints
    """The sector of each plot, ascending."""
    keys_of_sector: Ints
    """Which of `believed` holds in each sector."""
    believed: Sequence[BelievedSensor | None]
    """None where no scene says what is claimed but the plots."""
    scans: float
    """That were seen, parts of one counted as such."""
    why_no_clutter: str = ""
    """Why false alarms are not judged."""

    @property
    def known(self) -> BelievedSensor | None:
        """The sensor as its scene first has it; None where none says."""
        return next((each for each in self.believed if each is not None), None)

    @property
    def model(self) -> SensorModel | None:
        """The model of the sensor as its scene first has it; None where none says."""
        return None if self.known is None else self.known.model
