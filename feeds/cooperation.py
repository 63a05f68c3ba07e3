"""The keys of drones that say by radio where they are, and whether a scene's drones can."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from plotfeed.feeds.impairment.settings import Link
from plotfeed.feeds.parts import Name, Part

COOPERATIVE = "cooperative"
"""What stands in place of a sensor's id: in topics, and in the `sensors` of a [[udp]]."""
MAX_SERIAL = 12


class Cooperation(Part):
    """Drones of the scene that report themselves, as ASTERIX 129."""

    drones: Annotated[tuple[Name, ...], Field(strict=False)] = ()
    """Their ids; without it, all that the scene flies itself."""
    period_s: Annotated[float, Field(ge=0.05, le=3600)] = 1.0
    """Of their reports, which come at whole multiples of it."""
    sac: Annotated[int, Field(ge=0, le=255)] = 0
    sic: Annotated[int, Field(ge=0, le=255)] = 0
    """Of their reports; the standard wants 0 and 0 for what comes from the air."""
    country: Annotated[str, Field(pattern=r"^[A-Z]{2}$")] = "ZZ"
    """Of registration: two letters of ISO 3166, of which ZZ is nobody's."""
    accuracy_m: Annotated[float, Field(ge=0, le=200)] = 0.0
    """Standard deviation of the error that they make east, north and up, each time anew."""
    link: Link | None = None
    """Between the drones and whoever hears them."""

    def those_of(self, flown: Sequence[str]) -> Sequence[str]:
        """The ids of the cooperative ones."""
        return self.drones or flown

    def problem(self, flown: Sequence[str], geoid_undulation_m: float | None) -> str | None:
        """Why the drones that a scene flies cannot report so, if they cannot."""
        if geoid_undulation_m is None:
            return "needs telemetry.geoid_undulation_m: ASTERIX 129 counts from mean sea level"
        for drone in self.those_of(flown):
            if drone not in flown:
                return f"the scene flies no drone {drone!r}"
            if not drone.isascii() or len(drone) > MAX_SERIAL:
                return (
                    f"the id {drone!r} becomes the serial number, "
                    f"which ASTERIX 129 holds up to {MAX_SERIAL} characters of ASCII"
                )
        return None
