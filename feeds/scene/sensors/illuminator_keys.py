"""The keys of a transmitter of opportunity, and kinds of broadcast that state most of them.

What a kind says is stated by a standard or assumed, as broadcasts.toml tells of each value; a scene
that knows the transmitter better says so, key by key.
"""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any, Literal

from pydantic import model_validator

from plotfeed.feeds.scene.fields import Frequency, Location, Name, Positive, SceneTable

OF_A_KIND = ("erp_w", "frequency_hz", "bandwidth_hz")


@cache
def broadcasts() -> dict[str, dict[str, Any]]:
    """Kinds of broadcast, by name: a title, and `OF_A_KIND` with value, mark and note each."""
    text = files("plotfeed.feeds.scene.sensors").joinpath("broadcasts.toml").read_text("utf-8")
    return tomllib.loads(text)


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
        if not isinstance(kind, str) or kind not in broadcasts():
            return keys
        return {**{key: broadcasts()[kind][key]["value"] for key in OF_A_KIND}, **keys}

    @classmethod
    def _put_right(cls, schema: dict[str, Any]) -> None:
        """A kind of broadcast gives some keys."""
        schema["required"] = [key for key in schema["required"] if key not in OF_A_KIND]
        kinds = {"properties": {"preset": {"type": "string"}}, "required": ["preset"]}
        schema["anyOf"] = [kinds, {"required": [*OF_A_KIND]}]
