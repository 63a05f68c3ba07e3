"""Recordings that tests read: those of tests/golden, and of a folder of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
from support.given_files import more_input, places

from plotfeed.feeds.recording.foreign_recordings import ForeignReader


@dataclass(frozen=True)
class RadarCapture:
    """A pcap of a radar's datagrams, and how much is in it."""

    path: Path
    messages: int
    plots: int  # Records of category 048
    services: int  # Records of category 034


def _path(name: str) -> Path:
    (path,) = places(f"recordings/{name}")
    return path


CAPTURES = [RadarCapture(_path("turning_radar.pcap"), 160, 160, 130)]
FRAMES = [_path("two_plots.ff"), _path("one_track.ff")]  # FINAL files of one frame
if more_input():
    CAPTURES.append(RadarCapture(_path("croatia_cat_034_048.pcap"), 100, 128, 34))
    FRAMES += [_path("jade_nats_cat048_tcas.ff"), _path("jade_062_one.ff")]


def recorded_payloads() -> list[bytes]:
    """The payloads of all of them, in their order."""
    payloads = []
    for path in [*(each.path for each in CAPTURES), *FRAMES]:
        with ForeignReader(path) as recording:
            payloads += [each.payload for each in recording.messages()]
    assert payloads
    return payloads


EVERY_CAPTURE = pytest.mark.parametrize("capture", CAPTURES, ids=lambda each: each.path.name)
EVERY_FRAME = pytest.mark.parametrize("frame_file", FRAMES, ids=lambda each: each.name)
EVERY_RECORDING = pytest.mark.parametrize(
    "recording", [each.path for each in CAPTURES] + FRAMES, ids=lambda each: each.name
)
