"""The keys of passive and MIMO radars of several receivers, whose plots are places."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import Location, Name, Positive, Site, enu_from, frame_at
from plotfeed.feeds.scene.sensors.effect_keys import refuse_bias
from plotfeed.feeds.scene.sensors.mimo_radar_keys import MimoRadarKeys
from plotfeed.feeds.scene.sensors.passive_radar_keys import PassiveRadarKeys
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry, SensorKeys, long_integration
from plotfeed.models.sensors.active_radar import MimoRadar
from plotfeed.models.sensors.multistatic import MultistaticRadar, Receiver
from plotfeed.models.sensors.passive_radar import PassiveRadar

FEWEST_PAIRS = 3
MOST_PAIRS = 32
NOT_MODELLED = (
    *("doppler", "merging", "antenna", "straddling", "drift", "tracks", "weather", "jamming"),
    "classifier",
    "pulses",
)
"""Of one receiver alone."""


class ReceiverKeys(Location):
    """Another receiver of the same kind, and the place of its antenna."""

    id: Name
    """For people."""


Receivers = Annotated[tuple[ReceiverKeys, ...], Field(strict=False, max_length=31)]
Fewest = Annotated[int, Field(ge=FEWEST_PAIRS, le=MOST_PAIRS)]


def refuse_what_cannot_be(keys: SensorKeys, receivers: int, transmitters: int, fewest: int) -> None:
    """Raise ValueError for too few pairs or too many, and for keys of one receiver alone."""
    pairs = receivers * transmitters
    if not fewest <= pairs <= MOST_PAIRS:
        raise ValueError(
            f"receivers: with {transmitters} transmitters they make {pairs} pairs; a place takes "
            f"{fewest}, and at most {MOST_PAIRS} are joined"
        )
    for name in NOT_MODELLED:
        if name in keys.model_fields_set and getattr(keys, name, None) is not None:
            raise ValueError(f"{name}: not modelled of several receivers")
    refuse_bias(keys.bias, "several receivers", ("time_offset_s",))


def places_m(
    keys: SensorKeys, receivers: tuple[ReceiverKeys, ...], site: Site
) -> list[tuple[float, float, float]]:
    """Places of receivers, east, north and up of the sensor, which is the first."""
    frame = frame_at(site, keys.position_enu_m)
    found = [(0.0, 0.0, 0.0)]
    for each in receivers:
        east_m, north_m, up_m = enu_from(frame, site, each)
        found.append((float(east_m), float(north_m), float(up_m)))
    return found


def receivers_of(
    signals: PassiveRadar | MimoRadar, places: list[tuple[float, float, float]]
) -> tuple[Receiver, ...]:
    """Receivers at places by the signals of the first, each with transmitters as it sees them."""
    found = []
    for place in places:
        seen = []
        for each in signals.transmitters:
            east_m, north_m, up_m = (
                float(a - b) for a, b in zip(each.position_enu_m, place, strict=True)
            )
            seen.append(replace(each, position_enu_m=(east_m, north_m, up_m)))
        changes: dict[str, Any] = {"transmitters": tuple(seen)}
        found.append(Receiver(signals=replace(signals, **changes), place_enu_m=place))
    return tuple(found)


def joined_model(
    keys: Any, signals: PassiveRadar | MimoRadar, places: list[tuple[float, float, float]]
) -> MultistaticRadar:
    """The model of receivers at places by the signals of the first."""
    converted = {
        "azimuth_cover": keys.azimuth_cover,
        "receivers": receivers_of(signals, places),
    }
    return MultistaticRadar(**keys.by_name(MultistaticRadar) | converted)


class MultistaticPassiveKeys(PassiveRadarKeys):
    """A passive radar of several receivers: by all pairs with transmitters, plots are places.

    It has the keys of a passive radar; what it expects of heights counts as a measurement.
    """

    label = "multistatic passive radar"
    geometry = SensorGeometry.MONOSTATIC
    formats = ("asterix-015", "plots", "sapient")

    type: Literal["multistatic_passive"]  # type: ignore[assignment]
    """Which model."""
    receivers: Receivers = ()
    """Beside the one at the sensor's place."""
    fewest_pairs: Fewest = FEWEST_PAIRS
    """Of which detections make a place."""
    sigma_height_m: Positive = 35.0
    """Standard deviation of heights of drones about expected_height_m."""

    illuminators = SensorKeys.illuminators

    @model_validator(mode="after")
    def _makes_places(self) -> Self:
        n = len(self.receivers) + 1
        refuse_what_cannot_be(self, n, len(self.transmitters), self.fewest_pairs)
        return self

    def model(self, site: Site, /) -> MultistaticRadar:  # type: ignore[override]
        """The model of all receivers."""
        return joined_model(self, super().model(site), places_m(self, self.receivers, site))

    def warnings(self, _site: Site, /) -> list[str]:
        """Odd accuracies, and an integration longer than a scan: baselines blind pairs alone."""
        return [*long_integration(self.integration_s, self.scan), *self._odd_values()]


class MultistaticMimoKeys(MimoRadarKeys):
    """A MIMO radar of several receivers: by all pairs with transmitters, plots are places.

    It has the keys of a MIMO radar; each pair detects by itself.
    """

    label = "multistatic MIMO radar"
    formats = ("asterix-015", "plots", "sapient")

    type: Literal["multistatic_mimo"]  # type: ignore[assignment]
    """Which model."""
    receivers: Receivers = ()
    """Beside the one at the sensor's place."""
    fewest_pairs: Fewest = FEWEST_PAIRS
    """Of which detections make a place."""
    expected_height_m: Annotated[float, Field(ge=-10_000, le=50_000)] = 60.0
    """Of drones above the sensor, counted as a measurement beside the others."""
    sigma_height_m: Positive = 35.0
    """Standard deviation of such heights."""

    @model_validator(mode="after")
    def _makes_places(self) -> Self:
        n = len(self.receivers) + 1
        refuse_what_cannot_be(self, n, len(self.transmitters), self.fewest_pairs)
        return self

    def model(self, site: Site, /) -> MultistaticRadar:  # type: ignore[override]
        """The model of all receivers."""
        return joined_model(self, super().model(site), places_m(self, self.receivers, site))

    def warnings(self, _site: Site, /) -> list[str]:
        """Odd accuracies, cells without false alarms, and an integration longer than a scan."""
        found = long_integration(self.integration_s, self.scan)
        return [*found, *self._odd_values(), *self._few_cells()]
