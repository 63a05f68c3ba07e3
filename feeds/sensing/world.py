"""What of the world a scene names, about each of its sensors."""

from __future__ import annotations

from dataclasses import replace

from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.effects.echo_effects import EchoEffects
from plotfeed.models.effects.jamming import Jamming, behind
from plotfeed.models.effects.surroundings import OnTheWay, Surroundings
from plotfeed.models.sensors.echo_radar import EchoRadar
from plotfeed.models.sensors.rf_receiver import RfReceiver
from plotfeed.models.sensors.sensor_model import SensorModel


def _behind(effects: EchoEffects, way: OnTheWay) -> EchoEffects:
    """Effects of which jammers come by that way."""
    met = tuple(
        replace(effect, jammers=behind(effect.jammers, way))
        if isinstance(effect, Jamming)
        else effect
        for effect in effects.in_the_world
    )
    return replace(effects, in_the_world=met)


SUNK_M = 1.0
"""By which rasters and masts may disagree about the ground."""


class World:
    """The surroundings of sensors; of a scene that names none, nothing."""

    def __init__(self, scene: Scene) -> None:
        """Raises `PlotfeedError` for a file without use."""
        self._site = scene.scene.site
        self._horizons = None
        if scene.terrain is not None:
            from plotfeed.feeds.sensing.horizons import Horizons

            self._horizons = Horizons(scene, scene.terrain)

    def model_of(self, sensor: Sensor) -> SensorModel:
        """The model of a sensor where it stands; raises `PlotfeedError`."""
        model = sensor.model(self._site)
        if self._horizons is None:
            return model
        obstruction = self._horizons.around(sensor, model)
        model = replace(model, surroundings=Surroundings((obstruction,)))
        if isinstance(model, RfReceiver):
            return replace(model, jammers=behind(model.jammers, obstruction))
        if isinstance(model, EchoRadar) and model.echo_effects is not None:
            return replace(model, echo_effects=_behind(model.echo_effects, obstruction))
        return model

    def warnings(self, sensor: Sensor) -> list[str]:
        """What is legal and still looks wrong, for `check`."""
        if self._horizons is None:
            return []
        above_m = self._horizons.ground_above_m(sensor)
        if not above_m > SUNK_M:
            return []
        return [
            f"it stands {above_m:.0f} m below the ground of terrain.elevation, and sees little: "
            "are heights above sea level taken for heights above the ellipsoid?"
        ]
