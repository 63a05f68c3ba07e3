"""The second file: what a scene says of a lookout, and the traits that tell what it is.

Where it is imported, scenes can name a lookout.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from toy_sensor.lookout_model import Lookout

from plotfeed.feeds.scene.fields import Positive
from plotfeed.feeds.scene.sensors import register
from plotfeed.feeds.scene.sensors.scan_keys import StaringScan
from plotfeed.feeds.scene.sensors.sensor_keys import AzimuthCoverKeys, Reports, SensorGeometry


@register
class LookoutKeys(AzimuthCoverKeys):
    """Somebody with a telescope."""

    label = "lookout"
    geometry = SensorGeometry.BEARINGS
    sapient_type = "OTHER"
    makes = Lookout
    formats = ("asterix-015", "asterix-205", "plots", "sapient")

    type: Literal["lookout"]
    report: Reports = ()
    """Without it, plots."""
    scan: StaringScan
    range_max_m: Positive
    """Nothing further away is seen."""
    sigma_deg: Annotated[float, Field(gt=0, le=10)] = 0.1
    """Of the errors of azimuth and elevation."""
