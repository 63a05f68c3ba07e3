"""The keys of a transmitter of opportunity, and kinds of broadcast that state most of them.

What a kind says is stated by a standard or assumed, as `BROADCASTS` tells of each value; a scene
that knows the transmitter better says so, key by key.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import model_validator

from plotfeed.feeds.scene.fields import Frequency, Location, Name, Positive, SceneTable


@dataclass(frozen=True, slots=True)
class Broadcast:
    """A kind of transmission: keys of an illuminator, and for each value why it is that."""

    title: str
    keys: Mapping[str, float]
    notes: Mapping[str, tuple[Literal["stated", "assumed"], str]]


# By the name that `preset` has for them.
BROADCASTS: Mapping[str, Broadcast] = {
    "dab": Broadcast(
        "Digital audio broadcasting",
        {"erp_w": 10e3, "frequency_hz": 188.928e6, "bandwidth_hz": 1.536e6},
        {
            "erp_w": ("assumed", "Main transmitters have 1 to 10 kW."),
            "frequency_hz": ("stated", "Block 7A of ETSI EN 300 401: the paper's 189 MHz."),
            "bandwidth_hz": ("stated", "ETSI EN 300 401, mode I: 1536 carriers 1 kHz apart."),
        },
    ),
    "dvb-t": Broadcast(
        "Digital television",
        {"erp_w": 10e3, "frequency_hz": 600e6, "bandwidth_hz": 7.61e6},
        {
            "erp_w": ("assumed", "Section 4 of the paper, with its gaps filled."),
            "frequency_hz": ("stated", "Section 4 of the paper; between 470 and 694 MHz."),
            "bandwidth_hz": ("stated", "ETSI EN 300 744, of a channel of 8 MHz."),
        },
    ),
    "fm": Broadcast(
        "Frequency-modulated radio",
        {"erp_w": 100e3, "frequency_hz": 97.75e6, "bandwidth_hz": 50e3},
        {
            "erp_w": ("assumed", "Main transmitters have 10 to 100 kW."),
            "frequency_hz": ("stated", "The middle of 87.5 to 108 MHz, ITU Radio Regulations."),
            "bandwidth_hz": (
                "assumed",
                "It changes with the programme, within the 150 kHz of the deviation of ITU-R "
                "BS.450; speech takes less.",
            ),
        },
    ),
    "gsm": Broadcast(
        "Mobile telephony, a carrier of a base station",
        {"erp_w": 20.0, "frequency_hz": 942.5e6, "bandwidth_hz": 200e3},
        {
            "erp_w": ("assumed", "Base stations have 10 to 100 W a carrier."),
            "frequency_hz": ("stated", "The middle of 925 to 960 MHz, 3GPP TS 45.005."),
            "bandwidth_hz": ("stated", "The spacing of carriers, 3GPP TS 45.005."),
        },
    ),
}


class IlluminatorKeys(SceneTable):
    """A transmitter of opportunity, and its channel, numbered in order."""

    id: Name
    """For people, and for warnings."""
    preset: Literal["dab", "dvb-t", "fm", "gsm"] | None = None
    """A kind of broadcast, for what the scene does not give of erp_w, frequency_hz and
    bandwidth_hz."""
    erp_w: Positive
    """Effective radiated power, over a half-wave dipole; without it, that of `preset`."""
    frequency_hz: Frequency
    """Of the carrier; without it, that of `preset`."""
    bandwidth_hz: Positive
    """Of the signal: bistatic range is resolved to c over it. Without it, that of `preset`."""
    place: Location
    """Of the antenna."""
    external_noise_db: float | None = None
    """In this channel, in place of the sensor's."""

    @model_validator(mode="before")
    @classmethod
    def _as_its_kind_has_it(cls, keys: Any) -> Any:
        kind = keys.get("preset") if isinstance(keys, dict) else None
        if not isinstance(kind, str) or kind not in BROADCASTS:
            return keys
        return {**BROADCASTS[kind].keys, **keys}

    @classmethod
    def _put_right(cls, schema: dict[str, Any]) -> None:
        """A kind of broadcast gives some keys."""
        of_a_kind = [key for key in schema["required"] if key in BROADCASTS["dab"].keys]
        schema["required"] = [key for key in schema["required"] if key not in of_a_kind]
        kinds = {"properties": {"preset": {"type": "string"}}, "required": ["preset"]}
        schema["anyOf"] = [kinds, {"required": of_a_kind}]
