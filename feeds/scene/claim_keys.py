"""What drones of the scene say of themselves: in which formats, how well, and how wrongly."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Literal

from pydantic import Field

from plotfeed.feeds.scene.fields import Enu, Location, Name, NotNegative, Positive, SceneTable
from plotfeed.feeds.scene.link_keys import LinkSettings

# What stands in place of a sensor's id: in topics, and in the `sensors` of a [[udp]].
COOPERATIVE = "cooperative"
CLAIMED = "claimed"  # The level of topics after the prefix on which drones claim where they are
MAX_SERIAL = 12
ClaimFormat = Literal["asterix-129", "json", "protobuf"]


class SpoofKeys(Location):
    """The place to which a spoofed receiver believes to be taken."""

    drag_m_s: Annotated[float, Field(ge=0.01, le=500)] | None = None
    """How fast it is drawn off from where it is; without it, at once."""


class ClaimFault(SceneTable):
    """What a drone says of itself wrongly for a while; the truth stays."""

    from_s: NotNegative | None = None
    """When it begins, after the session has. On control it is left out: it begins at once."""
    to_s: Positive | None = None
    """When it is over; without it, never."""
    drop_out: Annotated[float, Field(ge=0, le=1)] = 0.0
    """The probability that a report is not said at all, each by itself."""
    delay_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    """It says where it was so long ago, with the time of that."""
    bias_enu_m: Enu = (0.0, 0.0, 0.0)
    """Error of the position, east, north and up."""
    walk_m: NotNegative = 0.0
    """A random walk of the position: standard deviation along each axis after a second, growing
    with the square root of time."""
    freeze: bool = False
    """It says where it was and how it flew when this began, with the time of now."""
    spoof: SpoofKeys | None = None
    """It believes to be elsewhere; bias and walk come on top."""

    def _refusals(self) -> Iterator[str]:
        if self.to_s is not None and self.to_s <= (self.from_s or 0.0):
            yield "to_s: must be above from_s"
        if self.freeze and self.spoof is not None:
            yield "freeze: what is frozen cannot be spoofed; give one of both"
        if not self.names:
            yield "drop_out, delay_s, bias_enu_m, walk_m, freeze or spoof is needed"

    @property
    def names(self) -> tuple[str, ...]:
        """The keys that make what is said otherwise, such as bias or freeze, for the ledger."""
        kinds = {
            "drop_out": self.drop_out,
            "delay": self.delay_s,
            "bias": any(self.bias_enu_m),
            "walk": self.walk_m,
            "freeze": self.freeze,
            "spoof": self.spoof is not None,
        }
        return tuple(name for name, value in kinds.items() if value)


class CooperativeKeys(SceneTable):
    """Drones that report themselves, as ASTERIX 129 or telemetry."""

    drones: Annotated[tuple[Name, ...], Field(strict=False)] = ()
    """Their ids, and those of swarms; without it, all that the scene flies."""
    report: Annotated[tuple[ClaimFormat, ...], Field(strict=False, min_length=1)] = ("asterix-129",)
    """asterix-129, and json or protobuf: `plotfeed.v1.Telemetry` on {prefix}/claimed/{drone}."""
    period_s: Annotated[float, Field(ge=0.05, le=3600)] = 1.0
    """Of their reports, which come at whole multiples of it."""
    sac: Annotated[int, Field(ge=0, le=255)] = 0
    sic: Annotated[int, Field(ge=0, le=255)] = 0
    """Of their reports; 0 and 0 is the standard's for airborne senders."""
    country: Annotated[str, Field(pattern=r"^[A-Z]{2}$")] = "ZZ"
    """Of registration: two letters of ISO 3166, of which ZZ is nobody's."""
    accuracy_m: Annotated[float, Field(ge=0, le=200)] = 0.0
    """Standard deviation of each report's error, east, north and up."""
    link: LinkSettings | None = None
    """Between the drones and whoever hears them."""

    def _refusals(self) -> Iterator[str]:
        if len(set(self.report)) < len(self.report) or {"json", "protobuf"} <= set(self.report):
            yield "report: each format once, and one of json and protobuf"

    def those_of(self, flown: Sequence[str], swarms: Mapping[str, Sequence[str]]) -> list[str]:
        """The ids of the cooperative ones, of all that fly; swarms are known by their ids, too."""
        wanted = self.drones or flown
        return [drone for name in wanted for drone in swarms.get(name, (name,))]

    def problem(self, flown: Sequence[str], swarms: Mapping[str, Sequence[str]]) -> str | None:
        """Why the drones that a scene flies cannot report so, if they cannot."""
        for drone in self.those_of(flown, swarms):
            if drone not in flown:
                return f"the scene flies no drone {drone!r}"
            if "asterix-129" in self.report and (not drone.isascii() or len(drone) > MAX_SERIAL):
                return (
                    f"the id {drone!r} becomes the serial number, "
                    f"which ASTERIX 129 holds up to {MAX_SERIAL} characters of ASCII"
                )
        return None
