"""What sensors of a group report of drones that their beams do not point at, sector by sector."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Self

import numpy as np

from plotfeed.feeds.sensing.false_alarms_due import OfSensor
from plotfeed.models.beam import Sectors
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.movers import other_name
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.sidelobe_echoes import SIDELOBE, sidelobe_plots
from plotfeed.models.truth import Trajectories


class SidelobeLooks:
    """Sensors that report what comes by their side lobes, by their index; at least one."""

    def __init__(
        self, radars: Mapping[int, PolarRadar], whose: Mapping[int, int], chances: Sequence[Chance]
    ) -> None:
        """`whose` are rows among drones in which the plots of each stand."""
        self._radars, self._whose, self._chances = radars, whose, chances

    @classmethod
    def of(
        cls,
        models: Mapping[int, SensorModel],
        names: Sequence[str],
        trajectories: Trajectories,
        chances: Sequence[Chance],
    ) -> Self | None:
        """Looks of such sensors; None if there are none. Each gets a name among the drones."""
        radars = {
            i: model
            for i, model in models.items()
            if isinstance(model, PolarRadar) and model.shows_sidelobes
        }
        if not radars:
            return None
        whose = {i: trajectories.add_other(other_name(SIDELOBE, names[i])) for i in radars}
        return cls(radars, whose, chances)

    def plots(self, sectors: Sectors, targets_of: Callable[[Sectors], Targets]) -> list[OfSensor]:
        """Plots of sectors, by sensor; `targets_of` gives targets at the end of one of them."""
        found = []
        for k, sensor in enumerate(sectors.sensor.tolist()):
            if sensor not in self._radars:
                continue
            one = sectors.rows(np.array([k]))
            sector = one.one(0)
            rng = self._chances[sensor].rng(Purpose.SIDELOBES, sector.scan, sector.index)
            plots = sidelobe_plots(
                self._radars[sensor], targets_of(one), sector, self._whose[sensor], rng
            )
            if len(plots):
                found.append((sensor, plots))
        return found
