"""What services of network Remote ID answer, from the flights of ASTM F3411 that they were told of.

GET /uss/flights is that of a service provider (F3411-22a, annex A4), GET /display_data that which a
display provider shows, as InterUSS's tests of displays observe it. Limits are those of F3411-22a,
table A1-1.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, TypeAlias

from plotfeed.proto.tracks.encode_tracks import rfc3339
from plotfeed.proto.utc import NS, utc_ns

# NetMaxNearRealTimeDataPeriod: a flight of which nothing came for longer is not told of.
KEPT_S = 60
# NetMaxDisplayAreaDiagonal, and NetDetailsMaxDisplayAreaDiagonal: beyond that, clusters alone.
MAX_DIAGONAL_M, MAX_DETAILED_DIAGONAL_M = 7000.0, 2000.0
# Cells of a view: each has a sixth of its area, and NetMinClusterSizePercent is 15 %.
CLUSTER_ROWS, CLUSTER_COLUMNS = 2, 3
EARTH_RADIUS_M = 6_371_008.8  # mean, IUGG
MAX_FLIGHTS = 10_000
MAX_PLACES = 100  # That are kept of a flight's last minute; of more, the oldest are dropped

Json: TypeAlias = dict[str, Any]


class DisplayArea(NamedTuple):
    """A part of the Earth between two parallels and two meridians, degrees."""

    south: float
    west: float
    north: float
    east: float

    @classmethod
    def parse(cls, text: str) -> DisplayArea:
        """The view between two corners, "lat1,lng1,lat2,lng2"; raises `ValueError`."""
        try:
            latitude, longitude, other_latitude, other_longitude = map(float, text.split(","))
        except ValueError:
            raise ValueError("expected view=lat1,lng1,lat2,lng2") from None
        south, north = sorted((latitude, other_latitude))
        west, east = sorted((longitude, other_longitude))
        if not (-90 <= south <= north <= 90 and -180 <= west <= east <= 180):
            raise ValueError("expected latitudes of -90 to 90 and longitudes of -180 to 180")
        return cls(south, west, north, east)

    @property
    def diagonal_m(self) -> float:
        """Distance from corner to corner, by the haversine of a sphere."""
        south, north = math.radians(self.south), math.radians(self.north)
        across = math.sin(math.radians(self.east - self.west) / 2)
        haversine = math.sin((north - south) / 2) ** 2
        haversine += math.cos(south) * math.cos(north) * across**2
        return 2 * EARTH_RADIUS_M * math.asin(math.sqrt(min(haversine, 1.0)))

    def holds(self, place: Mapping[str, float]) -> bool:
        """Whether a place with `lat` and `lng` is in it."""
        is_between = self.south <= place["lat"] <= self.north
        return is_between and self.west <= place["lng"] <= self.east

    def cell_of(self, place: Mapping[str, float]) -> tuple[int, int]:
        """Row and column of the cell in which a place of the view is."""
        up = (place["lat"] - self.south) / ((self.north - self.south) or 1.0)
        right = (place["lng"] - self.west) / ((self.east - self.west) or 1.0)
        return (
            min(int(up * CLUSTER_ROWS), CLUSTER_ROWS - 1),
            min(int(right * CLUSTER_COLUMNS), CLUSTER_COLUMNS - 1),
        )

    def cell(self, row: int, column: int) -> DisplayArea:
        """A cell of the view."""
        height = (self.north - self.south) / CLUSTER_ROWS
        width = (self.east - self.west) / CLUSTER_COLUMNS
        south, west = self.south + row * height, self.west + column * width
        return DisplayArea(south, west, south + height, west + width)

    @property
    def area_m2(self) -> float:
        """Area on a sphere."""
        band = math.sin(math.radians(self.north)) - math.sin(math.radians(self.south))
        return EARTH_RADIUS_M**2 * band * math.radians(self.east - self.west)


class _Known(NamedTuple):
    """A flight as it was last told of, and where it was, with times, the oldest first."""

    flight: Json
    places: deque[tuple[int, Json]]


class KnownFlights:
    """Flights of the last minute, by their ids; the one that was told of first gives way."""

    def __init__(self) -> None:
        self._known: dict[str, _Known] = {}

    def take(self, flights: list[Json]) -> None:
        """Keep flights as `f3411_flights` has them.

        Raises `KeyError`, `TypeError` or `ValueError` for one that is not so.
        """
        for flight in flights:
            state = flight["current_state"]
            place = state["position"]
            if not all(math.isfinite(place[name]) for name in ("lat", "lng", "alt")):
                raise ValueError("no place")
            known = self._known.pop(flight["id"], None)
            places = known.places if known else deque[tuple[int, Json]](maxlen=MAX_PLACES)
            places.append((utc_ns(state["timestamp"]["value"]) or 0, place))
            self._known[flight["id"]] = _Known(flight, places)
            if len(self._known) > MAX_FLIGHTS:
                del self._known[next(iter(self._known))]

    def holds(self, flight: str, now_utc_ns: int) -> bool:
        """Whether a flight was told of in the last minute."""
        return any(known.flight["id"] == flight for known in self._living(now_utc_ns))

    def flights(self, view: DisplayArea, now_utc_ns: int, recent_s: float = 0.0) -> Json:
        """The answer to GET /uss/flights: those in a view, with places of so many seconds."""
        found = []
        for known in self._in(view, now_utc_ns):
            flight = known.flight
            if recent_s > 0:
                since_ns = now_utc_ns - round(min(recent_s, KEPT_S) * NS)
                flight = flight | {
                    "recent_positions": [
                        {"time": rfc3339(t_utc_ns), "position": place}
                        for t_utc_ns, place in known.places
                        if t_utc_ns >= since_ns
                    ]
                }
            found.append(flight)
        return {"timestamp": rfc3339(now_utc_ns), "flights": found}

    def display_data(self, view: DisplayArea, now_utc_ns: int) -> Json:
        """The answer to GET /display_data: flights of a small view, clusters of a larger one."""
        found = self._in(view, now_utc_ns)
        if view.diagonal_m > MAX_DETAILED_DIAGONAL_M:
            cells = Counter(view.cell_of(known.places[-1][1]) for known in found)
            return {"flights": [], "clusters": [_cluster(view, *c, n) for c, n in cells.items()]}
        since_ns = now_utc_ns - KEPT_S * NS
        return {
            "flights": [
                {
                    "id": known.flight["id"],
                    "most_recent_position": _position(known.places[-1][1]),
                    "recent_paths": [
                        {"positions": [_position(p) for t, p in known.places if t >= since_ns]}
                    ],
                }
                for known in found
            ],
            "clusters": [],
        }

    def _in(self, view: DisplayArea, now_utc_ns: int) -> Iterator[_Known]:
        return (k for k in self._living(now_utc_ns) if view.holds(k.places[-1][1]))

    def _living(self, now_utc_ns: int) -> Iterator[_Known]:
        since_ns = now_utc_ns - KEPT_S * NS
        return (known for known in self._known.values() if known.places[-1][0] >= since_ns)


def _cluster(view: DisplayArea, row: int, column: int, number: int) -> Json:
    cell = view.cell(row, column)
    corners = [{"lat": cell.south, "lng": cell.west}, {"lat": cell.north, "lng": cell.east}]
    return {"corners": corners, "area_sqm": cell.area_m2, "number_of_flights": number}


def _position(place: Json) -> Json:
    """A place as displays have it."""
    return {name: place[name] for name in ("lat", "lng", "alt")}
