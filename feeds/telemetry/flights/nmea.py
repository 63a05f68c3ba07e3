"""NMEA 0183 (.nmea): GGA sentences of a receiver, with dates from RMC or ZDA."""

from __future__ import annotations

import re
from functools import reduce

from plotfeed.feeds.telemetry.flights.file_times import midnight_ns, time_of_day_ns
from plotfeed.feeds.telemetry.flights.flight import FlightOptions, Log
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import DAY_NS, nearest_utc_ns

_SENTENCE = re.compile(r"[$!]([A-Z]{2})([A-Z]{3}),([^*\r\n]*)(?:\*([0-9A-Fa-f]{2}))?")
_TIME = re.compile(r"(\d{2})(\d{2})(\d{2}(?:\.\d{1,9})?)")
_ANGLE = re.compile(r"(\d{2,3})(\d{2}(?:\.\d{1,12})?)")
# Qualities of GGA that are measured, and not dead reckoning, entered by hand or simulated.
_FIXED = frozenset("123459")
LOOKS_LIKE = re.compile(rb"\$[A-Z]{2}(?:GGA|RMC|GSA|GSV|GLL|VTG|ZDA|TXT),")


def read_nmea(text: str, options: FlightOptions, log: Log) -> None:
    """Take every GGA sentence that is a fix."""
    reference = options.altitude_reference or AltitudeReference.MEAN_SEA_LEVEL
    log.state("height in metres, above mean sea level: GGA")
    sentences = list(_sentences(text, log))
    about_ns = next((d for _, kind, f in sentences if (d := _date_ns(kind, f)) is not None), None)
    if about_ns is None:
        if options.start_utc_ns is None:
            raise PlotfeedError("no date: neither RMC nor ZDA; the day must be given")
        log.assume("no date: neither RMC nor ZDA; the flight is of the day that is nearest")
        about_ns = options.start_utc_ns
    for number, kind, fields in sentences:
        where = f"line {number}"
        if (date_ns := _date_ns(kind, fields)) is not None:
            about_ns = date_ns
        if kind != "GGA":
            continue
        since_ns, place = _time_of_day_ns(fields[0]), _place(fields)
        if len(fields) < 10 or fields[5] not in _FIXED:
            log.skip(where, "no fix")
        elif since_ns is None or place is None:
            log.skip(where, "no time or position that can be read")
        else:
            about_ns = nearest_utc_ns(since_ns, about_ns)
            try:
                altitude_m = float(fields[8])
            except ValueError:
                log.skip(where, "no altitude")
            else:
                log.take(where, about_ns, place, (altitude_m, reference))


def _sentences(text: str, log: Log) -> list[tuple[int, str, list[str]]]:
    """Line number, kind and fields of each whole sentence."""
    found = []
    for number, line in enumerate(text.splitlines(), start=1):
        sentence = _SENTENCE.search(line)
        if sentence is None:
            if line.strip():
                log.skip(f"line {number}", "no sentence of NMEA 0183")
            continue
        told = f"{sentence[1]}{sentence[2]},{sentence[3]}"
        if sentence[4] and reduce(lambda a, b: a ^ b, told.encode()) != int(sentence[4], 16):
            log.skip(f"line {number}", "damaged: its checksum is wrong")
            continue
        found.append((number, sentence[2], sentence[3].split(",")))
    if not any(kind == "GGA" for _, kind, _ in found):
        raise PlotfeedError("no positions with altitudes: expected GGA sentences of NMEA 0183")
    return found


def _date_ns(kind: str, fields: list[str]) -> int | None:
    """The UTC of a sentence with a date."""
    if kind == "RMC" and len(fields) > 8 and len(fields[8]) == 6:
        day, month, year = (fields[8][n : n + 2] for n in (0, 2, 4))
        year = ("20" if year < "80" else "19") + year
    elif kind == "ZDA" and len(fields) > 3:
        day, month, year = fields[1:4]
    else:
        return None
    midnight, since_ns = midnight_ns(f"{year}-{month}-{day}"), _time_of_day_ns(fields[0])
    if midnight is None:
        return None
    return midnight + (DAY_NS // 2 if since_ns is None else since_ns)


def _time_of_day_ns(text: str) -> int | None:
    """Nanoseconds since midnight of hhmmss.ss."""
    found = _TIME.fullmatch(text)
    return None if found is None else time_of_day_ns(":".join(found.groups()))


def _place(fields: list[str]) -> tuple[float, float] | None:
    """Latitude and longitude, degrees, of ddmm.mmmm,N,dddmm.mmmm,E."""
    if len(fields) < 5:
        return None
    angles = []
    for text, side, sides in ((fields[1], fields[2], "NS"), (fields[3], fields[4], "EW")):
        found = _ANGLE.fullmatch(text)
        if found is None or len(side) != 1 or side not in sides or float(found[2]) >= 60:
            return None
        angle = int(found[1]) + float(found[2]) / 60
        angles.append(-angle if side in "SW" else angle)
    return angles[0], angles[1]
