"""Flights from files: each reader gives telemetry reports."""

from plotfeed.feeds.flights.flight import Flight, FlightOptions, GpsOrder
from plotfeed.feeds.flights.reader import read
from plotfeed.feeds.flights.smoothed import smoothed

__all__ = ["Flight", "FlightOptions", "GpsOrder", "read", "smoothed"]
