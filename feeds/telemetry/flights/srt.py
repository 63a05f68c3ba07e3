"""DJI subtitle files: one block a video second or frame, its text in one of several dialects."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

from plotfeed.feeds.telemetry.flights.file_times import finer_times
from plotfeed.feeds.telemetry.flights.flight import FlightOptions, GpsOrder, Log, utc_ns
from plotfeed.feeds.telemetry.flights.table import REFERENCE_WORDS
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

_NUMBER = r"([-+]?\d{1,12}(?:\.\d{1,20})?)"
_SPACE = r"[ \t]{0,9}"
_SEPARATOR = rf"{_SPACE},{_SPACE}"
_GPS = re.compile(
    rf"\bGPS{_SPACE}\({_SPACE}{_NUMBER}{_SEPARATOR}{_NUMBER}"
    rf"(?:{_SEPARATOR}{_NUMBER}{_SPACE}(M?))?{_SPACE}\)"
)
# Some models spell it "longtitude".
_NAMED = re.compile(rf"\b(latitude|longt?itude|rel_alt|abs_alt|altitude){_SPACE}:{_SPACE}{_NUMBER}")
# Above where it took off; in some models "Hb", in others "H" behind a comma.
_BAROMETER = re.compile(
    rf"\b(?:BAROMETER|Hb){_SPACE}:{_SPACE}{_NUMBER}|,{_SPACE}H{_SPACE}:?{_SPACE}{_NUMBER}m\b"
)
_CAMERA_LINE = re.compile(r"\bF/[\d.]{1,6},[ \t]{0,9}SS ")
_HOME = re.compile(r"\bHOME[ \t]{0,9}\(")
_DATE = re.compile(
    r"\b(\d{4})[.-](\d{1,2})[.-](\d{1,2})[ T](\d{1,2}):(\d\d):(\d\d)"
    r"(?:[.,](\d{3}))?(?:[.,]?(\d{3}))?"
)
_FRAME_TIME = re.compile(r"(\d{1,3}):(\d\d):(\d\d)[,.](\d{3})[ \t]{0,9}-->")


STATED = "height_m"  # The source of heights that the user states
# Where heights of a block are, and above what that is; None where the file does not say.
_HEIGHTS = {
    "BAROMETER": AltitudeReference.ABOVE_TAKEOFF,
    "rel_alt": AltitudeReference.ABOVE_TAKEOFF,
    "abs_alt": AltitudeReference.MEAN_SEA_LEVEL,
    "altitude": None,
    "GPS altitude": None,
}


@dataclass(frozen=True, slots=True)
class _Block:
    """The text of one subtitle, and what was read in it."""

    line: int
    text: str
    gps: re.Match[str] | None
    values: dict[str, float]  # By the name in front of them; heights by those above

    @classmethod
    def of(cls, line: int, lines: list[str]) -> _Block:
        """The block of those lines, of which the first has that number."""
        text = "\n".join(lines)
        gps, barometer = _GPS.search(text), _BAROMETER.search(text)
        named = _NAMED.findall(text)
        values = {name.replace("longt", "long"): float(value) for name, value in named}
        if barometer:
            values["BAROMETER"] = float(barometer[1] or barometer[2])
        if gps and gps[4]:  # without its unit: satellites
            values["GPS altitude"] = float(gps[3])
        return cls(line, text, gps, values)


def read_srt(text: str, options: FlightOptions, log: Log) -> None:
    """Take every block of a DJI subtitle file that has a position and a time."""
    blocks = list(_blocks(text))
    if not any(block.gps or "latitude" in block.values for block in blocks):
        raise PlotfeedError("no positions: expected GPS(...) or [latitude: ...] in the subtitles")
    order = _gps_order(blocks, options, log)
    source, reference = _height_source(blocks, options)
    log.state(f"height in metres, {REFERENCE_WORDS[reference]}: {source}")
    for block, t_utc_ns in zip(blocks, _times(blocks, options, log), strict=True):
        where = f"line {block.line}"
        position = _position(block, order)
        height_m = options.height_m if source == STATED else block.values.get(source)
        if t_utc_ns is None:
            log.skip(where, "no time that can be read")
        elif position is None:
            log.skip(where, "no GPS position that can be read")
        elif any(position) and height_m is None:
            log.skip(where, f"no {source}, which other blocks have")
        else:
            log.take(where, t_utc_ns, position, (height_m or 0.0, reference))


def _blocks(text: str) -> Iterator[_Block]:
    """Each run of lines from one with `-->`, or the number of a block, to the next empty line.

    Some files have no line with `-->`, and some no empty line between blocks.
    """
    start, lines = 0, list[str]()
    for number, line in enumerate(text.splitlines(), start=1):
        if "-->" in line:
            if lines and not lines[-1].strip().isdigit() and "".join(lines).strip():
                yield _Block.of(start, lines)
            start, lines = number, [line]
        elif line.strip():
            start = start if lines else number
            lines.append(line)
        elif lines:
            yield _Block.of(start, lines)
            lines = []
    if lines:
        yield _Block.of(start, lines)


def _times(blocks: list[_Block], options: FlightOptions, log: Log) -> list[int | None]:
    """UTC of each block: by its date, its timecode, or both."""
    dates = [_date_ns(block, options) for block in blocks]
    frames = [_frame_ns(block) for block in blocks]
    if any(date is not None for date in dates):
        log.assume(f"dates are {options.utc_offset_h:+g} h from UTC (utc_offset_h)")
    elif options.start_utc_ns is None:
        raise PlotfeedError(
            "no date lines: the time of the first frame must be given (start_utc_ns)"
        )
    else:
        log.state("time: timecodes, since there are no dates")
    return finer_times(dates, frames, start_ns=options.start_utc_ns)


def _gps_order(blocks: list[_Block], options: FlightOptions, log: Log) -> GpsOrder | None:
    """Which coordinate comes first; None where every block names its coordinates.

    What the user says comes first, then a value that no latitude can have, then the dialect.
    """
    pairs = [(block, gps) for block in blocks if (gps := block.gps)]
    if not pairs or options.gps_order is not None:
        return options.gps_order
    first_over = any(abs(float(gps[1])) > 90 for _, gps in pairs)
    second_over = any(abs(float(gps[2])) > 90 for _, gps in pairs)
    if first_over != second_over:
        return "lon-lat" if first_over else "lat-lon"
    block, gps = pairs[0]
    if gps[4] == "M":  # Matrice 300
        order: GpsOrder = "lat-lon"
    elif _CAMERA_LINE.search(block.text) or any(_HOME.search(each.text) for each in blocks):
        order = "lon-lat"  # Mavic Pro, Mavic Mini and kin
    else:
        raise PlotfeedError(
            f"line {block.line}: {gps[0]} may be latitude first or longitude first; "
            "say which with --set gps_order=lat-lon or lon-lat"
        )
    log.assume(f"{gps[0]} is {order}, as in other files of this dialect (gps_order)")
    return order


def _position(block: _Block, order: GpsOrder | None) -> tuple[float, float] | None:
    """Latitude and longitude, degrees."""
    if {"latitude", "longitude"} <= block.values.keys():
        return block.values["latitude"], block.values["longitude"]
    if (gps := block.gps) is None:
        return None
    first, second = float(gps[1]), float(gps[2])
    return (first, second) if order == "lat-lon" else (second, first)


def _height_source(blocks: list[_Block], options: FlightOptions) -> tuple[str, AltitudeReference]:
    """The height to use: one of a known reference, the wanted one first, or as the user says."""
    wanted = options.altitude_reference
    sources = sorted(_HEIGHTS.items(), key=lambda each: (each[1] is None, each[1] is not wanted))
    for name, declared in sources:
        if any(name in block.values for block in blocks):
            reference = declared or wanted
            if reference is None:
                raise PlotfeedError(
                    f"{name} does not say what it is measured from; say so with "
                    "--set altitude_reference=above_takeoff, mean_sea_level or ellipsoid"
                )
            return name, reference
    if options.stated_height is not None:
        return STATED, options.stated_height[1]
    raise PlotfeedError(
        "no heights: expected BAROMETER, Hb, H, rel_alt, abs_alt or altitude; "
        "give one height with --set height_m"
    )


def _date_ns(block: _Block, options: FlightOptions) -> int | None:
    if (found := _DATE.search(block.text)) is None:
        return None
    year, month, day, hour, minute, second, ms, us = (int(g or 0) for g in found.groups())
    try:
        when = datetime(year, month, day, hour, minute, second, ms * 1000 + us)  # noqa: DTZ001 - local
    except ValueError:
        return None
    return utc_ns(when, options.utc_offset_h)


def _frame_ns(block: _Block) -> int | None:
    """Where in the film a block begins."""
    found = _FRAME_TIME.search(block.text)
    if found is None:
        return None
    hours, minutes, seconds, ms = (int(g) for g in found.groups())
    return (((hours * 60 + minutes) * 60 + seconds) * 1000 + ms) * 1_000_000
