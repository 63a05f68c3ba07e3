"""Straight flights, the ledger that tells of them, and trackers that follow them in known ways."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from support.recordings import START_NS

from plotfeed.feeds.formats.told_tracks import ToldTrack
from plotfeed.feeds.lab.flights import FlightsTally, Truths
from plotfeed.feeds.lab.possible import read_run
from plotfeed.feeds.recording.recorded_tracks import TracksRead, TrackTable
from plotfeed.models.frames import LocalFrame, ecef_to_geodetic, enu_to_aer
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import tables_of
from plotfeed.proto.utc import NS
from plotfeed.testing import SITE


@dataclass(frozen=True)
class Flight:
    """From a place, east, north, up of the site, at a steady velocity, from a time to a time."""

    begin_m: tuple[float, float, float] = (1000.0, 500.0, 100.0)
    velocity_m_s: tuple[float, float, float] = (10.0, -5.0, 0.0)
    from_s: float = 0.0
    until_s: float = 60.0

    def at(self, t_s: float) -> np.ndarray:
        return np.array(self.begin_m) + t_s * np.array(self.velocity_m_s)


# Two that never come near each other.
APART: Mapping[str, Flight] = {
    "a": Flight(),
    "b": Flight((-2000.0, 1500.0, 120.0), (-3.0, 12.0, 0.5)),
}


def ledger_of(flights: Mapping[str, Flight], sensor: str = "radar") -> list[pb.Ledger]:
    """Entries of a radar at the site that looks at all of them every second."""
    last_s = int(max(flight.until_s for flight in flights.values()))
    entries = []
    for second in range(last_s + 1):
        entry = pb.Ledger(sensor=sensor, scan=second)
        for name, flight in flights.items():
            if flight.from_s <= second <= flight.until_s:
                azimuth_deg, elevation_deg, range_m = enu_to_aer(flight.at(second))
                entry.looks.add(
                    drone=name,
                    time_utc_ns=START_NS + second * NS,
                    range_m=float(range_m),
                    azimuth_deg=float(azimuth_deg),
                    elevation_deg=float(elevation_deg),
                    pd=0.9,
                    detected=True,
                )
        entries.append(entry)
    return entries


def tally_of(flights: Mapping[str, Flight], stands: Mapping[str, LocalFrame]) -> FlightsTally:
    tally = FlightsTally(stands)
    tally.add(tables_of(entry.SerializeToString() for entry in ledger_of(flights)))
    return tally


def truths_of(flights: Mapping[str, Flight] = APART) -> Truths:
    return tally_of(flights, {"radar": SITE}).truths(site=SITE, scene="straight")


def report_of(
    name: str, flight: Flight, t_s: float, error_m: Sequence[float] = (0.0, 0.0, 0.0)
) -> ToldTrack:
    """A report of where a flight is, as wrong as that."""
    place = SITE.to_geodetic(flight.at(t_s) + np.array(error_m))
    latitude_deg, longitude_deg, height_m = (float(each) for each in place)
    return ToldTrack(
        name=name,
        t_utc_ns=START_NS + round(t_s * NS),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=height_m,
        velocity_enu_m_s=flight.velocity_m_s,
    )


Given = list[tuple[ToldTrack, int | None]]  # Reports, with when they were received


def followed_well(
    flights: Mapping[str, Flight] = APART,
    *,
    period_s: float = 1.0,
    sigma_m: float = 0.0,
    late_s: float | None = 0.2,
    seed: int = 1,
    tells_covariance: bool = False,
) -> Given:
    """Reports of every flight, on time; each track has the number of its flight, from 1."""
    rng = np.random.default_rng(seed)
    found: Given = []
    for number, flight in enumerate(flights.values(), 1):
        for t_s in np.arange(flight.from_s, flight.until_s + 1e-9, period_s).tolist():
            error_m = sigma_m * rng.standard_normal(3)
            told = report_of(str(number), flight, t_s, error_m)
            if tells_covariance:
                told = replace(told, covariance_m2=(*[sigma_m**2] * 3, 0.0, 0.0, 0.0))
            received = None if late_s is None else told.t_utc_ns + round(late_s * NS)
            found.append((told, received))
    return sorted(found, key=lambda each: each[0].t_utc_ns)


def read_of(given: Given) -> TracksRead:
    table = TrackTable()
    for told, received_utc_ns in given:
        table.add(told, received_utc_ns)
    return table.read("a tracker")


def csv_of(path: Path, recording: Path, *, until_s: float = 60.0, off_deg: float = 0.0) -> Path:
    """A tracker that knows the truth of a recording, in a table."""
    truths = read_run(recording).truths
    rows = ["track,time_utc_ns,latitude_deg,longitude_deg,height_m"]
    for number, flight in enumerate(truths.paths):
        places = zip(*ecef_to_geodetic(flight.position_ecef_m), strict=True)
        for t_ns, (latitude_deg, longitude_deg, height_m) in zip(
            flight.t_utc_ns.tolist(), places, strict=True
        ):
            if t_ns <= flight.t_utc_ns[0] + until_s * NS:
                rows.append(f"{number},{t_ns},{latitude_deg + off_deg},{longitude_deg},{height_m}")
    path.write_text("\n".join(rows) + "\n")
    return path
