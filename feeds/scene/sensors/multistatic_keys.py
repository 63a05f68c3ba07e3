"""The keys of passive and MIMO radars of several receivers, whose plots are places."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from plotfeed.feeds.scene.fields import Location, Name, Positive, Site
from plotfeed.feeds.scene.sensors.effect_keys import refused_bias
from plotfeed.feeds.scene.sensors.passive_radar_keys import PassiveRadarKeys
from plotfeed.feeds.scene.sensors.polar_radar_keys import MimoRadarKeys
from plotfeed.feeds.scene.sensors.sensor_keys import (
    SensorGeometry,
    SensorKeys,
    TrackingSensorKeys,
    long_integration,
)
from plotfeed.models.sensors.multistatic import MultistaticRadar, Receiver

FEWEST_PAIRS = 3
MOST_PAIRS = 32
# Of one receiver alone.
NOT_MODELLED = (
    *("doppler", "merging", "antenna", "straddling", "drift", "tracks", "weather", "jamming"),
    "classifier",
    "pulses",
)


class ReceiverKeys(Location):
    """Another receiver of the same kind, and the place of its antenna."""

    id: Name
    """For people."""


Receivers = Annotated[tuple[ReceiverKeys, ...], Field(strict=False, max_length=31)]
Fewest = Annotated[int, Field(ge=FEWEST_PAIRS, le=MOST_PAIRS)]


class SeveralReceiversKeys(TrackingSensorKeys):
    """A radar whose plots are places by all pairs of its receivers with its transmitters."""

    if TYPE_CHECKING:
        transmitters: tuple[Any, ...]

    receivers: Receivers = ()
    """Beside the one at the sensor's place."""
    fewest_pairs: Fewest = FEWEST_PAIRS
    """Of which detections make a place."""

    def _refusals(self) -> Iterator[str]:
        transmitters = len(self.transmitters)
        pairs = (len(self.receivers) + 1) * transmitters
        if not self.fewest_pairs <= pairs <= MOST_PAIRS:
            yield (
                f"receivers: with {transmitters} transmitters they make {pairs} pairs; a place "
                f"takes {self.fewest_pairs}, and at most {MOST_PAIRS} are joined"
            )
        for name in NOT_MODELLED:
            if name in self.model_fields_set and getattr(self, name, None) is not None:
                yield f"{name}: not modelled of several receivers"
        yield from refused_bias(self.bias, "several receivers", ("time_offset_s",))

    def model(self, site: Site, /) -> MultistaticRadar:
        """The model of all receivers, by the signals of the first, which is the sensor."""
        signals: Any = super().model(site)
        places = [(0.0, 0.0, 0.0), *(self.offset_enu_m(site, each) for each in self.receivers)]
        receivers = []
        for place in places:
            seen = []
            for each in signals.transmitters:
                east_m, north_m, up_m = (
                    float(a - b) for a, b in zip(each.position_enu_m, place, strict=True)
                )
                seen.append(replace(each, position_enu_m=(east_m, north_m, up_m)))
            changes: dict[str, Any] = {"transmitters": tuple(seen)}
            receivers.append(Receiver(signals=replace(signals, **changes), place_enu_m=place))
        return self.made(MultistaticRadar, receivers=tuple(receivers))


class MultistaticPassiveKeys(SeveralReceiversKeys, PassiveRadarKeys):
    """A passive radar of several receivers: plots are places by all pairs with transmitters."""

    label = "multistatic passive radar"
    geometry = SensorGeometry.MONOSTATIC
    formats = ("asterix-015", "plots", "sapient")

    type: Literal["multistatic_passive"]  # type: ignore[assignment]
    sigma_height_m: Positive = 35.0
    """Standard deviation of heights of drones about expected_height_m."""

    illuminators = SensorKeys.illuminators

    def warnings(self, _site: Site, /) -> Iterator[str]:
        """Odd accuracies, and an integration longer than a scan: baselines blind pairs alone."""
        yield from long_integration(self.integration_s, self.scan)
        yield from self._odd_values()


class MultistaticMimoKeys(SeveralReceiversKeys, MimoRadarKeys):
    """A MIMO radar of several receivers: plots are places by all pairs with transmitters."""

    label = "multistatic MIMO radar"
    formats = ("asterix-015", "plots", "sapient")

    type: Literal["multistatic_mimo"]  # type: ignore[assignment]
    expected_height_m: Annotated[float, Field(ge=-10_000, le=50_000)] = 60.0
    """Of drones above the sensor, counted as a measurement beside the others."""
    sigma_height_m: Positive = 35.0
    """Standard deviation of such heights."""

    def warnings(self, _site: Site, /) -> Iterator[str]:
        """Odd accuracies, cells without false alarms, and an integration longer than a scan."""
        yield from long_integration(self.integration_s, self.scan)
        yield from self._odd_values()
        yield from self._few_cells()
