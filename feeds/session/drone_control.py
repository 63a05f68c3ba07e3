"""Commands for drones that the scene flies: what happens to them, and what they say."""

from __future__ import annotations

from typing import Any

from plotfeed.feeds.scene.changes import Command, ControlError
from plotfeed.feeds.sensing.cooperative_drones import CooperativeDrones
from plotfeed.feeds.sensing.scene_drones import SceneDrones
from plotfeed.proto.errors import PlotfeedError


class DroneControl:
    """The drones of a session, as commands reach them."""

    def __init__(self, drones: SceneDrones, cooperative: CooperativeDrones | None) -> None:
        """`cooperative` are those that say something of themselves, if any do."""
        self._drones = drones
        self._cooperative = cooperative

    def obey(self, command: Command, at_utc_ns: int) -> dict[str, Any]:
        """Do what a command of a drone asks, from then on, and say what is in force.

        Raises `ControlError`.
        """
        drone = command.drone or ""
        if drone not in self._drones.names:
            known = ", ".join(self._drones.names[:MAX_NAMES]) or "none"
            raise ControlError(f"drone: the scene flies no {drone!r}; expected one of {known}")
        if command.contingency is not None:
            try:
                self._drones.happen(drone, command.contingency, at_utc_ns)
            except PlotfeedError as error:
                raise ControlError(f"contingency: {error}") from None
        else:
            if self._cooperative is None or drone not in self._cooperative:
                raise ControlError(f"claim: drone {drone!r} says nothing: it is not [cooperative]")
            self._cooperative.control(drone, command.claim, at_utc_ns)
        claim = None if command.claim is None else command.claim.model_dump(exclude_unset=True)
        return {
            "drone": drone,
            "contingency": self._drones.doing(drone, at_utc_ns),
            **({} if command.contingency is not None else {"claim": claim}),
        }


MAX_NAMES = 20
"""Of drones, told where another was expected."""
