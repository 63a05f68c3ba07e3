"""Tracks as events of Cursor on Target, in XML as TAK reads it, one event a track.

MITRE's event.xsd 2.0: `ce` and `le` are one standard deviation, `hae` is above the WGS-84
ellipsoid, 9999999 says that nothing is known. Types are those of MIL-STD-2525: an unknown thing in
the air that is unmanned and of rotary wings; `how` is m-s, made by a machine, simulated.
"""

from __future__ import annotations

from plotfeed.proto.tracks.told_tracks import Told, ToldTracks, TrackOrigin, one_by_one
from plotfeed.proto.utc import NS, iso_utc_ms

TYPE, SIMULATED = "a-u-A-M-H-Q", "m-s"
UNKNOWN = "9999999.0"


def cot_events(tracks: ToldTracks, origin: TrackOrigin) -> list[bytes]:
    """An event for each track; that of a track that ends is stale at once."""
    return [_event(told, origin) for told in one_by_one(tracks)]


def _event(told: Told, origin: TrackOrigin) -> bytes:
    from xml.sax.saxutils import quoteattr  # which loads an HTTP client

    name, at_ns = quoteattr(origin.name_of(told["track"])), told["t_utc_ns"]
    time = iso_utc_ms(at_ns)
    stays_ns = 0 if told["last"] else round(origin.stale_after_s * NS)
    remarks = f"plotfeed {origin.kind}{', coasted' if told['coasted'] else ''}"
    return (
        f'<?xml version="1.0" encoding="UTF-8" standalone="yes"?>'
        f'<event version="2.0" uid={name} type="{TYPE}" how="{SIMULATED}"'
        f' time="{time}" start="{time}" stale="{iso_utc_ms(at_ns + stays_ns)}">'
        f'<point lat="{told["latitude_deg"]:.7f}" lon="{told["longitude_deg"]:.7f}"'
        f' hae="{_known(told["height_m"])}" ce="{_known(told["sigma_level_m"])}"'
        f' le="{_known(told["sigma_up_m"])}"/>'
        f'<detail><track course="{told["course_deg"]:.2f}" speed="{told["speed_m_s"]:.2f}"/>'
        f"<contact callsign={name}/><remarks>{remarks}</remarks></detail></event>"
    ).encode()


def _known(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:.2f}"
